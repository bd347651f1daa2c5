"""Which markings a recording shows in plain sight, before anybody described one."""

from dataclasses import dataclass

import numpy as np

from quadrig.io.progress import progress_bar
from quadrig.io.recording.image_source import ImageSource
from quadrig.io.recording.recorded_cameras import Recording
from quadrig.io.workers import run_tasks
from quadrig.single.arrays import Picture
from quadrig.single.markings.in_sight import Sighting, markings_in_sight, together

# Images of each camera that are looked at: what is shown for long is in one of them.
_SAMPLES = 5


@dataclass(frozen=True, eq=False)
class _Task:
    source: ImageSource


def recording_in_sight(recording: Recording, workers: int | None = None) -> tuple[tuple[Sighting, ...], int]:
    """The markings that stand out in a recording, and how many images were looked at: see markings_in_sight."""
    tasks, looked_at = [], 0
    for camera in recording.cameras:
        sample = np.unique(np.linspace(0, camera.frames - 1, min(_SAMPLES, camera.frames)).round().astype(int))
        tasks.append(_Task(camera.source.part(sample)))
        looked_at += len(sample)
    found: list[tuple[Sighting, ...]] = []
    with progress_bar("look", len(tasks), "cameras") as advance:
        for _, markings in run_tasks(_look, tasks, workers):
            found.append(markings)
            advance(1)
    return together(found), looked_at


def _look(task: _Task) -> tuple[Sighting, ...]:
    pictures: list[Picture] = [image for image in task.source.images() if image is not None]
    return markings_in_sight(pictures)
