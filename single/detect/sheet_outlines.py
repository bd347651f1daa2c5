"""Where a sheet may lie: quadrilaterals of four straight edges that are each seen over a good part of their length.

Edges are put together from the line segments of a picture (von Gioi et al., LSD, 2010), which need no threshold for
all of it and feel a long faint edge. A segment knows on which of its sides it is brighter, so the four sides of a
sheet follow each other in one sense; what hides a part of an edge leaves a gap in its line and no more.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Ints, Picture
from quadrig.single.detect.pictures import reduced

# Search at no more pixels than this along the image's longer side: a sheet is large.
SEARCH_SIDE = 640
_Detector = tuple[int, float, float, float, float, float, float]
# Of the segment detector: scale of the picture, blur at that scale, levels of gradient that are noise, degrees of
# tolerance, 10 to the power of false alarms, density. Half scale finds 12 grey levels in noise of 2, and is quick.
_COARSE: _Detector = (cv2.LSD_REFINE_STD, 0.5, 0.6, 1.0, 22.5, 0.0, 0.7)
_FINE: _Detector = (cv2.LSD_REFINE_STD, 0.8, 0.6, 2.0, 22.5, 0.0, 0.7)
# px of the shortest segment, and of the shortest side of a sheet.
_LEAST_SEGMENT, _LEAST_SIDE = 8.0, 16.0
# Lines kept, those of most length times contrast; of a sheet on wood its sides are among the first ten.
_LINES = 26
# Segments of one line: px that they lie beside it, share of their distance more (a lens bends lines), cosine between
# them, and factor between their contrasts.
_BESIDE, _BENDING, _ALIGNED, _LIKE = 1.5, 0.012, 0.97, 2.0
# px of a piece of a segment, and across it to where its two sides are looked at.
_PIECE, _ACROSS = 12.0, 2.5
# Sine of the least angle between two sides.
_LEAST_SINE = 0.25
# Share of a side that must be seen, and of all four.
_LEAST_COVER, _LEAST_COVER_OF_ALL = 0.25, 0.5
# Share of the picture's area below which a blank quadrilateral is not taken for the sheet.
_LEAST_AREA = 0.004
# Outlines handed on, and px within which two are the same.
_MOST, _SAME = 8, 3.0


@dataclass(frozen=True, eq=False)
class _Line:
    """A straight edge: middle, direction (2,), brighter on the side of (direction y, -direction x); px along it at
    which its pieces begin and end, each after the other, and the length seen up to there; contrast, grey levels."""

    middle: Floats
    direction: Floats
    knots: Floats
    seen: Floats
    contrast: float

    def cover(self, start: Floats, end: Floats) -> Floats:
        """px seen between two places along it."""
        return np.interp(end, self.knots, self.seen) - np.interp(start, self.knots, self.seen)


def sheet_outlines(grey: Picture, fine: bool = False) -> list[Floats]:
    """Corners (4, 2) px, clockwise, of what may be a sheet, lighter or darker than around it, the likeliest first.

    fine: look at finer and steeper edges, which part from a grain that runs along them.
    """
    scale = min(1.0, SEARCH_SIDE / max(grey.shape))
    small = reduced(grey, scale)
    lines = _lines(*_pieces(small, _FINE if fine else _COARSE))
    if len(lines) < 4:
        return []
    found = [_quadrilaterals(lines, sense, small.shape) for sense in (-1, 1)]
    quads, score = (np.concatenate(part) for part in zip(*found, strict=True))
    kept: list[Floats] = []
    for quad in quads[np.argsort(-score)]:
        if len(kept) < _MOST and not any(np.abs(quad - other).max() < _SAME for other in kept):
            kept.append(quad)
    return [(quad + 0.5) / scale - 0.5 for quad in kept]


def _pieces(grey: Picture, detector: _Detector) -> tuple[Floats, Floats, Ints]:
    """The segments of a picture in pieces: ends (P, 2, 2), grey levels (P,) across, and of which segment (P,).

    In pieces, for the grain of wood often prolongs a segment past a sheet's corner.
    """
    segments = cv2.createLineSegmentDetector(*detector).detect(grey)[0]
    ends = np.zeros((0, 2, 2)) if segments is None else np.asarray(segments, float).reshape(-1, 2, 2)
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    ends, along, length = (part[length > _LEAST_SEGMENT] for part in (ends, along, length))
    count = np.ceil(length / _PIECE).astype(int)
    owner = np.repeat(np.arange(len(ends)), count)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    shares = (number[:, None] + np.linspace(0, 1, 5)) / count[owner, None]
    places = ends[owner, :1] + shares[..., None] * along[owner, None]
    beside = _ACROSS * (np.stack([along[:, 1], -along[:, 0]], axis=1) / length[:, None])[owner, None]
    size = np.array(grey.shape[::-1]) - 1
    either = [np.clip(np.rint(places + sign * beside), 0, size).astype(int) for sign in (1, -1)]
    levels = [grey[place[..., 1], place[..., 0]].astype(float).mean(axis=1) for place in either]
    return places[:, [0, -1]], np.maximum(levels[0] - levels[1], 0), owner


def _lines(ends: Floats, contrast: Floats, owner: Ints) -> list[_Line]:
    """Pieces of segments joined into lines, the most prominent first."""
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    direction = along / length[:, None]
    count = int(owner.max(initial=-1)) + 1
    of_segment = np.bincount(owner, length * contrast, count) / np.bincount(owner, length, count)
    free = contrast > 0
    lines: list[_Line] = []
    # Contrast twice: long weak lines are the grain of wood or the folds of a cloth.
    for lead in np.argsort(-np.bincount(owner, length * contrast**2, count)):
        own = np.flatnonzero(free & (owner == lead))
        if len(lines) == 2 * _LINES or not len(own):
            continue
        level = max(of_segment[lead], float(np.average(contrast[own], weights=contrast[own])))
        shift = ends - ends[own].mean(axis=(0, 1))
        beside = np.abs(shift @ [direction[own[0], 1], -direction[own[0], 0]])
        near = beside < _BESIDE + _BENDING * np.abs(shift @ direction[own[0]])
        like = (contrast < _LIKE * level) & (contrast > level / _LIKE)
        members = np.flatnonzero(free & like & near.all(axis=1) & (direction @ direction[own[0]] > _ALIGNED))
        if len(members):
            free[members] = False
            level = float(np.average(contrast[members], weights=length[members]))
            lines.append(_line(ends[members], direction[own[0]], level))
    lines.sort(key=lambda line: -line.seen[-1] * line.contrast**2)
    return lines[:_LINES]


def _line(ends: Floats, lead: Floats, contrast: float) -> _Line:
    """The line through segments (K, 2, 2)."""
    weight = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    middle = np.average(ends.mean(axis=1), axis=0, weights=weight)
    spread = (ends - middle) * np.sqrt(weight)[:, None, None]
    direction = np.linalg.svd(spread.reshape(-1, 2), full_matrices=False)[2][0]
    direction = direction * np.sign(direction @ lead)
    knots: list[float] = []
    for start, end in sorted(np.sort((ends - middle) @ direction, axis=1).tolist()):
        start = max(start, knots[-1]) if knots else start
        if end > start:
            knots += [start, end]
    steps = np.diff(knots)
    # Length grows from each beginning to its end, and not from there to the next beginning.
    steps[1::2] = 0
    return _Line(middle, direction, np.array(knots), np.append(0.0, np.cumsum(steps)), contrast)


def _quadrilaterals(lines: list[_Line], sense: int, shape: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Corners (Q, 4, 2), clockwise, of four lines that turn in one sense, and how much edge each shows (Q,)."""
    middle = np.array([line.middle for line in lines])
    direction = np.array([line.direction for line in lines])
    contrast = np.array([line.contrast for line in lines])
    first_seen, last_seen = np.array([line.knots[[0, -1]] for line in lines]).T
    sine = direction[:, None, 0] * direction[None, :, 1] - direction[:, None, 1] * direction[None, :, 0]
    turns = sense * sine > _LEAST_SINE
    # Where line i meets line j, px along i.
    gap = middle[None] - middle[:, None]
    along = (gap[..., 0] * direction[None, :, 1] - gap[..., 1] * direction[None, :, 0]) / np.where(turns, sine, 1)
    points = middle[:, None] + along[..., None] * direction[:, None]
    within = ((points > 1) & (points < np.array(shape[::-1]) - 2)).all(axis=2)
    second = np.sum((points - middle[None]) * direction[None], axis=-1)
    # A side ends after its line is first seen, and begins before it is last seen.
    follows = turns & within & (along > first_seen[:, None] + _LEAST_SIDE) & (second < last_seen - _LEAST_SIDE)
    cycles = _cycles(follows)
    previous, following = np.roll(cycles, 1, axis=1), np.roll(cycles, -1, axis=1)
    corners = points[previous, cycles]
    start = second[previous, cycles]
    end = along[cycles, following]
    cover = np.zeros(cycles.shape)
    beyond = np.zeros((2, *cycles.shape))
    for number, line in enumerate(lines):
        own = cycles == number
        first, last = start[own], end[own]
        reach = np.maximum(8.0, 0.1 * (last - first))
        cover[own] = line.cover(first, last)
        beyond[0][own] = line.cover(first - 4 - reach, first - 4) / reach
        beyond[1][own] = line.cover(last + 4, last + 4 + reach) / reach
    length = end - start
    share = cover / np.maximum(length, 1e-9)
    good = (length > _LEAST_SIDE).all(axis=1) & (share > _LEAST_COVER).all(axis=1)
    good &= (cover.sum(axis=1) > _LEAST_COVER_OF_ALL * length.sum(axis=1)) & (beyond < 0.7).all(axis=(0, 2))
    area = np.abs(_cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])) / 2
    good &= area > _LEAST_AREA * shape[0] * shape[1]
    score = np.sum(contrast[cycles] * (cover - 0.5 * (length - cover)), axis=1)
    corners = corners if sense > 0 else corners[:, ::-1]
    return corners[good], score[good]


def _cycles(follows: np.ndarray) -> Ints:
    """Lines (Q, 4) each of which follows the one before it, and the first the last; each once."""
    rows = []
    for first in range(len(follows)):
        later = np.arange(len(follows)) > first
        second = np.flatnonzero(follows[first] & later)
        fourth = np.flatnonzero(follows[:, first] & later)
        paths = follows[second][:, None, :] & follows[:, fourth].T[None] & later
        b, d, c = np.nonzero(paths)
        rows.append(np.stack([np.full(len(b), first), second[b], c, fourth[d]], axis=1))
    return np.concatenate(rows)


def _cross(a: Floats, b: Floats) -> Floats:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
