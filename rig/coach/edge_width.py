"""How wide the edges in a picture are: what focus and motion do to them, whatever the picture shows."""

from dataclasses import dataclass

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Mask, Picture
from quadrig.single.view import View

# The two blurs (sigma, px) under which edges are compared: above a pixel's noise, below the cells of small tags.
_FINE, _COARSE = 1.0, 2.5
# Variance (px^2) that a central difference adds to either: it is a box two pixels wide.
_DIFFERENCE = 1 / 3
# Slopes below this (grey levels per px) are noise and shading; and below this part of the strongest, of no account.
_LEAST_SLOPE, _LEAST_SHARE = 1.6, 0.08
# The crest of an edge: slopes of at least this part of the greatest of their neighbours.
_CREST = 0.9
# Fewest places on edges of one direction whose median means anything.
_FEWEST = 16
# px round a View in which the edges of its border lie with their blur.
_MARGIN = 6


@dataclass(frozen=True)
class EdgeWidths:
    """Widths of edges as Gaussian sigmas, px: medians of the sharpest and of the most smeared direction, and of the
    sharpest tenth of all edges. nan where there are too few."""

    sharpest: float
    widest: float
    tenth: float


def edge_widths(grey: Picture, inside: Mask | None = None) -> EdgeWidths:
    """Widths of the edges in a picture (H, W), or of those at the pixels that are `inside` (H, W).

    A step of width s has a slope of 1 / sqrt(s^2 + b^2) under a blur of b: the ratio of the slopes under two blurs
    determines s (Zhuo and Sim 2011, "Defocus map estimation from a single image"). An edge near another of opposite
    step looks sharper than it is, never wider.
    """
    none = EdgeWidths(*[float("nan")] * 3)
    if min(grey.shape) < 4:
        return none
    fine, angle = _slope(grey, _FINE)
    coarse, _ = _slope(grey, _COARSE)
    if inside is not None:
        fine = np.where(inside, fine, 0)
    least = max(_LEAST_SLOPE, _LEAST_SHARE * float(np.percentile(fine[fine > 0], 99))) if fine.any() else 0
    crest = (fine > least) & (fine >= _CREST * cv2.dilate(fine, np.ones((5, 5), np.uint8)))
    if least <= 0 or np.count_nonzero(crest) < _FEWEST:
        return none
    widths = _width(fine[crest] / coarse[crest])
    sector = np.rint(angle[crest] / (np.pi / 4)).astype(int) % 4
    medians = [float(np.median(widths[sector == k])) for k in range(4) if np.count_nonzero(sector == k) >= _FEWEST]
    if not medians:
        return none
    return EdgeWidths(min(medians), max(medians), float(np.percentile(widths, 10)))


def view_edge_widths(grey: Picture, view: View) -> EdgeWidths:
    """Widths of the edges of the sheet of a View."""
    low = np.clip(np.floor(view.pixels.min(0)) - _MARGIN, 0, None).astype(int)
    high = np.ceil(view.pixels.max(0)).astype(int) + _MARGIN
    cut = grey[low[1] : high[1], low[0] : high[0]]
    mask = np.zeros(cut.shape, np.uint8)
    if not cut.size:
        return edge_widths(cut)
    hull = cv2.convexHull(np.round(view.pixels - low).astype(np.int32))
    cv2.fillConvexPoly(mask, hull, 1)
    return edge_widths(cut, cv2.dilate(mask, np.ones((2 * _MARGIN + 1,) * 2, np.uint8)) > 0)


def _slope(grey: Picture, blur: float) -> tuple[Floats, Floats]:
    """Greatest slope (H, W) of the blurred picture, grey levels per px, and its direction, rad."""
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), blur)
    across, down = (cv2.Sobel(smooth, cv2.CV_32F, *d, ksize=1, scale=0.5) for d in ((1, 0), (0, 1)))
    return np.asarray(cv2.magnitude(across, down), float), np.asarray(np.arctan2(down, across), float)


def _width(ratio: Floats) -> Floats:
    """Sigma, px, of steps whose slopes under the fine and the coarse blur have this ratio."""
    fine, coarse = _FINE**2 + _DIFFERENCE, _COARSE**2 + _DIFFERENCE
    # The ratio of a step without width, and one that noise alone lifts above that of a step without end.
    square = np.clip(ratio.astype(float), 1.02, np.sqrt(coarse / fine)) ** 2
    return np.sqrt(np.maximum((coarse - square * fine) / (square - 1), 0))
