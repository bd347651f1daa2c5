"""Framesets: which images of a recording belong to one instant."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.io.recording.recorded_cameras import Recording
from quadrig.single.arrays import Ints
from quadrig.single.errors import QuadrigError

NO_FRAME = -1
"""In Framesets.frames: this camera has no image of this instant."""


@dataclass(frozen=True)
class CameraReport:
    """What became of one camera's images. offset: median of its stamps minus the framesets' times, s.

    used: images in a frameset with at least one other camera; dropped: the others.
    """

    camera: str
    frames: int
    used: int
    dropped: int
    offset: float


@dataclass(frozen=True, eq=False)
class Framesets:
    """The instants of a recording.

    times (S,) int64 ns, rising; frames (S, C): index of each camera's image, or NO_FRAME; cameras in the order of
    the recording. tolerance: s, the most that an image's stamp differs from its frameset's time.
    """

    cameras: tuple[str, ...]
    times: Ints
    frames: Ints
    tolerance: float
    report: tuple[CameraReport, ...]

    def __len__(self) -> int:
        return len(self.times)

    def sizes(self) -> Ints:
        """How many cameras each frameset has (S,)."""
        return np.count_nonzero(self.frames != NO_FRAME, axis=1)

    def of_camera(self, camera: str) -> tuple[Ints, Ints]:
        """Indices of the framesets that have an image of this camera, and of those images, by rising image."""
        column = self.frames[:, self.cameras.index(camera)]
        framesets = np.flatnonzero(column != NO_FRAME)
        order = np.argsort(column[framesets], kind="stable")
        return framesets[order], column[framesets[order]]


def build_framesets(recording: Recording, tolerance: float | None = None, quick: bool = False) -> Framesets:
    """Group the images of a recording by nearest time stamps.

    tolerance: s; without it half the usual interval of the camera that sets the time (see match_stamps).
    quick: by the times of recording, for a first look that does not touch the images.
    Raises QuadrigError where the tolerance is not a length of time.
    """
    if tolerance is not None and not (np.isfinite(tolerance) and tolerance >= 0):
        raise QuadrigError(f"tolerance of framesets is {tolerance} s; give zero or more seconds")
    cameras = recording.cameras
    stamps = [camera.source.quick_stamps() if quick else camera.stamps for camera in cameras]
    limit = _own_tolerance(stamps) if tolerance is None else round(tolerance * 1e9)
    times, frames = match_stamps(stamps, limit)
    shared = np.count_nonzero(frames != NO_FRAME, axis=1) > 1
    names = tuple(camera.name for camera in cameras)
    report = []
    for column, name in enumerate(names):
        used = shared & (frames[:, column] != NO_FRAME)
        offsets = (stamps[column][frames[used, column]] - times[used]) / 1e9
        count = int(np.count_nonzero(used))
        offset = float(np.median(offsets)) if count else float("nan")
        report.append(CameraReport(name, len(stamps[column]), count, len(stamps[column]) - count, offset))
    return Framesets(names, times, frames, limit / 1e9, tuple(report))


def match_stamps(stamps: Sequence[Ints], tolerance: int) -> tuple[Ints, Ints]:
    """Times (S,) and frames (S, C) of the instants of cameras with these stamps (F_c,) int64 ns.

    The camera with the most images sets the instants, so that a slower one joins every second or third of them;
    where it has none (it started late, or dropped one) the camera with the next most images does. Each image joins
    the nearest instant within the tolerance, and of several images of a camera the nearest has it.
    """
    frames = np.zeros((0, len(stamps)), np.int64)
    times = np.zeros(0, np.int64)
    for column in sorted(range(len(stamps)), key=lambda k: (-len(stamps[k]), k)):
        free = np.ones(len(stamps[column]), bool)
        rows, images = _nearest_pairs(times, stamps[column], tolerance)
        frames[rows, column] = images
        free[images] = False
        own = np.full((np.count_nonzero(free), len(stamps)), NO_FRAME, np.int64)
        own[:, column] = np.flatnonzero(free)
        frames, times = np.vstack([frames, own]), np.concatenate([times, stamps[column][free]])
        order = np.argsort(times, kind="stable")
        frames, times = frames[order], times[order]
    return times, frames


def _nearest_pairs(times: Ints, stamps: Ints, tolerance: int) -> tuple[Ints, Ints]:
    """Pairs (instant, image) that are each other's nearest and within the tolerance. times rise."""
    if len(times) == 0 or len(stamps) == 0:
        return np.zeros(0, int), np.zeros(0, int)
    nearest = _nearest(times, stamps)
    distance = np.abs(times[nearest] - stamps)
    order = np.lexsort((distance, nearest))
    first = np.ones(len(order), bool)
    first[1:] = nearest[order][1:] != nearest[order][:-1]
    images = order[first]
    images = images[distance[images] <= tolerance]
    return nearest[images], images


def _nearest(times: Ints, stamps: Ints) -> Ints:
    """Index of the nearest of the rising times to each stamp."""
    after = np.clip(np.searchsorted(times, stamps), 1, max(len(times) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    return np.where(np.abs(times[after] - stamps) < np.abs(times[before] - stamps), after, before)


def _own_tolerance(stamps: Sequence[Ints]) -> int:
    """Half the median interval of the camera with the most images, ns: farther off, its next image is nearer."""
    fullest = np.sort(max(stamps, key=len))
    intervals = np.diff(fullest)
    intervals = intervals[intervals > 0]
    return int(np.median(intervals) / 2) if len(intervals) else 10**9
