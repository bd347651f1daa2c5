"""A motion-JPEG stream on this machine, for tests of live sources."""

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


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
