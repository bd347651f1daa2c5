"""Which markings a recording shows in plain sight, before anybody described one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.io.progress import progress_bar
from quadrig.io.recording.image_source import ImageSource
from quadrig.io.recording.recorded_cameras import Recording
from quadrig.io.workers import run_tasks
from quadrig.single.arrays import Picture
from quadrig.single.markings.in_sight import markings_in_sight
from quadrig.single.rectangle import Marking

# Images of each camera that are looked at: what is shown for long is in one of them.
_SAMPLES = 5


@dataclass(frozen=True, eq=False)
class _Task:
    source: ImageSource


def recording_in_sight(recording: Recording, workers: int | None = None) -> tuple[Marking, ...]:
    """The markings that stand out in a recording, of unit size: see markings_in_sight."""
    tasks = []
    for camera in recording.cameras:
        sample = np.linspace(0, camera.frames - 1, min(_SAMPLES, camera.frames)).round().astype(int)
        tasks.append(_Task(camera.source.part(np.unique(sample))))
    found = []
    with progress_bar("look", len(tasks), "cameras") as advance:
        for _, markings in run_tasks(_look, tasks, workers):
            found.append(markings)
            advance(1)
    return together(found)


def together(found: Sequence[Sequence[Marking]]) -> tuple[Marking, ...]:
    """What several cameras show: of boards that bear the same tags the one seen whole, of tags each one once."""
    every = [marking for markings in found for marking in markings]
    boards = sorted((m for m in every if m.size is not None), key=_extent, reverse=True)
    kept: list[Marking] = []
    for marking in [*boards, *sorted((m for m in every if m.size is None), key=repr)]:
        if not any(_alike(marking, other) for other in kept):
            kept.append(marking)
    return tuple(kept)


def _look(task: _Task) -> tuple[Marking, ...]:
    pictures: list[Picture] = [image for image in task.source.images() if image is not None]
    return markings_in_sight(pictures)


def _extent(marking: Marking) -> float:
    width, height = marking.size or (0.0, 0.0)
    return width * height


def _alike(one: Marking, other: Marking) -> bool:
    """Whether two descriptions may be of one sheet: they bear the same tags, or are both chessboards."""
    if one.tags is None or other.tags is None:
        return one.kind == other.kind
    return one.tags.family == other.tags.family and bool(one.tags.ids & other.tags.ids)
