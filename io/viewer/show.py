"""Ways to show something in rerun, the same for every command: a file, a picture, a page for a browser, a window."""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from quadrig.io.verbosity import say
from quadrig.single.errors import QuadrigError

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb


@dataclass(frozen=True, eq=False)
class Shown:
    """What is shown: how it is laid out, and what logs it.

    The flag of log says that one look is all there will be: of many pictures the last are enough.
    """

    blueprint: "rrb.Blueprint"
    log: "Callable[[rr.RecordingStream, bool], None]"


def show(shown: Shown, save: Path | None, web: bool, screenshot: Path | None) -> None:
    """In every way that is asked for; a page is served until Ctrl-C."""
    if save is not None:
        save_rrd(shown, save)
        say(f"written: {save}")
    if screenshot is not None:
        from quadrig.io.viewer.screenshot import take_screenshot

        take_screenshot(lambda address: _send(shown, address, one_look=True), screenshot)
        say(f"written: {screenshot}")
    if web:
        from quadrig.io.viewer.web_page import serve

        serve(lambda rrd: save_rrd(shown, rrd))


def open_window(shown: Shown) -> None:
    """A window that stays. Raises QuadrigError where there is no screen."""
    from quadrig.io.viewer.process import Viewer, has_screen

    if not has_screen():
        raise QuadrigError("there is no screen here; use --web, or write --save x.rrd or --screenshot x.png")
    _send(shown, Viewer().address)


def save_rrd(shown: Shown, path: Path) -> None:
    """Write an .rrd file, whole or not at all."""
    from quadrig.io.viewer.rrd_file import rrd_written

    with rrd_written(path, "quadrig", shown.blueprint) as stream:
        _log(shown, stream)


def _send(shown: Shown, address: str, one_look: bool = False) -> None:
    import rerun as rr
    import rerun.blueprint as rrb

    stream, blueprint = rr.RecordingStream("quadrig"), shown.blueprint
    if one_look:
        # A picture needs no menu, nor what the viewer says of the machine that drew it.
        blueprint = copy.copy(blueprint)
        blueprint.top_panel = rrb.TopPanel(state="hidden")
    stream.connect_grpc(address, default_blueprint=blueprint)
    _log(shown, stream, one_look)
    stream.disconnect()


def _log(shown: Shown, stream: "rr.RecordingStream", one_look: bool = False) -> None:
    shown.log(stream, one_look)
    stream.flush()
