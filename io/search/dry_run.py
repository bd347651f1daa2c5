"""What a calibration would search, and how long that takes, without searching it: a few images are tried."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

import numpy as np

from quadrig.io.config.rig_toml import RigConfig
from quadrig.io.formats.any_file import KnownLens
from quadrig.io.recording.framesets import build_framesets
from quadrig.io.recording.recorded_cameras import Recording
from quadrig.io.search.corner_views import corner_views
from quadrig.io.search.detection_file import camera_key, read_detections
from quadrig.io.search.detections import BATCH, search_images
from quadrig.io.search.effort import Effort
from quadrig.io.search.whole_recording import cache_of, open_checked
from quadrig.io.workers import default_workers
from quadrig.single.rectangle import Rectangle

# Images of each camera that are tried, one after the other in the middle of what it recorded.
_TRIED = 6


@dataclass(frozen=True)
class PlannedCamera:
    """A camera of a recording: its images, how many of them are to be searched, and s on one processor for them."""

    name: str
    width: int
    height: int
    images: int
    searched: int
    seconds: float


@dataclass(frozen=True)
class SearchPlan:
    """What would be done. sought: the rectangles that are looked for; workers: over how many processors.

    found: images of which was kept what they show; notes: on the recordings, in sentences.
    """

    cameras: tuple[PlannedCamera, ...]
    framesets: int
    sought: tuple[str, ...]
    workers: int
    found: int
    notes: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """Of the search over all workers; what comes after it is not known before."""
        return sum(camera.seconds for camera in self.cameras) / self.workers


def plan_search(
    paths: Sequence[Path],
    config: RigConfig,
    effort: Effort,
    *,
    lenses: Mapping[str, KnownLens] | None = None,
    keep_lenses: bool = False,
) -> SearchPlan:
    """What search_recording would do with the same arguments, and raise; nothing is written."""
    recordings, _, remarks = open_checked(paths, config, effort, lenses or {}, keep_lenses)
    sought = [rectangle for rectangle in config.rectangles if not rectangle.marking.by_hand]
    cameras: list[PlannedCamera] = []
    framesets = found = 0
    notes = list(remarks)
    for number, recording in enumerate(recordings):
        every = build_framesets(recording, effort.tolerance)
        notes += corner_views(config.corners, recording, every)[1]
        framesets += round(effort.share * len(every))
        keys = {camera.name: camera_key(camera, sought) for camera in recording.cameras}
        cache = cache_of(effort.cache, number)
        kept = read_detections(cache, keys, set_aside=False)[0] if cache is not None else {}
        for camera in recording.cameras:
            images = every.of_camera(camera.name)[1]
            missing = np.array([image for image in images.tolist() if (camera.name, image) not in kept], int)
            left = round(effort.share * len(missing)) if sought else 0
            found += len(images) - len(missing)
            each = _seconds(recording, camera.name, missing, sought) if left else 0.0
            cameras.append(PlannedCamera(camera.name, camera.width, camera.height, len(images), left, left * each))
        notes += recording.notes
    workers = effort.workers or default_workers()
    names = tuple(rectangle.name for rectangle in sought)
    return SearchPlan(tuple(cameras), framesets, names, workers, found, tuple(dict.fromkeys(notes)))


def _seconds(recording: Recording, name: str, images: np.ndarray, sought: Sequence[Rectangle]) -> float:
    """s that an image of a camera takes on one processor."""
    camera = recording.camera(name)
    size = (camera.width, camera.height)
    middle = max(0, (len(images) - _TRIED) // 2)
    run = images[middle : middle + _TRIED]
    times = []
    # The first image of a batch is searched whole, the others where the one before showed something.
    for part in (run[:1], run):
        source, began = camera.source.part(part), monotonic()
        search_images(source, part, sought, size)
        times.append(monotonic() - began)
    whole, all_of_them = times
    if len(run) == 1:
        return whole
    following = max(all_of_them - whole, 0.0) / (len(run) - 1)
    return (whole + (BATCH - 1) * following) / BATCH


def plan_words(plan: SearchPlan) -> str:
    """The plan as a person reads it."""
    lines = [
        f"{camera.name}: {camera.images} images of {camera.width}x{camera.height}, {camera.searched} to search"
        for camera in plan.cameras
    ]
    for_what = f" for {', '.join(plan.sought)}" if plan.sought else ": all corners are given by hand"
    searched = sum(camera.searched for camera in plan.cameras)
    lines.append(f"{plan.framesets} framesets, {searched} images to search{for_what}")
    if plan.found:
        lines.append(f"{plan.found} images were searched before; what was kept of them is used")
    if searched:
        lines.append(f"about {_duration(plan.seconds)} over {plan.workers} processors, then the solution")
    return "\n".join(lines)


def plan_values(plan: SearchPlan) -> dict[str, object]:
    """The plan for programs."""
    return {
        "cameras": {
            one.name: {"width": one.width, "height": one.height, "images": one.images, "to_search": one.searched}
            for one in plan.cameras
        },
        "framesets": plan.framesets,
        "rectangles": list(plan.sought),
        "searched_before": plan.found,
        "workers": plan.workers,
        "search_seconds": plan.seconds,
    }


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} minutes" if seconds < 5400 else f"{seconds / 3600:.1f} hours"
