"""From a recording to Views: every image of its framesets searched for the rectangles, over worker processes."""

import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from quadrig.io.progress import progress_bar
from quadrig.io.recording.framesets import Framesets
from quadrig.io.recording.image_source import ImageSource
from quadrig.io.recording.recorded_cameras import Recording
from quadrig.io.search.detection_file import (
    Found,
    camera_key,
    is_unfinished,
    keep_detections,
    read_detections,
)
from quadrig.io.search.effort import EVERY_IMAGE, Effort
from quadrig.io.whole_file import place_held
from quadrig.io.workers import run_tasks
from quadrig.single.arrays import Ints
from quadrig.single.detect.image_search import detect_views
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

BATCH = 32
"""Images of one task: about a second of work, so that the bar moves and an interrupted run loses little. The first of
them is searched whole, so that what was overlooked once is not overlooked for long."""
UNREADABLE = "cannot be read"
"""Why an image is left out that is None in its source."""

# Images this far apart (of 30 a second, a tenth) still show a rectangle near where it was.
_FOLLOWS = 3
# Batches that are looked at first, spread over a recording of many: where some 500 images show no rectangle, the
# description is wrong, and hours of search would find no more.
_PROBE, _FEW_BATCHES = 16, 48
# A worker takes as long to begin as it takes to search half as many pixels: two of them would end no sooner.
_FEW_PIXELS = 4_000_000


@dataclass(frozen=True, eq=False)
class Detections:
    """What the images of a recording showed. views: with camera and frameset.

    searched: images searched now; reused: images whose detections were kept; left_out: by camera and reason, the
    images that were not searched; remarks: on what was kept, in sentences.
    """

    views: list[View]
    searched: int
    reused: int
    left_out: dict[str, dict[str, list[int]]]
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Batch:
    camera: str
    images: Ints
    source: ImageSource
    rectangles: tuple[Rectangle, ...]
    size: tuple[int, int]


def find_views(
    recording: Recording, framesets: Framesets, rectangles: Sequence[Rectangle], effort: Effort = EVERY_IMAGE
) -> list[View]:
    """The Views of `find_detections`, in the order of framesets, cameras and detection."""
    return find_detections(recording, framesets, rectangles, effort).views


def find_detections(
    recording: Recording, framesets: Framesets, rectangles: Sequence[Rectangle], effort: Effort = EVERY_IMAGE
) -> Detections:
    """Search the images of the framesets for the rectangles.

    Ctrl-C ends the workers, keeps in effort.cache what was found, and says so. Where nothing at all is found, nothing
    is kept. Raises QuadrigError where the cache cannot be written or workers keep dying.
    """
    if not rectangles:
        return Detections([], 0, 0, {})
    with place_held(effort.cache) if effort.cache is not None else nullcontext():
        return _find_detections(recording, framesets, tuple(rectangles), effort)


def _find_detections(
    recording: Recording, framesets: Framesets, rectangles: tuple[Rectangle, ...], effort: Effort
) -> Detections:
    cache = effort.cache
    keys = {camera.name: camera_key(camera, rectangles) for camera in recording.cameras}
    found, remarks = read_detections(cache, keys) if cache is not None else ({}, [])
    batches = _batches(recording, framesets, rectangles, found)
    searched = sum(len(batch.images) for batch in batches)
    reused = sum(len(framesets.of_camera(camera.name)[1]) for camera in recording.cameras) - searched
    # A damaged file was set aside: what was whole of it is kept anew, as is what a run that was killed had found.
    if batches or remarks or (cache is not None and is_unfinished(cache)):
        done = _search(recording, batches, found, keys, effort)
        if done < searched:
            remarks = [
                *remarks,
                f"{done} of {searched} images, spread over all, show no rectangle: the search stopped",
            ]
        if cache is not None and not any(_shows(views) for views in found.values()):
            cache.unlink()
    _refuse_changed(recording, keys, rectangles, cache)
    views = _in_order(recording, framesets, found)
    return Detections(views, searched, reused, _left_out(framesets, found), tuple(remarks))


def _refuse_changed(
    recording: Recording, keys: Mapping[str, str], rectangles: Sequence[Rectangle], cache: Path | None
) -> None:
    """Raises QuadrigError where files are no longer those that were opened: what was found may be of either."""
    for camera in recording.cameras:
        try:
            same = camera_key(camera, rectangles) == keys[camera.name]
        except OSError as error:
            where = error.filename or ", ".join(str(path) for path in recording.paths)
            raise QuadrigError(
                f"{where} was there when the search began and cannot be read now; bring it back and run it again"
            ) from error
        if not same:
            if cache is not None:
                cache.unlink(missing_ok=True)
            where = ", ".join(str(path) for path in recording.paths)
            raise QuadrigError(
                f"{where}: the pictures of camera {camera.name!r} changed while they were searched; "
                "run it again when nothing writes there"
            )


def search_images(
    source: ImageSource, images: Ints, rectangles: Sequence[Rectangle], size: tuple[int, int]
) -> list[tuple[View, ...] | str]:
    """The Views of each image of a source, whose indices in the recording are given; why, where it is left out.

    size: width and height that the camera's images have, px; another is another lens, or another camera.
    Rectangles are looked for where the image before had them, which is several times quicker; the first image, and
    each that does not follow on another, is searched whole.
    """
    found: list[tuple[View, ...] | str] = []
    before: tuple[View, ...] | None = None
    previous = -_FOLLOWS - 1
    for index, image in zip(images.tolist(), source.images(), strict=True):
        near = before if index - previous <= _FOLLOWS else None
        before = None
        if image is None:
            found.append(UNREADABLE)
        elif image.shape[1::-1] != size:
            found.append(f"{image.shape[1]}x{image.shape[0]}, not {size[0]}x{size[1]}")
        else:
            before = tuple(detect_views(image, rectangles, near=near))
            found.append(before)
        previous = index
    return found


