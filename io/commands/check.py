"""`rig check`: has a camera of the rig moved?"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from quadrig.io.config.rig_toml import read_config
from quadrig.io.formats.any_file import read_any_rig
from quadrig.io.formats.rig_json import json_text
from quadrig.io.plain_words import console
from quadrig.io.recording.messages.mcap_reader import is_mcap
from quadrig.io.rig_file.rig_mcap import RigFile, read_rig_file
from quadrig.io.search.later_recording import views_of
from quadrig.io.verbosity import note
from quadrig.rig.doubt.verdict import out_of_step
from quadrig.rig.moved import CameraMove, find_moved
from quadrig.rig.words import ONE_SIGMA, length, with_sigma
from quadrig.single.errors import QuadrigError

MOVED = 3
"""Exit code where a camera has moved."""


def check(
    rig: Annotated[
        Path, typer.Argument(help="The rig as it was: a rig.mcap, or any format that is read.", metavar="RIG")
    ],
    recording: Annotated[
        list[Path], typer.Argument(help="A new recording with rectangles in view.", metavar="RECORDING")
    ],
    false_alarms: Annotated[
        float, typer.Option(min=1e-9, max=0.5, help="Chance of an alarm on a rig that did not move.")
    ] = 0.01,
    framesets: Annotated[int, typer.Option(min=1, help="Search at most this many framesets.")] = 120,
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="The rig.toml, where the rig's file holds no rectangles.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The answers as JSON.")] = False,
) -> None:
    """Find out from a new recording whether a camera has moved since the rig was calibrated.

    Exits with 0 where none moved, 3 where one did, 1 where it cannot be determined. Rectangles may stand elsewhere
    than they did, but for those of one body against each other; all cameras moving together is not seen.

    Example: rig check rig.mcap tonight.mcap --json
    """
    held = read_rig_file(rig) if rig.is_file() and is_mcap(rig) else RigFile(read_any_rig(rig))
    if config is not None:
        held = replace(held, config_text=read_config(config).text)
    rectangles, views = views_of(held, recording, framesets)
    moves = find_moved(held.rig, rectangles, views, false_alarms)
    if out_of_step(held.rig):
        note(
            "Views of this rig disagree by far more than their sigmas (cameras out of step, or a bent rectangle), so "
            "that small moves may be reported that are none"
        )
    if as_json:
        print(json_text(move_values(moves, false_alarms)))
    else:
        _print(moves)
    if all(move.state == "cannot tell" for move in moves):
        raise QuadrigError(f"{recording[0]}: whether a camera has moved cannot be determined; {moves[0].why}")
    if any(move.state == "moved" for move in moves):
        raise typer.Exit(MOVED)


def _print(moves: Sequence[CameraMove]) -> None:
    from quadrig.io.report.terminal import print_sentence

    where = console()
    for move in moves:
        print_sentence(sentence(move), where, style="bold red" if move.state == "moved" else None)
    if any(move.state == "moved" for move in moves):
        print_sentence(ONE_SIGMA, where)


def move_values(moves: Sequence[CameraMove], false_alarms: float) -> dict:
    """The answers for programs: lengths in mm, angles in degrees, nan where nothing is known."""
    return {
        "moved": [move.name for move in moves if move.state == "moved"],
        "false_alarms": false_alarms,
        "cameras": {move.name: _values(move) for move in moves},
    }


def sentence(move: CameraMove) -> str:
    """The answer for one camera in words."""
    if move.state == "cannot tell":
        return f"{move.name}: cannot tell: {move.why}"
    if move.state == "unmoved":
        return f"{move.name}: unmoved (a shift of {length(move.found)} would have been found)"
    others = [*move.instead, *(["the focus of its lens (autofocus)"] if move.refocused else [])]
    instead = f", unless it was {' or '.join(others)}" if others else ""
    return (
        f"{move.name}: moved by {with_sigma(1e3 * move.shift, 1e3 * move.shift_sigma)} mm and "
        f"{with_sigma(np.degrees(move.rotation), np.degrees(move.rotation_sigma))} degrees{instead}"
    )


def _values(move: CameraMove) -> dict:
    return {
        "state": move.state,
        "shift_mm": 1e3 * move.shift,
        "shift_sigma_mm": 1e3 * move.shift_sigma,
        "turn_deg": np.degrees(move.rotation),
        "turn_sigma_deg": np.degrees(move.rotation_sigma),
        "chance": move.chance,
        "would_be_found_mm": 1e3 * move.found,
        "instead": list(move.instead),
        "or_refocused": move.refocused,
        "why": move.why,
    }
