"""A quick look at every image of a recording, small, to choose which are worth searching."""

from contextlib import closing
from dataclasses import dataclass, replace

import cv2
import numpy as np

from quadrig.io.progress import progress_bar
from quadrig.io.recording.framesets import NO_FRAME, Framesets
from quadrig.io.recording.image_source import ImageSource
from quadrig.io.recording.recorded_cameras import Recording
from quadrig.io.search.effort import EVERY_IMAGE, Effort
from quadrig.io.workers import run_tasks
from quadrig.rig.coach.select_frames import Looks, choose_framesets
from quadrig.single.arrays import Floats, Ints, Singles

# A JPEG shrinks to a quarter while it is decoded, in a third of the time; motion and focus still show.
_SHRINK = 4
# Thumbnails: a board that moved by a tenth of its size looks different from one that did not.
_SIZE = (32, 18)
_BATCH = 32
# Where a fifth or less of many framesets is wanted, every other one is looked at: its neighbour shows the same.
_SMALL_SHARE, _MANY = 0.2, 100


@dataclass(frozen=True, eq=False)
class _Batch:
    camera: int
    images: Ints
    source: ImageSource


def choose_frames(recording: Recording, framesets: Framesets, effort: Effort) -> Framesets:
    """The same framesets, but only the images of the chosen share of them: what find_views then searches.

    Indices of framesets stay as they are; a frameset that was not chosen has no images.
    """
    if effort.share >= 1:
        return framesets
    step = 2 if effort.share <= _SMALL_SHARE and len(framesets) >= _MANY else 1
    some = replace(framesets, times=framesets.times[::step], frames=framesets.frames[::step])
    chosen = step * choose_framesets(look_at(recording, some, effort), step * effort.share)
    frames = np.full_like(framesets.frames, NO_FRAME)
    frames[chosen] = framesets.frames[chosen]
    return replace(framesets, frames=frames)


def look_at(recording: Recording, framesets: Framesets, effort: Effort = EVERY_IMAGE) -> Looks:
    """Thumbnails and sharpness of all images of the framesets."""
    shape = framesets.frames.shape
    thumbnails = np.full((*shape, _SIZE[1], _SIZE[0]), np.nan, np.float32)
    sharpness = np.full(shape, np.nan)
    batches, rows = [], []
    for column, name in enumerate(framesets.cameras):
        source = recording.camera(name).source
        sets, images = framesets.of_camera(name)
        for part in source.batches(images, _BATCH):
            batches.append(_Batch(column, part, source.part(part)))
            rows.append(sets[np.searchsorted(images, part)])
    total = sum(len(batch.images) for batch in batches)
    with (
        closing(run_tasks(_look, batches, effort.workers, effort.executor)) as results,
        progress_bar("look", total, "images", quiet=not effort.progress) as advance,
    ):
        for index, (small, sharp) in results:
            thumbnails[rows[index], batches[index].camera] = small
            sharpness[rows[index], batches[index].camera] = sharp
            advance(len(sharp))
    return Looks(thumbnails, sharpness)


def _look(batch: _Batch) -> tuple[Singles, Floats]:
    """Thumbnails (N, h, w) and sharpness (N,) of the images of a batch; nan where they are unreadable."""
    small = np.full((len(batch.images), _SIZE[1], _SIZE[0]), np.nan, np.float32)
    sharp = np.full(len(batch.images), np.nan)
    for k, image in enumerate(batch.source.images(shrink=_SHRINK)):
        if image is not None:
            small[k] = cv2.resize(image, _SIZE, interpolation=cv2.INTER_AREA)
            sharp[k] = np.sqrt(np.mean(cv2.Laplacian(image, cv2.CV_32F) ** 2))
    return small, sharp
