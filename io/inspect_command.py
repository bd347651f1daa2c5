"""`rig inspect`: look at a rig in rerun."""

import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError

from .beside import written_beside
from .rig_file import RigFile, read_rig_file

# The viewer shows the last of them.
_SCREENSHOT_FRAMESETS = 2


def inspect(
    rig: Annotated[Path, typer.Argument(help="The rig.mcap to look at.", metavar="RIG.mcap")],
    recording: Annotated[
        list[Path] | None, typer.Argument(help="The recording it was made from, for the pictures.")
    ] = None,
    save: Annotated[Path | None, typer.Option(help="Write an .rrd file instead of opening a window.")] = None,
    web: Annotated[bool, typer.Option("--web", help="Serve it to a browser on this machine.")] = False,
    screenshot: Annotated[Path | None, typer.Option(help="Write a .png picture; needs no screen.")] = None,
) -> None:
    """Look at a rig in rerun: cameras, rectangles and their doubt, pictures, residuals, and a verdict in words.

    Examples: rig inspect rig.mcap; rig inspect rig.mcap room.mcap --save rig.rrd;
    rig inspect rig.mcap --screenshot rig.png
    """
    held = read_rig_file(rig)
    if save is not None:
        save_rrd(save, held, recording or [])
        print(save)
    if screenshot is not None:
        from .rerun_screenshot import take_screenshot

        take_screenshot(lambda address: _send(address, held, recording or [], _SCREENSHOT_FRAMESETS), screenshot)
        print(screenshot)
    if web:
        _serve(held, recording or [])
    elif save is None and screenshot is None:
        _open(held, recording or [])


def save_rrd(path: Path, held: RigFile, recording: list[Path]) -> None:
    """Write a rig, its blueprint and the pictures of a recording to an .rrd file, whole or not at all."""
    with written_beside(path) as beside:
        stream = _stream()
        stream.save(str(beside), default_blueprint=_blueprint(held.rig))
        _log(stream, held, recording)
        stream.flush()
        stream.disconnect()


def _stream() -> Any:
    import rerun as rr

    return rr.RecordingStream("quadrig")


def _blueprint(rig: Rig) -> Any:
    from .rerun_blueprint import rig_blueprint

    return rig_blueprint(rig)


def _log(stream: Any, held: RigFile, recording: list[Path], most: int | None = None) -> None:
    from .rerun_rig import log_pictures, log_rig

    log_rig(stream, held.rig, held.times)
    if recording:
        from .picture_source import MOST_FRAMESETS, rig_pictures

        pictures = rig_pictures(held.rig, held.times, recording, most or MOST_FRAMESETS)
        count = log_pictures(stream, pictures, held.times)
        print(f"{count} pictures", file=sys.stderr)


def _serve(held: RigFile, recording: list[Path]) -> None:
    from .rerun_live import Viewer

    viewer = Viewer(web=True)
    try:
        _send(viewer.address, held, recording)
        print(f"{viewer.page}\nCtrl-C ends it", flush=True)
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        pass
    finally:
        viewer.close()


def _open(held: RigFile, recording: list[Path]) -> None:
    from .rerun_live import Viewer, has_screen

    if not has_screen():
        raise QuadrigError("there is no screen here; use --web, or write --save x.rrd or --screenshot x.png")
    _send(Viewer().address, held, recording)


def _send(address: str, held: RigFile, recording: list[Path], most: int | None = None) -> None:
    stream, blueprint = _stream(), _blueprint(held.rig)
    stream.connect_grpc(address, default_blueprint=blueprint)
    _log(stream, held, recording, most)
    stream.flush()
    stream.disconnect()
