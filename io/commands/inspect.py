"""`rig inspect`: look at a rig in rerun."""

from pathlib import Path
from typing import Annotated, Any

import typer

from quadrig.io.rig_file.rig_mcap import RigFile, read_rig_file
from quadrig.io.verbosity import say
from quadrig.io.viewer import show as rerun_show

# The viewer shows the last of them.
_FRAMESETS_OF_A_LOOK = 2


def inspect(
    rig: Annotated[Path, typer.Argument(help="The rig.mcap to look at.", metavar="RIG.mcap")],
    recording: Annotated[
        list[Path] | None, typer.Argument(help="The recording it was made from, for the pictures.")
    ] = None,
    save: Annotated[Path | None, typer.Option(help="Write an .rrd file instead of opening a window.")] = None,
    web: Annotated[bool, typer.Option("--web", help="Serve it to a browser on this machine.")] = False,
    screenshot: Annotated[Path | None, typer.Option(help="Write a .png or .jpg picture; needs no screen.")] = None,
) -> None:
    """Look at a rig in rerun: cameras, rectangles and their doubt, pictures, residuals, and a verdict in words.

    Examples: rig inspect rig.mcap; rig inspect rig.mcap room.mcap --save rig.rrd;
    rig inspect rig.mcap --screenshot rig.png
    """
    shown = _shown(read_rig_file(rig), recording or [])
    if web or save or screenshot:
        rerun_show.show(shown, save, web, screenshot)
    else:
        rerun_show.open_window(shown)


def save_rrd(path: Path, held: RigFile, recording: list[Path]) -> None:
    """Write a rig, its blueprint and the pictures of a recording to an .rrd file, whole or not at all."""
    rerun_show.save_rrd(_shown(held, recording), path)


def _shown(held: RigFile, recording: list[Path]) -> rerun_show.Shown:
    from quadrig.io.viewer.inspect.blueprint import rig_blueprint

    return rerun_show.Shown(rig_blueprint(held.rig), lambda stream, one_look: _log(stream, held, recording, one_look))


def _log(stream: Any, held: RigFile, recording: list[Path], one_look: bool) -> None:
    from quadrig.io.viewer.inspect.whole_rig import log_pictures, log_rig

    log_rig(stream, held.rig, held.times)
    if recording:
        from quadrig.io.viewer.inspect.pictures import MOST_FRAMESETS, rig_pictures

        most = _FRAMESETS_OF_A_LOOK if one_look else MOST_FRAMESETS
        count = log_pictures(stream, rig_pictures(held.rig, held.times, recording, most), held.times)
        say(f"{count} pictures")
