"""Readers: one for each thing pictures come from. Each blocks while it reads, and knows nothing of threads.

A reader is opened by open_reader, gives (media time in ns, bytes or picture) until read() returns None at the end,
and raises SourceLostError where the source went away and may come back.
"""

import os
import sys
import time
import urllib.request
from dataclasses import dataclass
from http.client import HTTPException, HTTPResponse
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from quadrig.io.live.frame import Picture
from quadrig.io.recording.image_folder import IMAGE_SUFFIXES
from quadrig.single.errors import QuadrigError

# A network source that says nothing for this long is lost: a camera of 1 frame a second has missed three.
_NETWORK_PATIENCE = 3.0
# Folders of pictures carry no clock: they play at a rate a person can follow.
_FOLDER_PERIOD_NS = 100_000_000
# FFmpeg's AV_LOG_QUIET.
_SILENT = -8

Payload = bytes | Picture


class SourceLostError(Exception):
    """A source went away; the message says how."""


class Reader(Protocol):
    """Something that gives pictures one after the other.

    live: the pictures come at their own pace and their time is the clock's; else the time is the medium's.
    """

    live: bool

    def read(self) -> tuple[int, Payload] | None:
        """Next media time (ns; ignored where live) and picture; None at the end. Raises SourceLostError."""
        ...

    def close(self) -> None:
        """Let go of the device or file."""
        ...


@dataclass(frozen=True)
class SourceSpec:
    """Where pictures come from. kind: "camera", "device", "rtsp", "http", "video", "folder" or "watch"."""

    kind: str
    address: str

    @property
    def live(self) -> bool:
        """Whether the pictures come at their own pace."""
        return self.kind not in ("video", "folder")

    @property
    def timed(self) -> bool:
        """Whether the pictures come when they are taken: those of a folder say nothing of that."""
        return self.kind not in ("folder", "watch")


def parse_source(text: str | int, folder: Path | None = None) -> SourceSpec:
    """What a source of rig.toml or of the command line means.

    A number is a camera index, /dev/... a device, rtsp:// and http(s):// streams, watch:FOLDER a folder into which
    pictures fall, FOLDER a folder of pictures, anything else a video file. Relative paths start at `folder`.
    Raises QuadrigError where a file or folder does not exist.
    """
    text = str(text).strip()
    if text.isdigit():
        return SourceSpec("camera", text)
    if text.startswith("/dev/"):
        return SourceSpec("device", text)
    scheme = text.split("://", 1)[0].lower() if "://" in text else ""
    if scheme in ("rtsp", "rtsps", "rtmp", "udp"):
        return SourceSpec("rtsp", text)
    if scheme in ("http", "https"):
        return SourceSpec("http", text)
    if text.startswith("watch:"):
        return SourceSpec("watch", str((folder or Path()) / text.removeprefix("watch:")))
    path = (folder or Path()) / text
    if path.is_dir():
        return SourceSpec("folder", str(path))
    if path.is_file():
        return SourceSpec("video", str(path))
    raise QuadrigError(
        f"source {text!r}: no such file or folder; give a camera number, /dev/video0, rtsp://, http://, a video, "
        "a folder of pictures, or watch:FOLDER"
    )


def open_reader(spec: SourceSpec) -> Reader:
    """Open a source. Raises SourceLostError where it is not there now, QuadrigError where it never can be."""
    match spec.kind:
        case "camera":
            return _CaptureReader(int(spec.address), f"camera {spec.address}", live=True)
        case "device" | "rtsp":
            return _CaptureReader(spec.address, spec.address, live=True)
        case "http":
            return _open_http(spec.address)
        case "video":
            return _open_video(spec.address)
        case "folder":
            return _FolderReader(Path(spec.address))
        case _:
            return _WatchReader(Path(spec.address))


class _CaptureReader:
    """Anything OpenCV opens, decoded by it."""

    def __init__(self, address: str | int, label: str, live: bool) -> None:
        self.live, self._label = live, label
        self._capture = _open_capture(address)
        if not self._capture.isOpened():
            raise SourceLostError(f"{label} cannot be opened{_why_not(address)}")
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)

    def read(self) -> tuple[int, Payload] | None:
        done, picture = self._capture.read()
        if done:
            return _media_time(self._capture), np.asarray(picture)
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

    def read(self) -> tuple[int, Payload] | None:
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
    patience = int(_NETWORK_PATIENCE * 1000)
    options = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, patience, cv2.CAP_PROP_READ_TIMEOUT_MSEC, patience]
    return cv2.VideoCapture(address, cv2.CAP_FFMPEG, options)


