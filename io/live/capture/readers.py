"""The reader of each kind of source."""

from pathlib import Path

from quadrig.io.live.capture.folder_readers import FolderReader, WatchReader
from quadrig.io.live.capture.http_readers import open_http
from quadrig.io.live.capture.opencv_readers import CaptureReader, open_video
from quadrig.io.live.capture.reader import Reader
from quadrig.io.live.capture.source_spec import SourceSpec


def open_reader(spec: SourceSpec) -> Reader:
    """Open a source. Raises SourceLostError where it is not there now, QuadrigError where it never can be."""
    match spec.kind:
        case "camera":
            return CaptureReader(int(spec.address), f"camera {spec.address}", live=True)
        case "device" | "rtsp":
            return CaptureReader(spec.address, spec.address, live=True)
        case "http":
            return open_http(spec.address)
        case "video":
            return open_video(spec.address)
        case "folder":
            return FolderReader(Path(spec.address))
        case _:
            return WatchReader(Path(spec.address))
