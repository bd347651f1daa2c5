"""A live session on a terminal: one large sentence, a line for each camera, Enter; where it is none, plain lines."""

import select
import sys
import time
from collections.abc import Callable

from quadrig.io.live.state import SetupState
from quadrig.io.plain_words import console, plain
from quadrig.rig.words import length

# A terminal is drawn this often (s): quicker than reading, far slower than the frames.
_EVERY = 0.25


class PlainScreen:
    """Says a sentence on stderr when it changes: for logs and pipes."""

    def __init__(self) -> None:
        self._said = ""

    def show(self, state: SetupState) -> None:
        """Say the sentence where it is a new one."""
        if state.sentence != self._said:
            self._said = state.sentence
            note = f" ({state.note})" if state.note else ""
            print(plain(f"{state.sentence}{note}"), file=sys.stderr, flush=True)

    def close(self) -> None:
        """Nothing is left open."""


class TerminalScreen:
    """Draws the session in place on stderr."""

    def __init__(self) -> None:
        from rich.live import Live

        self._live = Live(console=console(stderr=True), auto_refresh=False, transient=True)
        self._live.start()
        self._drawn = 0.0

    def show(self, state: SetupState) -> None:
        """Draw, unless it was drawn just now."""
        if time.monotonic() - self._drawn < _EVERY:
            return
        self._drawn = time.monotonic()
        self._live.update(_page(state), refresh=True)

    def close(self) -> None:
        """Take the drawing away."""
        self._live.stop()


def enter_pressed() -> Callable[[], str]:
    """Asks, without waiting, whether somebody pressed Enter; the end of a pipe is no Enter."""
    open_ = [not sys.stdin.closed]

    def pressed() -> str:
        if not open_[0]:
            return ""
        try:
            ready, _, _ = select.select([sys.stdin], [], [], 0)
            line = sys.stdin.readline() if ready else None
        except (OSError, ValueError):
            line = ""
        if line == "":
            open_[0] = False
        return "Enter was pressed" if line else ""

    return pressed


def _page(state: SetupState):
    from rich.console import Group
    from rich.panel import Panel
    from rich.text import Text

    style = "bold yellow" if state.fault else "bold green" if state.advice and state.advice.kind == "done" else "bold"
    sentence = Text(state.sentence, style=style, justify="center")
    figures = f"{state.kept} framesets kept   {state.rate:.0f} framesets/s   {1000 * state.latency:.0f} ms"
    note = Text("   ".join(part for part in (state.note, figures) if part), style="dim", justify="center")
    return Group(Panel(sentence, padding=(1, 2)), note, _cameras(state))


def _cameras(state: SetupState):
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for name in ("camera", "frames/s", "sees now", "views kept", "focal", "position"):
        table.add_column(name, justify="left" if name in ("camera", "sees now") else "right")
    placed = {camera.name for camera in state.rig.cameras} if state.rig else set()
    for source in state.sources:
        sees = ", ".join(view.rectangle for view in state.views if view.camera == source.name)
        kept = sum(view.camera == source.name for view in state.kept_views)
        focal = position = "-"
        if state.rig is not None and source.name in placed:
            camera = state.rig.camera(source.name)
            focal = f"{camera.intrinsics.focal:.0f} ± {state.rig.focal_sigma(source.name):.1f} px"
            sigma = state.rig.position_sigma(source.name)
            position = f"± {length(sigma)}" if sigma > 0 else "the reference"
        pace = f"{source.rate:.0f}" if source.condition in ("running", "ended") else source.condition
        table.add_row(source.name, pace, sees or "-", str(kept), focal, position)
    return table
