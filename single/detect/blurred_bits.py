"""Which tag a quadrilateral shows, where blur runs over its cells.

A cell that is a blur or two wide has no grey value of its own that a threshold could tell from its neighbours'. But
what each tag would look like through the blur is known: all pixels of a quadrilateral are held against that at once.
"""

from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask, Picture, Singles
from quadrig.single.detect.dictionaries import tag_cells
from quadrig.single.subpixel.blurred_step import standard_normal
from quadrig.single.subpixel.local_homography import mapped, square_homographies

# Blurs, in cells, that tags are imagined in: what lies between differs little.
_BLURS, _BETWEEN = (0.15, 0.35, 0.55, 0.75), 0.1
# Places along a cell's side at which a picture is looked at.
_FINE = 2
# Correlation of what is seen with what a tag would look like: at least so that one in 10,000 quadrilaterals of noise
# reads as some tag of those looked for (Fisher's z, with as many measurements as bits), and at least so much. A tag
# of a board has its neighbours to agree with. One that is alone has not, and what is blurred is not noise: as clutter
# has it (tags of other dictionaries), it measures as much as half as many bits.
_CHANCE, _ALIKE, _ALIKE_ALONE, _TOLD_ALONE = 1e-4, 0.85, 0.88, 0.5
# Share of what one tag leaves unexplained that the next best leaves at least as much more.
_NEXT_BEST = 2.0
# Grey levels from the border to the white around it.
_LEAST_CONTRAST = 12.0
# Bits vary by as much of that as the tag's would: of tags of real cameras 99 % by 0.85 of it or more, while shades on
# a black square do by a tenth or two. And they are as light as the tag's: of real ones 99 % to 0.1 of the contrast.
_LEAST_VARIED, _DARKER = 0.8, 0.15
# Share of the border's cells that may be less than so much of the contrast darker than the white beside them (of real
# blurred tags 99 % have a fifth at most), and standard deviation of these steps over the contrast (0.75; clutter: 1).
_BROKEN, _LEAST_STEP, _UNLIKE = 0.25, 0.25, 0.8


@dataclass(frozen=True, eq=False)
class _Imagined:
    """Every tag in each of four turns and in each blur: by blur, by turn, by tag.

    looks (M, blurs x 4 T): of mean 0 and length 1. varied, bright (blurs x 4 T,): standard deviation of their bits,
    and by how much these are at least lighter than the border in the mean, over the contrast of border and paper.
    least, least_alone: correlation of a quadrilateral that shows one, of a board or alone.
    """

    looks: Singles
    varied: Singles
    bright: Singles
    least: float
    least_alone: float


@lru_cache(maxsize=64)
def _imagined(dictionary: str, wanted: tuple[int, ...], border: int) -> _Imagined:
    cells = np.stack([tag_cells(dictionary, tag, border) for tag in wanted])
    turned = np.stack([np.rot90(cells, turn, axes=(1, 2)) for turn in range(4)])
    white = np.pad(turned, ((0, 0), (0, 0), (1, 1), (1, 1)), constant_values=True).astype(np.float32)
    bits, tags = (cells.shape[1] - 2 * border) ** 2, 4 * len(cells)
    seen, varied, bright = [], [], []
    for blur in _BLURS:
        spread = _spread(cells.shape[1], border, blur)
        looks = (spread @ white @ spread.T).reshape(tags, -1)
        black, paper = _black_and_paper(blur, border)
        seen.append(looks)
        varied.append(looks.std(axis=1) / (paper - black))
        black, paper = _black_and_paper(blur + _BETWEEN, border)
        bright.append((looks.mean(axis=1) - black) / (paper - black))
    flat = np.concatenate(seen)
    flat -= flat.mean(axis=1, keepdims=True)
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-6)
    return _Imagined(
        np.ascontiguousarray(flat.T),
        np.concatenate(varied),
        np.concatenate(bright),
        max(_least_alike(bits, tags), _ALIKE),
        max(_least_alike(_TOLD_ALONE * bits, tags), _ALIKE_ALONE),
    )


def _black_and_paper(blur: float, border: int) -> tuple[float, float]:
    """Light in the middle of the border, beyond whose edges are paper and half as much, and beside it."""
    return 1.5 * NormalDist().cdf(-0.5 * border / blur), NormalDist().cdf(0.5 / blur)