def _search_batch(batch: _Batch) -> list[tuple[View, ...] | str]:
    return search_images(batch.source, batch.images, batch.rectangles, batch.size)


def _batches(
    recording: Recording, framesets: Framesets, rectangles: tuple[Rectangle, ...], found: Found
) -> list[_Batch]:
    """What is left to search, in the order of framesets.

    A batch of which an image is missing is searched whole and forgotten in `found`: where an image lies in its batch
    says whether it is searched near the one before, and resuming shall give what one run gives.
    """
    batches: list[tuple[int, _Batch]] = []
    for camera in recording.cameras:
        sets, images = framesets.of_camera(camera.name)
        starts = dict(zip(images.tolist(), sets.tolist(), strict=True))
        for part in camera.source.batches(images, BATCH):
            keys = [(camera.name, image) for image in part.tolist()]
            if all(key in found for key in keys):
                continue
            for key in keys:
                found.pop(key, None)
            size = (camera.width, camera.height)
            batch = _Batch(camera.name, part, camera.source.part(part), rectangles, size)
            batches.append((starts[int(part[0])], batch))
    return [batch for _, batch in sorted(batches, key=lambda pair: pair[0])]


def _search(
    recording: Recording, batches: Sequence[_Batch], found: Found, keys: dict[str, str], effort: Effort
) -> int:
    """Fill `found`, and the cache as it grows; how many images were searched: not all, where those that are spread
    over the recording show no rectangle."""
    cache = effort.cache
    stamps = {camera.name: camera.stamps for camera in recording.cameras}
    total, done = sum(len(batch.images) for batch in batches), 0
    batches, enough = _spread_first(batches)
    workers = effort.workers or (1 if sum(map(_pixels, batches)) <= _FEW_PIXELS else None)
    shown, looked = any(_shows(views) for views in found.values()), 0
    try:
        with ExitStack() as stack:
            writer = stack.enter_context(keep_detections(cache, keys, found, stamps)) if cache else None
            results = stack.enter_context(closing(run_tasks(_search_batch, batches, workers, effort.executor)))
            advance = stack.enter_context(progress_bar("detect", total, "images", quiet=not effort.progress))
            for index, result in results:
                batch = batches[index]
                for image, views in zip(batch.images.tolist(), result, strict=True):
                    found[batch.camera, image] = views
                    shown = shown or _shows(views)
                    if writer is not None:
                        writer.write(batch.camera, image, int(stamps[batch.camera][image]), views)
                if writer is not None:
                    writer.flush()
                done += len(batch.images)
                advance(len(batch.images))
                looked += index < enough
                if looked == enough and not shown:
                    break
    except KeyboardInterrupt:
        kept = f"kept in {cache}; the same command goes on from there" if cache else "not kept"
        print(f"stopped: {done} of {total} images were searched, {kept}", file=sys.stderr)
        raise
    return done


def _spread_first(batches: Sequence[_Batch]) -> tuple[list[_Batch], int]:
    """The batches, some that are spread over the recording first, and the number of those; all where they are few."""
    if len(batches) <= _FEW_BATCHES:
        return list(batches), len(batches)
    probe = np.linspace(0, len(batches) - 1, _PROBE).round().astype(int)
    rest = np.setdiff1d(np.arange(len(batches)), probe)
    return [batches[index] for index in (*probe, *rest)], len(probe)


def _pixels(batch: _Batch) -> int:
    return len(batch.images) * batch.size[0] * batch.size[1]


def _shows(views: tuple[View, ...] | str) -> bool:
    """Whether an image that was searched shows a rectangle."""
    return not isinstance(views, str) and len(views) > 0


def _in_order(recording: Recording, framesets: Framesets, found: Found) -> list[View]:
    """Views by frameset, with the time of their image in seconds since the first frameset; nan without a clock."""
    stamps = {camera.name: camera.stamps for camera in recording.cameras}
    timed = {camera.name for camera in recording.cameras if camera.source.timed}
    views = []
    for column, camera in enumerate(framesets.cameras):
        sets, images = framesets.of_camera(camera)
        for frameset, image in zip(sets.tolist(), images.tolist(), strict=True):
            time = (int(stamps[camera][image]) - int(framesets.times[0])) / 1e9 if camera in timed else float("nan")
            here = found.get((camera, image), ())
            for view in () if isinstance(here, str) else here:
                views.append((frameset, column, replace(view, camera=camera, frameset=frameset, time=time)))
    return [view for _, _, view in sorted(views, key=lambda entry: entry[:2])]


def _left_out(framesets: Framesets, found: Found) -> dict[str, dict[str, list[int]]]:
    """Images by camera and reason."""
    left: dict[str, dict[str, list[int]]] = {}
    for camera in framesets.cameras:
        for image in framesets.of_camera(camera)[1].tolist():
            why = found.get((camera, image), ())
            if isinstance(why, str):
                left.setdefault(camera, {}).setdefault(why, []).append(image)
    return left
