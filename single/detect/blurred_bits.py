"""Which tag a quadrilateral shows, where blur runs over its cells.

A cell that is a blur or two wide has no grey value of its own that a threshold could tell from its neighbours'. But
what each tag would look like through the blur is known: all pixels of a quadrilateral are held against that at once.
"""

from functools import lru_cache

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Ints, Picture, Singles
from quadrig.single.detect.dictionaries import tag_cells
from quadrig.single.subpixel.blurred_step import standard_normal
from quadrig.single.subpixel.local_homography import local_homographies, mapped

# Blurs, in cells, that tags are imagined in: what lies between differs little.
_BLURS = (0.15, 0.4, 0.65)
# Places along a cell's side at which a picture is looked at.
_FINE = 2
# Correlation of what is seen with what a tag would look like: at least so that one in 10,000 quadrilaterals of noise
# reads as some tag of those looked for (Fisher's z, with as many measurements as bits), and at least so much, for
# clutter is not noise: tags of other dictionaries reach 0.82 with one of twenty. Blurred tags have 0.86 in 95 %.
_CHANCE, _ALIKE = 1e-4, 0.85
# Share of what one tag leaves unexplained that the next best leaves at least as much more.
_NEXT_BEST = 1.5
# Grey levels from the border to the white around it, and share of that by which bits vary at the least.
_LEAST_CONTRAST, _LEAST_VARIED = 12.0, 0.08


@lru_cache(maxsize=64)
def _imagined(dictionary: str, wanted: tuple[int, ...], border: int) -> tuple[Singles, float]:
    """Every tag in each of four turns and in each blur, (M, 4 T x blurs), of mean 0 and length 1: by blur, by
    turn, by tag. And the least correlation of a quadrilateral that shows one."""
    cells = np.stack([tag_cells(dictionary, tag, border) for tag in wanted])
    turned = np.stack([np.rot90(cells, turn, axes=(1, 2)) for turn in range(4)])
    white = np.pad(turned, ((0, 0), (0, 0), (1, 1), (1, 1)), constant_values=True).astype(np.float32)
    bits = cells.shape[1] - 2 * border
    seen = []
    for blur in _BLURS:
        spread = _spread(cells.shape[1], border, blur)
        seen.append((spread @ white @ spread.T).reshape(4 * len(cells), -1))
    flat = np.concatenate(seen)
    flat -= flat.mean(axis=1, keepdims=True)
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-6)
    return np.ascontiguousarray(flat.T), _least_alike(bits * bits, 4 * len(cells))


def _spread(cells: int, border: int, blur: float) -> Singles:
    """How much (K, cells + 2) of each cell, the white ring's among them, is seen at each place along the bits."""
    places = border + 1 + (np.arange(_FINE * (cells - 2 * border)) + 0.5) / _FINE
    # Paper goes on beyond the ring.
    lines = np.concatenate([[-1e3], np.arange(1.0, cells + 2), [1e3]])
    below = standard_normal(((lines - places[:, None]) / blur).astype(np.float32))[0]
    return np.diff(below, axis=1)


def _least_alike(bits: int, tags: int) -> float:
    from statistics import NormalDist

    deviations = NormalDist().inv_cdf(1 - _CHANCE / tags)
    return max(float(np.tanh(deviations / np.sqrt(bits - 3))), _ALIKE)


def read_tags(
    grey: Picture, quads: Floats, dictionary: str, wanted: tuple[int, ...], border: int
) -> tuple[Ints, Floats]:
    """Of quadrilaterals (N, 4, 2) px, clockwise, the index (N,) among the wanted tags of the one that each shows, -1
    where it shows none, and its corners (N, 4, 2), top left first on the print."""
    imagined, least = _imagined(dictionary, wanted, border)
    tags = imagined.shape[1] // (4 * len(_BLURS))
    cells = int(np.sqrt(len(imagined))) // _FINE + 2 * border
    seen, contrast = _looked_at(grey, quads, cells, border)
    seen -= seen.mean(axis=1, keepdims=True)
    varied = np.linalg.norm(seen, axis=1)
    alike = seen / np.maximum(varied, 1e-6)[:, None] @ imagined
    by_tag = alike.reshape(len(quads), len(_BLURS), 4 * tags).max(axis=1)
    best = by_tag.argmax(axis=1)
    most = by_tag.max(axis=1)
    others = by_tag.copy()
    others[np.arange(len(quads)), best] = -1
    apart = 1 - others.max(axis=1) ** 2 * (others.max(axis=1) > 0) > _NEXT_BEST * (1 - most**2)
    good = (most > least) & apart & (contrast > _LEAST_CONTRAST)
    good &= varied > _LEAST_VARIED * contrast * np.sqrt(seen.shape[1])
    turn, tag = best // tags, best % tags
    # What is turned counterclockwise by so many quarters has its top left corner so many corners back.
    corners = np.take_along_axis(quads, ((np.arange(4) - turn[:, None]) % 4)[..., None], axis=1)
    return np.where(good, tag, -1), corners


def _looked_at(grey: Picture, quads: Floats, cells: int, border: int) -> tuple[Singles, Singles]:
    """Grey levels (N, M) over the bits of quadrilaterals, and from their borders to the white around, (N,)."""
    unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) - 0.5
    image_from_unit = local_homographies(np.broadcast_to(unit, quads.shape), quads)
    inner = (border + (np.arange(_FINE * (cells - 2 * border)) + 0.5) / _FINE) / cells - 0.5
    grid = np.stack(np.meshgrid(inner, inner), axis=-1).reshape(-1, 2)
    rings = [_ring(cells, 0.5 * border), _ring(cells, -0.5)]
    places = np.nan_to_num(mapped(image_from_unit, np.concatenate([grid, *rings])), nan=-1e3).astype(np.float32)
    light, (x, y) = grey.astype(np.float32), (places[..., 0], places[..., 1])
    levels = np.asarray(cv2.remap(light, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)
    bits, black, white = np.split(levels, [len(grid), len(grid) + len(rings[0])], axis=1)
    return bits, np.median(white, axis=1) - np.median(black, axis=1)


def _ring(cells: int, depth: float) -> Floats:
    """Places (P, 2) so many cells within the edge of a unit square."""
    along = (np.arange(cells) + 0.5) / cells - 0.5
    side = np.full(cells, 0.5 - depth / cells)
    return np.concatenate(
        [np.stack(pair, axis=1) for pair in ((along, -side), (along, side), (-side, along), (side, along))]
    )
