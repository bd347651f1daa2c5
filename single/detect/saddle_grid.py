"""The grid of a chessboard's inner corners, grown from the saddles of the grey values.

At an inner corner the grey values form a saddle, and on a small circle around it they go bright, dark, bright, dark.
Neighbours in the grid have bright and dark exchanged, which distinguishes them from diagonal ones.
"""

from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask, Picture, Singles
from quadrig.single.detect.pictures import reduced

# Blur (px) before the second derivatives: less than a third of the smallest square looked for, 6 px.
_BLUR = 1.2
# Radius (px) of the circle: within the smallest square, beyond the blur of the corner itself.
_RADIUS = 3.5
# Grey levels of the circle's twofold wave.
_LEAST_CONTRAST = 6.0
# Share of the circle's variance that repeats after half a turn; a saddle seen at a slant keeps all of it.
_EVEN_SHARE = 0.8
# Most saddles kept: five times those of the largest board in use.
_MOST = 1200
# A neighbour lies within this share of a step from where the steps before it point.
_STRAY = 0.33
# Seeds tried: the strongest saddles belong to the board unless it is far away; each try costs little.
_SEEDS = 24
# Share of the board's corners that must be seen as saddles; the rest is filled in, and tried by the fit.
_SEEN_SHARE = 0.85


@dataclass(frozen=True, eq=False)
class Saddles:
    """places (N, 2) px, and the angle (N,) of twice the bright direction, strongest first."""

    places: Floats
    phase: Floats


def find_saddle_grid(grey: Picture, columns: int, rows: int) -> Floats | None:
    """Rough corners (rows, columns, 2) px of a board of columns x rows inner corners, or None.

    Which end comes first is left open. None where a larger board could be meant: only a whole board counts.
    """
    for scale in (0.5, 1.0, 0.25):
        if min(grey.shape) * scale < 60:
            continue
        image = reduced(grey, scale)
        grid = _grow_grid(find_saddles(image), columns, rows)
        if grid is not None:
            return (grid + 0.5) / scale - 0.5
    return None


def largest_grid(grey: Picture) -> tuple[int, int] | None:
    """Columns and rows of inner corners of the largest board that the saddles show, without its ragged edges; None
    where there are less than three of either."""
    best = (0, 0)
    for scale in (0.5, 1.0):
        if min(grey.shape) * scale < 60:
            continue
        saddles = find_saddles(reduced(grey, scale))
        tried = np.zeros(len(saddles.places), bool)
        seeds = (
            (seed, start) for seed in range(len(tried)) if not tried[seed] and (start := _first_square(saddles, seed))
        )
        for seed, start in islice(seeds, _SEEDS):
            grown = _grow(saddles, seed, *start)
            tried[list(grown.values())] = True
            places = np.array(list(grown))
            columns, rows = (int(np.sum(np.bincount(k - k.min()) > _SEEN_SHARE * _usual(k))) for k in places.T)
            if min(columns, rows) > 2 and columns * rows > best[0] * best[1]:
                best = (columns, rows)
    return best if best != (0, 0) else None


def _usual(line: Ints) -> float:
    """How many saddles most of the lines hold, from the number of each saddle's line."""
    return float(np.median(np.bincount(line - line.min())))


def find_saddles(grey: Picture) -> Saddles:
    """All places of a grey image where the grey values form a saddle like a board's corner."""
    soft = cv2.GaussianBlur(grey, (0, 0), _BLUR).astype(np.float32)
    xx, yy = cv2.Sobel(soft, cv2.CV_32F, 2, 0), cv2.Sobel(soft, cv2.CV_32F, 0, 2)
    xy = cv2.Sobel(soft, cv2.CV_32F, 1, 1)
    strength = xy * xy - xx * yy
    peak = (strength >= cv2.dilate(strength, np.ones((5, 5), np.uint8))) & (strength > _LEAST_CONTRAST**2)
    edge = int(np.ceil(_RADIUS)) + 1
    peak[:edge], peak[-edge:], peak[:, :edge], peak[:, -edge:] = False, False, False, False
    y, x = np.nonzero(peak)
    if len(x) > 4 * _MOST:
        strongest = np.argpartition(strength[y, x], -4 * _MOST)[-4 * _MOST :]
        y, x = y[strongest], x[strongest]
    order = np.argsort(strength[y, x])[::-1]
    y, x = y[order], x[order]
    phase, good = _circle(soft, x, y)
    keep = np.flatnonzero(good)[:_MOST]
    return Saddles(np.stack([x, y], axis=1)[keep].astype(float), phase[keep])


def _circle(soft: Singles, x: Ints, y: Ints) -> tuple[Floats, Mask]:
    """Angle of the twofold wave of the grey values around each place, and whether it is the wave of a saddle."""
    angles = 2 * np.pi * np.arange(16) / 16
    columns = np.rint(x[:, None] + _RADIUS * np.cos(angles)).astype(int)
    rows = np.rint(y[:, None] + _RADIUS * np.sin(angles)).astype(int)
    waves = np.fft.rfft(soft[rows, columns], axis=1)
    power = np.abs(waves[:, 1:8]) ** 2
    even = power[:, 1::2].sum(axis=1)
    twofold = 2 * np.abs(waves[:, 2]) / 16
    good = (even > _EVEN_SHARE * power.sum(axis=1)) & (twofold > _LEAST_CONTRAST) & (power[:, 1] > 0.4 * even)
    return -np.angle(waves[:, 2]), good


