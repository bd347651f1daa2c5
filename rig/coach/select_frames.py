"""Which framesets are worth searching: those that are still and sharp, and show what no other chosen one shows.

Views of one place repeat each other's systematic errors (the lens where it was not sampled, the moment at which a
moving sheet was caught), so that a tenth of the images, well chosen, determines nearly as much as all of them.
"""

import warnings
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from quadrig.single.arrays import Floats, Ints

# A hand-held sheet rests for this share of the time or more; images with more motion than that count the less.
_CALM = 0.3
# A neighbourhood in which sharpness is compared: longer, and a scene's change would count as blur.
_NEIGHBOURS = 10
# The greedy choice compares all with all: of more framesets than this, only the best of each short stretch take part.
_MOST_CANDIDATES = 1500
# Fewer framesets than this are too few for a rig, whatever the share.
LEAST = 12


@dataclass(frozen=True, eq=False)
class Looks:
    """A quick look at every image: S framesets, C cameras.

    thumbnails (S, C, h, w): grey levels, nan where a camera has no image; sharpness (S, C): of the image, in any
    unit that rises with it; nan where there is none.
    """

    thumbnails: NDArray[np.floating]
    sharpness: Floats


def choose_framesets(looks: Looks, share: float) -> Ints:
    """Rising indices of the framesets chosen, about `share` of all and no fewer than LEAST.

    Greedy: each time the frameset is taken whose images, weighted by their quality, differ most from the nearest
    ones taken before (farthest-point sampling, Gonzalez 1985).
    """
    count = len(looks.sharpness)
    wanted = min(count, max(LEAST, round(share * count)))
    if wanted >= count:
        return np.arange(count)
    quality = image_quality(looks)
    candidates = _best_of_each_slot(quality.sum(axis=1), max(_MOST_CANDIDATES, 2 * wanted))
    chosen = _spread_out(quality[candidates], _features(looks.thumbnails)[candidates], wanted)
    return np.sort(candidates[chosen])


def _spread_out(quality: Floats, features: NDArray[np.float32], wanted: int) -> Ints:
    """Indices of the farthest points (S, C, D), weighted by quality (S, C)."""
    chosen = [int(np.argmax(quality.sum(axis=1)))]
    distance = np.full(quality.shape, np.finfo(float).max)
    while len(chosen) < wanted:
        apart = features - features[chosen[-1]]
        distance = np.minimum(distance, np.sqrt(np.mean(apart * apart, axis=2)))
        gain = (quality * distance).sum(axis=1)
        gain[chosen] = -1.0
        chosen.append(int(np.argmax(gain)))
    return np.array(chosen)


def _best_of_each_slot(quality: Floats, slots: int) -> Ints:
    """Index of the best of the framesets (S,) in each of so many stretches of time; all where they are no more."""
    if len(quality) <= slots:
        return np.arange(len(quality))
    edges = np.linspace(0, len(quality), slots + 1).round().astype(int)
    return np.array([begin + int(np.argmax(quality[begin:end])) for begin, end in pairwise(edges.tolist())])


def image_quality(looks: Looks) -> Floats:
    """How good each image is for measuring (S, C), 0 to 1: still against its camera's calmer images, and sharp
    against its neighbours in time; 0 where there is none."""
    motion = _motion(looks.thumbnails)
    with np.errstate(all="ignore"):
        usual = np.nan_to_num(np.array([_calm(column) for column in motion.T]))
        stillness = 1 / (1 + (motion / np.where(usual > 0, usual, 1.0)) ** 2) ** 2
        # Of an image without neighbours nobody knows whether it moved: as likely as not.
        stillness = np.where(np.isnan(motion), 0.5, stillness)
        sharpness = (looks.sharpness / _greatest_near(looks.sharpness)) ** 2
    return np.nan_to_num(stillness * sharpness)


def _motion(thumbnails: NDArray[np.floating]) -> Floats:
    """How much each image differs from the one before and the one after, the lesser of both worse (S, C)."""
    steps = np.sqrt(np.mean(np.diff(thumbnails, axis=0) ** 2, axis=(2, 3)))
    padded = np.concatenate([steps[:1], steps, steps[-1:]])
    # The exposure of an image lies between both steps.
    return np.fmax(padded[:-1], padded[1:])


def _features(thumbnails: NDArray[np.floating]) -> NDArray[np.float32]:
    """(S, C, D) what distinguishes images: each camera's thumbnails against their median over time."""
    count, cameras = thumbnails.shape[:2]
    with warnings.catch_warnings():
        # A camera without any image has no median, which is as it should be.
        warnings.simplefilter("ignore", RuntimeWarning)
        usual = np.nanmedian(thumbnails, axis=0)
    flat = np.nan_to_num(thumbnails - usual).reshape(count, cameras, -1)
    scale = np.sqrt(np.mean(flat * flat, axis=(0, 2), keepdims=True))
    # A camera that sees nothing change counts nothing, rather than its noise counting as much as a moving board.
    return (flat / np.maximum(scale, 1.0)).astype(np.float32)


def _calm(values: Floats) -> float:
    """The motion below which _CALM of a camera's images are."""
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, _CALM)) if len(finite) else 0.0


def _greatest_near(values: Floats) -> Floats:
    """Greatest value within _NEIGHBOURS before and after, along the first axis; nan counts as nothing."""
    filled = np.nan_to_num(values)
    padded = np.pad(filled, ((_NEIGHBOURS, _NEIGHBOURS), (0, 0)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1, axis=0)
    return np.maximum(windows.max(axis=-1), np.finfo(float).tiny)
