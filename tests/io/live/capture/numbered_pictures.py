"""Numbered pictures as a video and as a motion-JPEG stream on this machine, for tests of live sources."""

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 320, 180


def numbered_picture(number: int) -> np.ndarray:
    """Eight squares, black or white: the bits of the number."""
    picture = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    for bit in range(8):
        picture[60:120, 40 * bit + 4 : 40 * bit + 36] = 230 if number >> bit & 1 else 10
    return picture


def jpeg(number: int) -> bytes:
    return cv2.imencode(".jpg", numbered_picture(number))[1].tobytes()


def write_video(path: Path, count: int, rate: float = 30, codec: str = "MJPG", step: int = 1) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate, (WIDTH, HEIGHT))
    for number in range(count):
        writer.write(numbered_picture(number * step))
    writer.release()
    return path


@contextmanager
def served(pictures: Callable[[], Iterable[tuple[bytes, float]]], lengths: bool = True) -> Iterator[str]:
    """The address of a stream. pictures(): for each connection JPEGs and the wait (s) before each; then it ends.
    lengths: whether the length of each is said."""
    stopped = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=here")
            self.end_headers()
            for data, wait in pictures():
                if stopped.wait(wait):
                    return
                length = f"Content-Length: {len(data)}\r\n" if lengths else ""
                head = f"--here\r\nContent-Type: image/jpeg\r\n{length}\r\n".encode()
                try:
                    self.wfile.write(head + data + b"\r\n")
                except OSError:
                    return

        def log_message(self, format: str, *arguments: object) -> None:  # noqa: A002 - its base has it so
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/stream"
    finally:
        stopped.set()
        server.shutdown()
        server.server_close()


def stream(rate: float = 30.0, lengths: bool = True, breaks_after: int = 200, silent_after: int = 200):
    """The address of a stream of numbered pictures that can break off or fall silent, as served() has it."""

    def pictures():
        for number in range(breaks_after):
            yield jpeg(number), 1 / rate + 20 * (number >= silent_after)

    return served(pictures, lengths)