def _spread(cells: int, border: int, blur: float) -> Singles:
    """How much (K, cells + 2) of each cell, the white ring's among them, is seen at each place along the bits."""
    places = border + 1 + (np.arange(_FINE * (cells - 2 * border)) + 0.5) / _FINE
    # Paper goes on beyond the ring.
    lines = np.concatenate([[-1e3], np.arange(1.0, cells + 2), [1e3]])
    below = standard_normal(((lines - places[:, None]) / blur).astype(np.float32))[0]
    return np.diff(below, axis=1)


def _least_alike(measured: float, tags: int) -> float:
    deviations = NormalDist().inv_cdf(1 - _CHANCE / tags)
    return float(np.tanh(deviations / np.sqrt(measured - 3)))


def read_tags(
    grey: Picture, quads: Floats, dictionary: str, wanted: tuple[int, ...], alone: Mask, border: int
) -> tuple[Ints, Floats]:
    """Of quadrilaterals (N, 4, 2) px, clockwise, the index (N,) among the wanted tags of the one that each shows, -1
    where it shows none, and its corners (N, 4, 2), top left first on the print. alone: which of the wanted tags are
    on no board."""
    imagined, tags = _imagined(dictionary, wanted, border), len(wanted)
    cells = int(np.sqrt(len(imagined.looks))) // _FINE + 2 * border
    bits, black, white = _looked_at(grey, quads, cells, border)
    step, dark = white - black, np.median(black, axis=1)
    contrast = np.maximum(np.median(white, axis=1) - dark, 1e-3)
    mean, varied = bits.mean(axis=1), np.maximum(bits.std(axis=1), 1e-6)
    looks = (bits - mean[:, None]) / (varied * np.sqrt(bits.shape[1]))[:, None]
    alike = (looks @ imagined.looks).reshape(len(quads), len(_BLURS), 4 * tags)
    by_tag, each = alike.max(axis=1), np.arange(len(quads))
    best = by_tag.argmax(axis=1)
    turn, tag = best // tags, best % tags
    look = alike[each, :, best].argmax(axis=1) * 4 * tags + best
    most = by_tag[each, best]
    by_tag[each, best] = 0
    good = most > np.where(alone[tag], imagined.least_alone, imagined.least)
    good &= 1 - by_tag.max(axis=1) ** 2 > _NEXT_BEST * (1 - most**2)
    good &= (contrast > _LEAST_CONTRAST) & (varied > _LEAST_VARIED * imagined.varied[look] * contrast)
    good &= mean - dark > (imagined.bright[look] - _DARKER) * contrast
    good &= np.mean(step < _LEAST_STEP * contrast[:, None], axis=1) <= _BROKEN
    good &= step.std(axis=1) < _UNLIKE * contrast
    # What is turned counterclockwise by so many quarters has its top left corner so many corners back.
    corners = np.take_along_axis(quads, ((np.arange(4) - turn[:, None]) % 4)[..., None], axis=1)
    return np.where(good, tag, -1), corners


def _looked_at(grey: Picture, quads: Floats, cells: int, border: int) -> tuple[Singles, Singles, Singles]:
    """Grey levels over the bits of quadrilaterals (N, M), and beside their edges, (N, 4 cells) each: of their borders
    and of the white around."""
    inner = (border + (np.arange(_FINE * (cells - 2 * border)) + 0.5) / _FINE) / cells
    grid = np.stack(np.meshgrid(inner, inner), axis=-1).reshape(-1, 2)
    rings = [ring(cells, 0.5 * border), ring(cells, -0.5)]
    seen = mapped(square_homographies(quads), np.concatenate([grid, *rings]))
    places = np.nan_to_num(seen, nan=-1e3, posinf=-1e3, neginf=-1e3).astype(np.float32)
    x, y = places[..., 0], places[..., 1]
    levels = np.asarray(cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)
    bits, black, white = np.split(levels, [len(grid), len(grid) + len(rings[0])], axis=1)
    return bits, black, white


@lru_cache(maxsize=64)
def ring(cells: int, depth: float) -> Floats:
    """Places (4 cells, 2) so many cells within the edge of a unit square, one beside each cell: by side, from the top
    on and clockwise."""
    along = (np.arange(cells) + 0.5) / cells
    low, high = np.full(cells, depth / cells), np.full(cells, 1 - depth / cells)
    sides = [(along, low), (high, along), (along, high), (low, along)]
    return np.concatenate([np.stack(side, axis=1) for side in sides])
