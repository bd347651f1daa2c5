"""Pictures of what a rerun viewer shows, without a screen: for reports, tests and the eye."""

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from quadrig.io.viewer.process import Viewer, ends_with_us
from quadrig.io.whole_file import written_beside
from quadrig.single.errors import QuadrigError

_SIZE = "1600x1000"
# Names and thin lines stay clean.
_JPEG_QUALITY = 88
# A software renderer on a busy machine opens within half a minute; a graphics card in two seconds.
_OPENING_SECONDS = 60.0
# The viewer greets with notes in a corner, over the picture, for some seconds of frames drawn.
_NOTES_SECONDS = 14.0
_SETTLED_SECONDS = 60.0


def take_screenshot(send: Callable[[str], None], picture: Path) -> None:
    """A picture (.png or .jpg) of what `send` logs to the gRPC address it is given, as the viewer lays it out.

    Raises QuadrigError where the viewer cannot draw here, and where the name ends in neither.
    """
    kind = picture.suffix.lower()
    if kind not in (".png", ".jpg", ".jpeg"):
        raise QuadrigError(f"{picture}: pictures of the viewer are .png or .jpg; give such a name")
    with written_beside(picture) as beside, TemporaryDirectory() as folder:
        png = Path(folder) / "picture.png"
        _draw(send, png)
        beside.write_bytes(png.read_bytes() if kind == ".png" else _jpeg(png))


def _jpeg(png: Path) -> bytes:
    import cv2

    picture = cv2.imread(str(png))
    if picture is None:
        raise QuadrigError(_CANNOT)
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


def _draw(send: Callable[[str], None], png: Path) -> None:
    with ends_with_us(_headless()) as viewer:
        client = _connect(viewer)
        try:
            send(viewer.address)
        except RuntimeError:
            # A viewer that listens and then finds nothing to draw with breaks off while it is sent to.
            raise QuadrigError(_CANNOT) from None
        _settle(client, png)


_CANNOT = (
    "the rerun viewer cannot draw here; install a Vulkan driver (mesa-vulkan-drivers draws without a graphics card), "
    "or look at the rig with --web"
)


def _headless() -> Viewer:
    try:
        return Viewer(options=("--headless", "--hide-welcome-screen", "--window-size", _SIZE))
    except QuadrigError:
        raise QuadrigError(_CANNOT) from None


def _connect(viewer: Viewer) -> Any:
    from rerun.experimental import ViewerClient

    until = time.monotonic() + _OPENING_SECONDS
    while time.monotonic() < until and viewer.open:
        try:
            client = ViewerClient.connect(viewer.address)
            client.get_state()
            return client
        except Exception:
            time.sleep(0.3)
    raise QuadrigError(_CANNOT)


def _settle(client: Any, png: Path) -> None:
    """Take pictures until one equals the one before it."""
    gone, before = time.monotonic() + _NOTES_SECONDS, b""
    until = gone + _SETTLED_SECONDS
    while time.monotonic() < until:
        try:
            client.save_screenshot(str(png))
            now = png.read_bytes()
        except (RuntimeError, OSError):
            # A software renderer that is still busy with large pictures does not answer in time: ask again.
            now = b""
        if now and now == before and time.monotonic() > gone:
            return
        before = now
        time.sleep(1.0)
    if not before:
        raise QuadrigError(_CANNOT)
