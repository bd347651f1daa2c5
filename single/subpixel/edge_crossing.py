"""Where two straight edges cross near a place that somebody pointed at: a corner of a line, a sheet, a window."""

from dataclasses import dataclass

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Picture

FARTHEST = 5.0
"""A crossing farther off (px) is not what was pointed at."""

# Half the side (px) of the window in which edges are looked for: a few times the farthest crossing, so that an edge
# that ends at the other one (a line that meets a line) is long enough to be extended.
_REACH = 18
# Gaussian (px) under the gradient: below it lies the noise of pixels, above it lines grow together.
_SMOOTH = 0.8
# Share of the window's steepest gradient, and grey levels a pixel, below which a slope is no edge.
_SHARE, _LEAST = 0.2, 3.0
# An edge's points lie this near (px) to a straight line and turn no more than this (cosine of 20 degrees) from it.
_NEAR, _ALONG = 0.8, 0.94
# Points (about a pixel apart) from which a line is sure, and lines looked for: two lines of paint have four edges.
_FEWEST, _LINES = 7, 8
# Rounds of fitting a line and choosing its points anew: the first line is that of a single point.
_ROUNDS = 3
# Edges that cross at less than this (sine of 15 degrees) do not say where along them.
_ANGLE = 0.26
# An edge reaches at least this near (px) to its crossing: twice the width of a line that it ends at.
_ENDS = 14.0


def nearest_crossing(grey: Picture, place: Floats) -> Floats | None:
    """The crossing (2,) of two straight edges nearest to a place (2,) px of a grey picture (h, w).

    None where there is none within FARTHEST. The two sides of a line of paint are two edges: which of their crossings
    is meant, the place says.
    """
    start = np.maximum(np.rint(place).astype(int) - _REACH, 0)
    window = grey[start[1] : start[1] + 2 * _REACH + 1, start[0] : start[0] + 2 * _REACH + 1]
    if min(window.shape) < _FEWEST:
        return None
    lines = _lines(*_edge_points(window))
    local = np.asarray(place, float) - start
    found = [
        crossing
        for index, one in enumerate(lines)
        for other in lines[:index]
        if (crossing := _crossing(one, other)) is not None and np.hypot(*(crossing - local)) <= FARTHEST
    ]
    return min(found, key=lambda crossing: float(np.hypot(*(crossing - local)))) + start if found else None


def _edge_points(window: Picture) -> tuple[Floats, Floats, Floats]:
    """Points (N, 2) px on edges to a part of a pixel, unit normals (N, 2) towards the light, weights (N,)."""
    smooth = cv2.GaussianBlur(window.astype(np.float64), (0, 0), _SMOOTH)
    gx, gy = (cv2.Sobel(smooth, cv2.CV_64F, *order, ksize=3) / 8 for order in ((1, 0), (0, 1)))
    steep = np.hypot(gx, gy)
    # The outermost pixels have no neighbours to compare with, nor a true gradient.
    inside = np.zeros_like(steep, bool)
    inside[2:-2, 2:-2] = True
    rows, columns = np.nonzero(inside & (steep > max(_SHARE * steep[inside].max(), _LEAST)))
    normals = np.stack([gx[rows, columns], gy[rows, columns]], axis=1) / steep[rows, columns][:, None]
    here = steep[rows, columns]
    before, after = (_sampled(steep, columns + s * normals[:, 0], rows + s * normals[:, 1]) for s in (-1, 1))
    top = (here >= before) & (here > after)
    bend = np.maximum(2 * here - before - after, 1e-9)
    shift = np.clip((after - before) / (2 * bend), -1, 1)
    points = np.stack([columns, rows], axis=1) + shift[:, None] * normals
    return points[top], normals[top], here[top]


def _sampled(image: Floats, x: Floats, y: Floats) -> Floats:
    if not len(x):
        return np.zeros(0)
    return cv2.remap(image, x.astype(np.float32)[None], y.astype(np.float32)[None], cv2.INTER_LINEAR)[0]


@dataclass(frozen=True, eq=False)
class _Line:
    """A straight edge: its middle (2,), the unit normal (2,) towards the light, and its points (N, 2)."""

    middle: Floats
    normal: Floats
    points: Floats


def _lines(points: Floats, normals: Floats, weights: Floats) -> list[_Line]:
    """The straight edges, those with most points first."""
    left, lines = np.ones(len(points), bool), []
    while left.sum() >= _FEWEST and len(lines) < _LINES:
        rest, sense, weight = points[left], normals[left], weights[left]
        fits = np.abs(np.einsum("ijk,ik->ij", rest[None] - rest[:, None], sense)) < _NEAR
        fits &= sense @ sense.T > _ALONG
        first = np.argmax(fits.sum(axis=1))
        line, chosen = _Line(rest[first], sense[first], rest), fits[first]
        for _ in range(_ROUNDS):
            if chosen.sum() < _FEWEST:
                return lines
            line = _through(rest[chosen], sense[chosen], weight[chosen])
            chosen = (np.abs((rest - line.middle) @ line.normal) < _NEAR) & (sense @ line.normal > _ALONG)
        lines.append(line)
        left[np.flatnonzero(left)[chosen]] = False
    return lines


def _through(points: Floats, normals: Floats, weights: Floats) -> _Line:
    """The line that weighted points lie on best."""
    middle = np.average(points, axis=0, weights=weights)
    off = (points - middle) * np.sqrt(weights)[:, None]
    normal = np.linalg.eigh(off.T @ off)[1][:, 0]
    return _Line(middle, normal * np.sign(normal @ normals.mean(axis=0)), points)


def _crossing(one: _Line, other: _Line) -> Floats | None:
    normals = np.stack([one.normal, other.normal])
    if abs(np.linalg.det(normals)) < _ANGLE:
        return None
    crossing = np.asarray(np.linalg.solve(normals, [one.normal @ one.middle, other.normal @ other.middle]), float)
    ends = max(np.hypot(*(line.points - crossing).T).min() for line in (one, other))
    return crossing if ends < _ENDS else None
