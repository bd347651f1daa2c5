"""What OpenCV reads: cameras, devices, network streams and videos."""

import os
import sys
from pathlib import Path

import cv2
import numpy as np

from quadrig.io.live.capture.reader import NETWORK_PATIENCE, PictureData, Reader, SourceLostError
from quadrig.single.errors import QuadrigError

# FFmpeg's AV_LOG_QUIET.
_SILENT = -8


class CaptureReader:
    """Anything OpenCV opens, decoded by it."""

    def __init__(self, address: str | int, label: str, live: bool) -> None:
        self.live, self._label = live, label
        self._capture = _open_capture(address)
        if not self._capture.isOpened():
            raise SourceLostError(f"{label} cannot be opened{_why_not(address)}")
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)

    def read(self) -> tuple[int, PictureData] | None:
        done, picture = self._capture.read()
        if done:
            return _media_time(self._capture), np.asarray(picture, np.uint8)
        if self.live:
            raise SourceLostError(f"{self._label} gives no more pictures")
        return None

    def close(self) -> None:
        self._capture.release()


def _why_not(address: str | int) -> str:
    """What a person can do about a device that does not open; "" of anything else."""
    device = f"/dev/video{address}" if isinstance(address, int) else address
    if not device.startswith("/dev/") or not sys.platform.startswith("linux"):
        return ""
    if not Path(device).exists():
        here = ", ".join(sorted(str(path) for path in Path("/dev").glob("video*")))
        return f" (there is no {device}; here: {here})" if here else f" (there is no {device}; plug it in)"
    return f" ({device} is in use)" if os.access(device, os.R_OK | os.W_OK) else f" (no permission for {device})"


class _JpegVideoReader:
    """A motion-JPEG file: its JPEGs as they are, for a decoder that wants grey and a recorder that wants JPEG."""

    live = False

    def __init__(self, capture: cv2.VideoCapture) -> None:
        self._capture = capture

    def read(self) -> tuple[int, PictureData] | None:
        done, packet = self._capture.read()
        return (_media_time(self._capture), np.asarray(packet).tobytes()) if done else None

    def close(self) -> None:
        self._capture.release()


def _open_capture(address: str | int) -> cv2.VideoCapture:
    # What it would print is said by the source's state, in words.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", str(_SILENT))
    if isinstance(address, int) or address.startswith("/dev/"):
        capture = cv2.VideoCapture(address)
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
        return capture
    patience = int(NETWORK_PATIENCE * 1000)
    options = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, patience, cv2.CAP_PROP_READ_TIMEOUT_MSEC, patience]
    return cv2.VideoCapture(address, cv2.CAP_FFMPEG, options)


def _media_time(capture: cv2.VideoCapture) -> int:
    """ns, of the frame that was read last."""
    return int(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)


def open_video(path: str) -> Reader:
    raw = cv2.VideoCapture(path, cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    if raw.isOpened() and int(raw.get(cv2.CAP_PROP_FOURCC)) == cv2.VideoWriter.fourcc(*"MJPG"):
        return _JpegVideoReader(raw)
    raw.release()
    try:
        return CaptureReader(path, path, live=False)
    except SourceLostError:
        raise QuadrigError(f"{path}: no video that can be played; give an mp4, avi, mkv or a folder") from None
