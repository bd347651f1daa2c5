"""`rig check`: has a camera of the rig moved?"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from quadrig.io.export.values import json_text
from quadrig.io.rig_file.rig_mcap import RigFile, read_rig_file
from quadrig.rig.doubt.verdict import out_of_step
from quadrig.rig.moved import CameraMove, find_moved
from quadrig.rig.words import length
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

MOVED = 3
"""Exit code where a camera has moved."""

# Consecutive framesets that show how a rectangle moves, with some to spare at both ends.
_RUN = 20


def check(
    rig: Annotated[Path, typer.Argument(help="The rig as it was calibrated.", metavar="RIG.mcap")],
    recording: Annotated[list[Path], typer.Argument(help="A new recording with rectangles in view.")],
    false_alarms: Annotated[
        float, typer.Option(min=1e-9, max=0.5, help="Chance of an alarm on a rig that did not move.")
    ] = 0.01,
    framesets: Annotated[int, typer.Option(min=1, help="Search at most this many framesets.")] = 120,
    as_json: Annotated[bool, typer.Option("--json", help="The answers as JSON.")] = False,
) -> None:
    """Find out from a new recording whether a camera has moved since the rig was calibrated.

    Exits with 0 where none moved, 3 where one did, 1 where it cannot be determined. Rectangles may stand elsewhere
    than they did; all cameras moving together is not seen.

    Example: rig check rig.mcap tonight.mcap --json
    """
    held = read_rig_file(rig)
    rectangles, views = views_of(held, recording, framesets)
    moves = find_moved(held.rig, rectangles, views, false_alarms)
    if out_of_step(held.rig):
        print(
            "note: Views of this rig disagree by far more than their sigmas (cameras out of step, or a bent "
            "rectangle), so that small moves may be reported that are none",
            file=sys.stderr,
        )
    print(json_text(move_values(moves, false_alarms)) if as_json else "\n".join(map(sentence, moves)))
    if all(move.state == "cannot tell" for move in moves):
        raise QuadrigError(f"{recording[0]}: whether a camera has moved cannot be determined; {moves[0].why}")
    if any(move.state == "moved" for move in moves):
        raise typer.Exit(MOVED)


def views_of(held: RigFile, paths: Sequence[Path], most: int) -> tuple[tuple[Rectangle, ...], list[View]]:
    """The rig's rectangles, and what a recording shows of them to its cameras in so many framesets.

    Raises QuadrigError where the recording cannot be read or has no camera of the rig.
    """
    from quadrig.io.config.rig_toml import parse_config
    from quadrig.io.recording.framesets import build_framesets
    from quadrig.io.recording.recorded_cameras import open_recording
    from quadrig.io.search.detections import find_views

    rectangles = {placed.name: placed.rectangle for placed in held.rig.rectangles}
    topics: dict[str, str | None] = {}
    if held.config_text.strip():
        config = parse_config(held.config_text, "the rig.toml in the rig file")
        rectangles = {one.name: one for one in config.rectangles} | rectangles
        topics = {camera.name: camera.topic for camera in config.cameras if camera.topic is not None}
    recording = open_recording(paths)
    names = {topic: name for name, topic in topics.items()}
    cameras = tuple(replace(camera, name=names.get(camera.topic, camera.name)) for camera in recording.cameras)
    known = {camera.name: camera.intrinsics for camera in held.rig.cameras}
    cameras = tuple(camera for camera in cameras if camera.name in known)
    if not cameras:
        seen = ", ".join(camera.name for camera in recording.cameras)
        raise QuadrigError(
            f"{paths[0]}: its cameras are {seen}, the rig's are {', '.join(known)}; give its recording"
        )
    for camera in cameras:
        lens = known[camera.name]
        if (camera.width, camera.height) != (lens.width, lens.height):
            raise QuadrigError(
                f"camera {camera.name!r} records {camera.width}x{camera.height}, the rig has it at "
                f"{lens.width}x{lens.height}; record at the size of the calibration"
            )
    recording = replace(recording, cameras=cameras)
    every = build_framesets(recording)
    chosen = spread_runs(len(every), most)
    part = replace(every, times=every.times[chosen], frames=every.frames[chosen])
    return tuple(rectangles.values()), find_views(recording, part, list(rectangles.values()))


def spread_runs(count: int, most: int) -> np.ndarray:
    """Indices of at most so many of `count` framesets, in runs that are spread over all: in a run the paths of moving
    rectangles are determined, and with them the clocks of cameras that are out of step."""
    if count <= most:
        return np.arange(count)
    length_of_run = min(_RUN, most)
    starts = np.linspace(0, count - length_of_run, max(most // length_of_run, 1)).round().astype(int)
    return np.unique(starts[:, None] + np.arange(length_of_run))


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
    instead = f", unless it was {' or '.join(move.instead)}" if move.instead else ""
    return (
        f"{move.name}: moved by {length(move.shift)} ± {length(move.shift_sigma)} and "
        f"{np.degrees(move.rotation):.3f} ± {np.degrees(move.rotation_sigma):.3f} degrees{instead}"
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
        "why": move.why,
    }
