"""What a source of rig.toml or of the command line names."""

from dataclasses import dataclass
from pathlib import Path

from quadrig.single.errors import QuadrigError


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
