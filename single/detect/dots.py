"""Dark ellipses in a picture, and those of them that form a lattice."""

from dataclasses import dataclass
from itertools import combinations, product

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Ints, Picture

# Shares of the picture's shorter side that the threshold's window takes: it must be wider than a circle.
_WINDOWS = (0.03, 0.09, 0.27)
# Grey levels below the mean around it at which a pixel is ink.
_BELOW_MEAN = 7
# px of area of the smallest circle whose outline can be fitted; share of the picture's of the largest.
_LEAST_AREA, _LARGEST = 25.0, 0.05
# Share by which an outline may depart from its ellipse, beside a pixel: a square's corners do so by 0.22.
_STRAY_OUTLINE = 0.12
# Most circles kept, the largest: several times those of the largest grid in use.
_MOST = 1000
# A neighbour lies within this share of a step from where the steps before it point, and is so many times as large.
_STRAY, _LARGER = 0.3, 3.0
# Nearest circles that the first two steps are taken to: in a lattice seen at a slant the second nearest is far away.
_NEAR = 8
# Circles from which a lattice is grown; each try costs little.
_SEEDS = 24


@dataclass(frozen=True, eq=False)
class Dots:
    """Ellipses |shape (pixel - middle)| = 1: middles (N, 2) px, shape (N, 2, 2) per px, area (N,) px."""

    middles: Floats
    shape: Floats
    area: Floats


def find_dots(grey: Picture) -> Dots:
    """Every dark ellipse on lighter ground."""
    soft = cv2.GaussianBlur(grey, (0, 0), 0.8)
    middles, shapes, areas = np.empty((0, 2)), [], []
    for share in _WINDOWS:
        window = 2 * int(share * min(grey.shape) / 2) + 3
        ink = cv2.adaptiveThreshold(soft, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, window, _BELOW_MEAN)
        contours, tree = cv2.findContours(ink, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        for contour, links in zip(contours, tree[0] if tree is not None else (), strict=True):
            # What has a parent is the edge of a hole.
            dot = _dot(np.asarray(contour[:, 0], float), grey.shape) if links[3] < 0 else None
            if dot is None:
                continue
            middle, shape, area = dot
            apart = np.hypot(*(middles - middle).T)
            if not np.any(apart**2 < area / 10):
                middles = np.concatenate([middles, middle[None]])
                shapes.append(shape)
                areas.append(area)
    order = np.argsort(areas)[::-1][:_MOST]
    return Dots(middles[order], np.array(shapes).reshape(-1, 2, 2)[order], np.array(areas, float)[order])


def _dot(outline: Floats, picture: tuple[int, ...]) -> tuple[Floats, Floats, float] | None:
    """Middle (2,), shape (2, 2) and area of the ellipse that an outline (P, 2) of ink pixels is, or None."""
    if len(outline) < 12 or (outline <= 1).any() or (outline >= np.array(picture[::-1]) - 2).any():
        return None
    moments = cv2.moments(outline.astype(np.float32)[:, None])
    area = moments["m00"]
    if not _LEAST_AREA < area < _LARGEST * picture[0] * picture[1]:
        return None
    middle = np.array([moments["m10"], moments["m01"]]) / area
    second = np.array([[moments["mu20"], moments["mu11"]], [moments["mu11"], moments["mu02"]]]) / area
    values, axes = np.linalg.eigh(4 * second)
    # The outline runs through the middles of the outermost pixels of ink, half a pixel within its edge.
    radii = np.sqrt(np.maximum(values, 0.25)) + 0.5
    shape = (axes / radii) @ axes.T
    stray = np.abs(np.linalg.norm((outline - middle) @ shape, axis=1) * (1 + 0.5 / radii.mean()) - 1).max()
    return (middle, shape, float(np.pi * radii.prod())) if stray < _STRAY_OUTLINE + 1 / radii[0] else None


def lattices(dots: Dots) -> list[tuple[Ints, Ints]]:
    """Lattices among the dots, from several seeds: indices (K,) of their dots, and the whole-numbered places (K, 2)
    of these along two steps, the second clockwise from the first. Any two steps that span the lattice will do."""
    found: list[tuple[Ints, Ints]] = []
    tried = np.zeros(len(dots.middles), bool)
    for _ in range(_SEEDS):
        rest = np.flatnonzero(~tried)
        if len(rest) < 4:
            break
        # Amid the others, for an edge has fewer neighbours.
        seed = int(rest[np.argmin(np.abs(dots.middles[rest] - np.median(dots.middles[rest], axis=0)).sum(axis=1))])
        tried[seed] = True
        grown = _grown(dots, seed)
        if grown is not None:
            tried[grown[0]] = True
            found.append(grown)
    return found


def _grown(dots: Dots, seed: int) -> tuple[Ints, Ints] | None:
    shift = dots.middles - dots.middles[seed]
    distance = np.hypot(*shift.T)
    distance[(dots.area > _LARGER * dots.area[seed]) | (dots.area * _LARGER < dots.area[seed])] = np.inf
    distance[seed] = np.inf
    near = [k for k in np.argsort(distance)[:_NEAR] if np.isfinite(distance[k])]
    for first, second in combinations(near, 2):
        a, b = shift[first], shift[second]
        turn = (a[0] * b[1] - a[1] * b[0]) / (distance[first] * distance[second])
        fourth = np.hypot(*(shift - a - b).T).min()
        if abs(turn) > 0.3 and fourth < _STRAY * min(distance[first], distance[second]):
            return _grow(dots, seed, *((a, b) if turn > 0 else (b, a)))
    return None


def _grow(dots: Dots, seed: int, a: Floats, b: Floats) -> tuple[Ints, Ints]:
    places, used = {(0, 0): seed}, {seed}
    steps = {(0, 0): np.array([a, b])}
    queue = [(0, 0)]
    while queue:
        place = queue.pop(0)
        here = places[place]
        for axis, sign in product((0, 1), (1, -1)):
            along, across = (np.eye(2, dtype=int)[k] for k in (axis, 1 - axis))
            target = _moved(place, sign * along)
            if target in places:
                continue
            step = sign * steps[place][axis]
            # A parallelogram's fourth corner follows perspective better than one more step of the same length.
            beside = [(_moved(place, side), _moved(target, side)) for side in (across, -across)]
            others = [dots.middles[places[d]] - dots.middles[places[c]] for c, d in beside if {c, d} <= places.keys()]
            expected = dots.middles[here] + (np.mean(others, axis=0) if others else step)
            gap = np.hypot(*(dots.middles - expected).T)
            best = int(np.argmin(gap))
            alike = 1 / _LARGER < dots.area[best] / dots.area[here] < _LARGER
            if gap[best] > _STRAY * np.hypot(*step) or best in used or not alike:
                continue
            places[target] = best
            used.add(best)
            steps[target] = steps[place].copy()
            steps[target][axis] = sign * (dots.middles[best] - dots.middles[here])
            queue.append(target)
    return np.array(list(places.values())), np.array(list(places))


def _moved(place: tuple[int, int], by: Ints) -> tuple[int, int]:
    return place[0] + int(by[0]), place[1] + int(by[1])