def _media_time(capture: cv2.VideoCapture) -> int:
    """ns, of the frame that was read last."""
    return int(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)


def _open_video(path: str) -> Reader:
    raw = cv2.VideoCapture(path, cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    if raw.isOpened() and int(raw.get(cv2.CAP_PROP_FOURCC)) == cv2.VideoWriter.fourcc(*"MJPG"):
        return _JpegVideoReader(raw)
    raw.release()
    try:
        return _CaptureReader(path, path, live=False)
    except SourceLostError:
        raise QuadrigError(f"{path}: no video that can be played; give an mp4, avi, mkv or a folder") from None


class _FolderReader:
    """The pictures of a folder in the order of their names."""

    live = False

    def __init__(self, folder: Path) -> None:
        self._paths = sorted(p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
        self._next = 0
        if not self._paths:
            raise QuadrigError(f"{folder}: no pictures ({', '.join(sorted(IMAGE_SUFFIXES))}) in this folder")

    def read(self) -> tuple[int, Payload] | None:
        if self._next >= len(self._paths):
            return None
        stamp, path = self._next * _FOLDER_PERIOD_NS, self._paths[self._next]
        self._next += 1
        return stamp, _picture_file(path)

    def close(self) -> None:
        pass


class _WatchReader:
    """A folder into which pictures fall: each is read once its size has stood still between two looks."""

    live = True
    _LOOK_EVERY = 0.05

    def __init__(self, folder: Path) -> None:
        self._folder, self._seen, self._sizes = folder, set[str](), dict[str, int]()
        if not folder.is_dir():
            raise SourceLostError(f"folder {folder} is not there")

    def read(self) -> tuple[int, Payload] | None:
        until = time.monotonic() + _NETWORK_PATIENCE
        while time.monotonic() < until:
            path = self._next_settled()
            if path is not None:
                self._seen.add(path.name)
                return 0, _picture_file(path)
            time.sleep(self._LOOK_EVERY)
        return 0, b""

    def _next_settled(self) -> Path | None:
        try:
            found = sorted(p for p in self._folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
        except OSError:
            raise SourceLostError(f"folder {self._folder} is not there") from None
        for path in found:
            if path.name in self._seen:
                continue
            size = path.stat().st_size if path.exists() else -1
            if size > 0 and self._sizes.get(path.name) == size:
                return path
            self._sizes[path.name] = size
        return None

    def close(self) -> None:
        pass


def _picture_file(path: Path) -> Payload:
    if path.suffix.lower() in (".jpg", ".jpeg", ".png"):
        return path.read_bytes()
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    return b"" if picture is None else np.asarray(picture)


def _open_http(address: str) -> Reader:
    """A multipart motion-JPEG stream or a snapshot address; what else HTTP may carry is left to FFmpeg."""
    try:
        response = urllib.request.urlopen(address, timeout=_NETWORK_PATIENCE)
    except (OSError, HTTPException, ValueError) as error:
        raise SourceLostError(f"{address} does not answer ({error})") from None
    kind = response.headers.get_content_type()
    if kind.startswith("multipart/"):
        return _MultipartReader(address, response)
    response.close()
    if kind in ("image/jpeg", "image/png"):
        return _SnapshotReader(address)
    return _CaptureReader(address, address, live=True)


class _MultipartReader:
    """multipart/x-mixed-replace as webcams and phones serve it, with or without Content-Length."""

    live = True

    def __init__(self, address: str, response: HTTPResponse) -> None:
        self._address, self._response, self._buffer = address, response, bytearray()

    def read(self) -> tuple[int, Payload] | None:
        try:
            length = self._head_of_part()
            body = self._take(length) if length else self._take_past(b"\xff\xd9\r\n")[:-2]
        except (OSError, HTTPException, ValueError) as error:
            raise SourceLostError(f"{self._address} broke off ({error})") from None
        return 0, body

    def close(self) -> None:
        self._response.close()

    def _head_of_part(self) -> int:
        """Content-Length of the next part, 0 where it is not told."""
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

    def read(self) -> tuple[int, Payload] | None:
        try:
            with urllib.request.urlopen(self._address, timeout=_NETWORK_PATIENCE) as response:
                return 0, response.read()
        except (OSError, HTTPException, ValueError) as error:
            raise SourceLostError(f"{self._address} does not answer ({error})") from None

    def close(self) -> None:
        pass
