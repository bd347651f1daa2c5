"""When pictures were taken: by their names, a rate that is given, the numbers they share, or EXIF; never made up."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from quadrig.io.recording.camera import RecordedCamera
from quadrig.io.recording.image_folder import ImageFiles
from quadrig.io.recording.image_source import Stamped
from quadrig.single.arrays import Ints
from quadrig.single.errors import QuadrigError

_SECOND = 10**9
# Cameras that were triggered together share their numbers but for a few that were lost or thrown away.
_SHARED = 0.5
# s; a camera's EXIF clock is set to a second or two, and stays as it is: the difference of two is nearly constant.
_CLOCK_SPREAD = 5.0


def with_times(cameras: Sequence[RecordedCamera], rate: float | None, notes: list[str]) -> list[RecordedCamera]:
    """The cameras, those of picture files without times in their names stamped by what is known of them.

    rate: pictures a second, None where not given. notes: takes a sentence that says how they were paired.
    Raises QuadrigError where the rate is none, or such pictures lie beside cameras that do have times.
    """
    if rate is not None and not (np.isfinite(rate) and rate > 0):
        raise QuadrigError(f"--rate {rate}: give the pictures a second of each camera, above zero")
    files = {camera.name: camera.source for camera in cameras if isinstance(camera.source, ImageFiles)}
    files = {name: source for name, source in files.items() if not source.timed}
    stamped = _stamped(files, rate, notes) if files else {}
    others = [camera.name for camera in cameras if camera.name not in files and camera.source.timed]
    untimed = [name for name, source in stamped.items() if not source.timed]
    if others and untimed:
        raise QuadrigError(
            f"the pictures of {untimed[0]!r} carry no time and those of {others[0]!r} do, so nobody knows which "
            "belong together; give --rate, or a table of times to rig record --timestamps"
        )
    return [replace(one, source=stamped[one.name]) if one.name in stamped else one for one in cameras]


def without_times(camera: RecordedCamera) -> RecordedCamera:
    """The camera as it was before with_times."""
    source = camera.source
    if isinstance(source, Stamped) and isinstance(source.source, ImageFiles):
        return replace(camera, source=source.source)
    return camera


def _stamped(files: dict[str, ImageFiles], rate: float | None, notes: list[str]) -> dict[str, Stamped]:
    counted = {name: np.arange(len(source), dtype=np.int64) for name, source in files.items()}
    numbers = {name: source.numbers for name, source in files.items()}
    paired = _share(numbers)
    if rate is not None:
        chosen = numbers if paired else counted
        stamps = {name: np.round(own * (_SECOND / rate)).astype(np.int64) for name, own in chosen.items()}
        return {name: Stamped(source, stamps[name]) for name, source in files.items()}
    # Singles, as rig pick has them, are of one instant.
    if all(len(source) == 1 for source in files.values()):
        if len(files) > 1 and len({name.rstrip("0123456789") for name in files}) == 1:
            notes.append(
                f"{len(files)} single pictures are taken as those of {len(files)} cameras at one instant; where one "
                "camera took them, give their folder"
            )
        return {name: Stamped(source, np.zeros(1, np.int64), timed=False) for name, source in files.items()}
    clocks = {name: source.taken for name, source in files.items()} if all(map(_has_clock, files.values())) else {}
    if clocks and (len(files) == 1 or _contradicts(numbers, clocks)):
        if len(files) > 1:
            notes.append(
                "pictures with the same number in their names were taken at other times by their EXIF, by "
                "which they are paired"
            )
        return {name: Stamped(source, source.taken) for name, source in files.items()}
    if paired:
        if len(files) > 1:
            notes.append("pictures with the same number in their names are taken as one instant; they carry no time")
        return {name: Stamped(source, numbers[name] * _SECOND, timed=False) for name, source in files.items()}
    ranges = ", ".join(f"{name} {own.min()} to {own.max()}" for name, own in numbers.items())
    what = f"the numbers in the pictures' names do not match between cameras ({ranges})"
    if clocks:
        notes.append(f"{what}; they are paired by the times in their EXIF")
        return {name: Stamped(source, source.taken) for name, source in files.items()}
    notes.append(
        f"{what}, and they carry no time, so no two are taken as one instant; where picture k of each camera is, in "
        "the order of their names, give --rate"
    )
    return _one_after_another(files)


def _one_after_another(files: dict[str, ImageFiles]) -> dict[str, Stamped]:
    """Stamps of which no two of different cameras agree: their order, as in a recording of one after the other."""
    result, begin = {}, 0
    for name, source in files.items():
        result[name] = Stamped(source, (begin + np.arange(len(source), dtype=np.int64)) * _SECOND, timed=False)
        # Farther than any tolerance that comes of the pictures' own intervals.
        begin += len(source) + 100
    return result


def _share(numbers: dict[str, Ints]) -> bool:
    """Whether every camera shares most of its numbers with the one that has the most."""
    fullest = max(numbers.values(), key=len)
    return all(len(np.intersect1d(own, fullest)) >= _SHARED * len(own) for own in numbers.values())


def _has_clock(source: ImageFiles) -> bool:
    """Whether EXIF distinguishes all of a camera's pictures, as whole seconds do not distinguish those of a burst."""
    return bool(np.all(source.taken > 0)) and len(np.unique(source.taken)) == len(source)


def _contradicts(numbers: dict[str, Ints], clocks: dict[str, Ints]) -> bool:
    """Whether pictures of one number were taken at other times: cameras that were used one after another."""
    for one, two in combinations(numbers, 2):
        _, first, second = np.intersect1d(numbers[one], numbers[two], return_indices=True)
        apart = (clocks[one][first] - clocks[two][second]) / _SECOND
        if len(apart) > 1 and np.ptp(apart) > _CLOCK_SPREAD:
            return True
    return False