def _grow_grid(saddles: Saddles, columns: int, rows: int) -> Floats | None:
    count = len(saddles.places)
    if count < _SEEN_SHARE * columns * rows:
        return None
    tried = np.zeros(count, bool)
    seeds = 0
    for seed in range(count):
        if tried[seed]:
            continue
        start = _first_square(saddles, seed)
        if start is None:
            continue
        grown = _grow(saddles, seed, *start)
        tried[list(grown.values())] = True
        grid = _whole_board(grown, saddles.places, columns, rows)
        if grid is not None:
            return grid
        seeds += 1
        if seeds >= _SEEDS:
            return None
    return None


def _opposite(saddles: Saddles, index: int) -> Mask:
    """Which saddles have bright and dark exchanged against this one."""
    return np.cos(saddles.phase - saddles.phase[index]) < -0.3


def _first_square(saddles: Saddles, seed: int) -> tuple[Floats, Floats] | None:
    """Two steps (2,) px from the seed to neighbours whose fourth corner is there too."""
    shift = saddles.places - saddles.places[seed]
    distance = np.hypot(*shift.T)
    opposite = _opposite(saddles, seed)
    near = np.argsort(np.where(opposite, distance, np.inf))[:6]
    near = near[opposite[near]]
    same = np.flatnonzero(~opposite)
    for first in range(len(near)):
        for second in range(first + 1, len(near)):
            a, b = shift[near[first]], shift[near[second]]
            turn = (a[0] * b[1] - a[1] * b[0]) / (distance[near[first]] * distance[near[second]])
            if abs(turn) < 0.3 or not len(same):
                continue
            gap = np.hypot(*(shift[same] - a - b).T).min()
            if gap < _STRAY * min(distance[near[first]], distance[near[second]]):
                return (a, b) if turn > 0 else (b, a)
    return None


def _grow(saddles: Saddles, seed: int, a: Floats, b: Floats) -> dict[tuple[int, int], int]:
    """Grid places (column, row) of the saddles that can be reached from the seed in even steps."""
    grown, used = {(0, 0): seed}, {seed}
    steps: dict[tuple[int, int], tuple[Floats, Floats]] = {(0, 0): (a, b)}
    queue = [(0, 0)]
    while queue:
        place = queue.pop(0)
        here = grown[place]
        opposite = _opposite(saddles, here)
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            target = (place[0] + sign, place[1]) if axis == 0 else (place[0], place[1] + sign)
            if target in grown:
                continue
            step = sign * steps[place][axis]
            gap = np.hypot(*(saddles.places - saddles.places[here] - step).T)
            gap[~opposite] = np.inf
            best = int(np.argmin(gap))
            if gap[best] > _STRAY * np.hypot(*step) or best in used:
                continue
            grown[target] = best
            used.add(best)
            new = sign * (saddles.places[best] - saddles.places[here])
            steps[target] = (new, steps[place][1]) if axis == 0 else (steps[place][0], new)
            queue.append(target)
    return grown


def _whole_board(grown: dict[tuple[int, int], int], places: Floats, columns: int, rows: int) -> Floats | None:
    """The one window of the grown grid that holds the board, (rows, columns, 2); None where none or several do."""
    keys = np.array(list(grown))
    low, size = keys.min(axis=0), np.ptp(keys, axis=0) + 1
    table = np.full((size[1], size[0]), -1)
    for (i, j), index in grown.items():
        table[j - low[1], i - low[0]] = index
    for turned in (False, True) if columns != rows else (False,):
        lattice = table.T if turned else table
        grid = _window(lattice, places, columns, rows)
        if grid is not None:
            return grid
    return None


def _window(lattice: Ints, places: Floats, columns: int, rows: int) -> Floats | None:
    if lattice.shape[0] < rows or lattice.shape[1] < columns:
        return None
    seen = (lattice >= 0).astype(int)
    counts = np.array(
        [
            [seen[r : r + rows, c : c + columns].sum() for c in range(lattice.shape[1] - columns + 1)]
            for r in range(lattice.shape[0] - rows + 1)
        ]
    )
    best = np.argwhere(counts == counts.max())
    if counts.max() < _SEEN_SHARE * rows * columns or len(best) > 1:
        return None
    r, c = best[0]
    window = lattice[r : r + rows, c : c + columns]
    grid = np.where((window >= 0)[..., None], places[np.maximum(window, 0)], np.nan)
    return grid if not np.isnan(grid).any() else _filled(grid)


def _filled(grid: Floats) -> Floats | None:
    """The grid with missing corners where the homography of the others puts them."""
    rows, columns = grid.shape[:2]
    lattice = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).astype(float)
    known = ~np.isnan(grid[..., 0])
    result = grid.copy()
    for place in lattice[~known]:
        distance = np.linalg.norm(lattice[known] - place, axis=1)
        near = np.argsort(distance, kind="stable")[:10]
        homography, _ = cv2.findHomography(lattice[known][near] - place, grid[known][near])
        if homography is None:
            return None
        result[int(place[1]), int(place[0])] = homography[:2, 2] / homography[2, 2]
    return result
