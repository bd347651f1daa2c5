"""A recording made after a rig was calibrated: what it shows of the rig's rectangles to the rig's cameras."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from quadrig.io.config.rig_toml import parse_config
from quadrig.io.recording.camera import RecordedCamera
from quadrig.io.recording.framesets import build_framesets
from quadrig.io.recording.recorded_cameras import Recording, open_recording
from quadrig.io.rig_file.rig_mcap import RigFile
from quadrig.io.search.detections import find_views
from quadrig.rig.result import Rig
from quadrig.single.arrays import Ints
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# Consecutive framesets that show how a rectangle moves, with some to spare at both ends.
_RUN = 20


def views_of(held: RigFile, paths: Sequence[Path], most: int) -> tuple[tuple[Rectangle, ...], list[View]]:
    """The rig's rectangles, and what a recording shows of them to its cameras in so many framesets.

    Raises QuadrigError where the recording cannot be read or has no camera of the rig.
    """
    rectangles = {placed.name: placed.rectangle for placed in held.rig.rectangles}
    names: dict[str, str] = {}
    if held.config_text.strip():
        config = parse_config(held.config_text, "the rig.toml in the rig file")
        rectangles = {one.name: one for one in config.rectangles} | rectangles
        names = {camera.topic: camera.name for camera in config.cameras if camera.topic is not None}
    # What stood still in several recordings has a name for each: it looks the same, and one name is enough.
    looks = {one.marking.marks or (name,): name for name, one in reversed(rectangles.items())}
    rectangles = {name: one for name, one in rectangles.items() if name in looks.values()}
    if not rectangles:
        raise QuadrigError("the rig's file holds no rectangles to look for; give their rig.toml with --config")
    recording = open_recording(paths)
    recording = replace(recording, cameras=_cameras_of_rig(recording, held.rig, names))
    every = build_framesets(recording)
    chosen = spread_runs(len(every), most)
    part = replace(every, times=every.times[chosen], frames=every.frames[chosen])
    return tuple(rectangles.values()), find_views(recording, part, list(rectangles.values()))


def _cameras_of_rig(recording: Recording, rig: Rig, names: Mapping[str, str]) -> tuple[RecordedCamera, ...]:
    """The recording's cameras that the rig has; names: of cameras by topic, where rig.toml gives them."""
    known = {camera.name: camera.intrinsics for camera in rig.cameras}
    named = [replace(camera, name=names.get(camera.topic, camera.name)) for camera in recording.cameras]
    cameras = tuple(camera for camera in named if camera.name in known)
    if not cameras:
        seen = ", ".join(camera.name for camera in recording.cameras)
        raise QuadrigError(
            f"{recording.paths[0]}: its cameras are {seen}, the rig's are {', '.join(known)}; give its recording"
        )
    for camera in cameras:
        lens = known[camera.name]
        if (camera.width, camera.height) != (lens.width, lens.height):
            raise QuadrigError(
                f"camera {camera.name!r} records {camera.width}x{camera.height}, the rig has it at "
                f"{lens.width}x{lens.height}; record at the size of the calibration"
            )
    return cameras


def spread_runs(count: int, most: int) -> Ints:
    """Indices of at most so many of `count` framesets, in runs that are spread over all: in a run the paths of moving
    rectangles are determined, and with them the clocks of cameras that are out of step."""
    if count <= most:
        return np.arange(count)
    length_of_run = min(_RUN, most)
    starts = np.linspace(0, count - length_of_run, max(most // length_of_run, 1)).round().astype(int)
    return np.unique(starts[:, None] + np.arange(length_of_run))
