"""Pictures over HTTP: motion-JPEG streams as webcams and phones serve them, and addresses of single pictures."""

import urllib.request
from http.client import HTTPException, HTTPResponse

from quadrig.io.live.capture.opencv_readers import CaptureReader
from quadrig.io.live.capture.reader import NETWORK_PATIENCE, PictureData, Reader, SourceLostError


def open_http(address: str) -> Reader:
    """A multipart motion-JPEG stream or a snapshot address; what else HTTP may carry is left to FFmpeg."""
    try:
        response = urllib.request.urlopen(address, timeout=NETWORK_PATIENCE)
    except (OSError, HTTPException, ValueError) as error:
        raise SourceLostError(f"{address} does not answer ({error})") from None
    kind = response.headers.get_content_type()
    if kind.startswith("multipart/"):
        return _MultipartReader(address, response)
    response.close()
    if kind in ("image/jpeg", "image/png"):
        return _SnapshotReader(address)
    return CaptureReader(address, address, live=True)


class _MultipartReader:
    """multipart/x-mixed-replace as webcams and phones serve it, with or without Content-Length."""

    live = True

    def __init__(self, address: str, response: HTTPResponse) -> None:
        self._address, self._response, self._buffer = address, response, bytearray()

    def read(self) -> tuple[int, PictureData] | None:
        try:
            length = self._head_of_part()
            body = self._take(length) if length else self._take_past(b"\xff\xd9\r\n")[:-2]
        except (OSError, HTTPException, ValueError) as error:
            raise SourceLostError(f"{self._address} broke off ({error})") from None
        return 0, body

    def close(self) -> None:
        self._response.close()

    def _head_of_part(self) -> int:
        """Content-Length of the next part, 0 where it is not given."""
        length, inside = 0, False
        while True:
            line = self._take_past(b"\n").strip()
            if line.startswith(b"--"):
                inside = True
            elif line.lower().startswith(b"content-length:"):
                length = int(line.split(b":", 1)[1])
            elif not line and inside:
                return length

    def _take(self, length: int) -> bytes:
        while len(self._buffer) < length:
            self._fill()
        taken = bytes(self._buffer[:length])
        del self._buffer[:length]
        return taken

    def _take_past(self, mark: bytes) -> bytes:
        searched = 0
        while (found := self._buffer.find(mark, searched)) < 0:
            searched = max(0, len(self._buffer) - len(mark))
            self._fill()
        return self._take(found + len(mark))

    def _fill(self) -> None:
        piece = self._response.read1(65536)
        if not piece:
            raise SourceLostError(f"{self._address} gives no more pictures")
        self._buffer += piece


class _SnapshotReader:
    """An address that gives one picture each time it is asked."""

    live = True

    def __init__(self, address: str) -> None:
        self._address = address

    def read(self) -> tuple[int, PictureData] | None:
        try:
            with urllib.request.urlopen(self._address, timeout=NETWORK_PATIENCE) as response:
                return 0, response.read()
        except (OSError, HTTPException, ValueError) as error:
            raise SourceLostError(f"{self._address} does not answer ({error})") from None

    def close(self) -> None:
        pass
