"""Grids of circles: where the middle of each circle appears, which is not the middle of the ellipse it is seen as."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Ints, Picture
from quadrig.single.detect.board_corners import good_corners
from quadrig.single.detect.dots import Dots, find_dots, lattices
from quadrig.single.subpixel.ellipse_fit import EllipseFit, fit_ellipses
from quadrig.single.subpixel.tone import LightImage

# Changes of a lattice's two steps that keep all of its points and their sense of rotation.
_STEPS = [
    np.array(steps).reshape(2, 2)
    for steps in product((-1, 0, 1), repeat=4)
    if steps[0] * steps[3] - steps[1] * steps[2] == 1
]
# Points of a circle that its image's conic is drawn through.
_OUTLINE = 24
# Circles from which a map of third, second order beyond the plane's perspective may be fitted: twice its terms.
_CUBIC, _QUADRATIC = 20, 12
# Share of a step between circles that one may lie beside the smooth map of all: what lenses do beyond third order.
_OFF_MAP = 0.04
# px that outlines are wrong by alike, where neighbours, tone and the pixel's square bend them.
_MODEL_SIGMA = 0.004


@dataclass(frozen=True, eq=False)
class FoundCircles:
    """A grid in a picture: pixels (P, 2) of the circles' middles in the grid's order, their standard deviation (px),
    and orders (K, P): which of them are which under each reading, the most upright first."""

    pixels: Floats
    sigma: float
    orders: list[Ints]


def find_circle_grid(grey: Picture, places: Ints, light: bool = False) -> FoundCircles | None:
    """The grid of dark circles (or light ones) at whole-numbered places (P, 2), x to the right and y down, or None.

    All circles must be seen. None too where a larger grid could be meant.
    """
    dots = find_dots(255 - grey if light else grey)
    # Where every other place is empty, the lattice's steps are the diagonals.
    steps = np.array([[1, -1], [1, 1]]) if np.all(places.sum(axis=1) % 2 == 0) else 2 * np.eye(2, dtype=int)
    for index, lattice in lattices(dots):
        orders = _readings(lattice, places @ steps // 2)
        if not orders:
            continue
        found = [index[order] for order in orders]
        pixels = _fitted(grey, dots, found[0], places.astype(float))
        if pixels is None:
            continue
        position = {dot: k for k, dot in enumerate(found[0].tolist())}
        ways = [np.array([position[dot] for dot in one.tolist()]) for one in found]
        # The most upright: x of the grid to the right in the picture.
        x = places[:, 0] - places[:, 0].mean()
        ways.sort(key=lambda way: -float(x @ pixels[0][way, 0]))
        return FoundCircles(*pixels, ways)
    return None


def _readings(lattice: Ints, places: Ints) -> list[Ints]:
    """For each way in which the grid is the lattice (K, 2), the lattice's point of each of the grid's; none where the
    grid fits in two places."""
    if len(lattice) < len(places):
        return []
    found: list[Ints] = []
    for steps in _STEPS:
        at = {(x, y): k for k, (x, y) in enumerate((lattice @ steps).tolist())}
        low, high = (lattice @ steps).min(axis=0), (lattice @ steps).max(axis=0)
        spare = high - low - np.ptp(places, axis=0)
        for x, y in product(*(range(max(0, int(room) + 1)) for room in spare)):
            moved = places - places.min(axis=0) + low + [x, y]
            order = [at.get((i, j), -1) for i, j in moved.tolist()]
            if min(order) >= 0:
                found.append(np.array(order))
    return found if len({frozenset(order.tolist()) for order in found}) == 1 else []


def _fitted(grey: Picture, dots: Dots, index: Ints, places: Floats) -> tuple[Floats, float] | None:
    """Pixels (P, 2) of the circles' middles and their sigma, from the dots of these indices."""
    nearest = np.linalg.norm(places[:, None] - places[None], axis=2)
    step = float(nearest[nearest > 0].min())
    rough = dots.middles[index]
    radius = _radius(_map(places, rough), places, dots.shape[index])
    light = LightImage(grey)
    fit = fit_ellipses(light, rough, dots.shape[index], 0.5 * step / radius - 1)
    if not _all_sure(fit, rough):
        return None
    # Closer to what was found: the threshold knew neither blur nor tone.
    fit = fit_ellipses(
        light, fit.pixels, fit.shape, 0.5 * step / _radius(_map(places, fit.pixels), places, fit.shape) - 1
    )
    if not _all_sure(fit, rough):
        return None
    middles = fit.pixels
    for _ in range(2):
        # What the map is fitted to is off itself by what it corrects; its bends hardly are.
        middles = fit.pixels - _eccentricity(places, middles, fit.shape)
    off = np.linalg.norm(_map(places, middles)(places) - middles, axis=1)
    sigma = float(np.hypot(np.sqrt(np.mean(fit.sigma**2)), _MODEL_SIGMA))
    size = np.linalg.norm(middles[:, None] - middles[None], axis=2)
    return (middles, sigma) if off.max() < _OFF_MAP * size[size > 0].min() + 0.5 else None


def _all_sure(fit: EllipseFit, rough: Floats) -> bool:
    radii = 1 / np.sqrt(np.abs(np.linalg.det(fit.shape)))
    near = np.linalg.norm(fit.pixels - rough, axis=1) < 1 + 0.2 * radii
    return bool(np.all(near) and np.all(good_corners(fit)) and np.all((fit.contrast > 0) == (fit.contrast[0] > 0)))


def _map(places: Floats, pixels: Floats) -> Callable[[Floats], Floats]:
    """The smooth map from the grid's plane to the picture that comes nearest to the pixels (P, 2) of places (P, 2):
    a homography, and upon it as much of a polynomial as so many points can show, for the lens."""
    middle, size = places.mean(axis=0), np.abs(places - places.mean(axis=0)).max()
    homography, _ = cv2.findHomography((places - middle) / size, pixels)

    def flat(points: Floats) -> Floats:
        one = np.concatenate([(points - middle) / size, np.ones((*points.shape[:-1], 1))], axis=-1) @ homography.T
        return one[..., :2] / one[..., 2:]

    centre, scale = pixels.mean(axis=0), np.abs(pixels - pixels.mean(axis=0)).max()
    order = 3 if len(places) >= _CUBIC else 2 if len(places) >= _QUADRATIC else 0
    powers = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]

    def terms(seen: Floats) -> Floats:
        x, y = np.moveaxis((seen - centre) / scale, -1, 0)
        return np.stack([x**i * y**j for i, j in powers], axis=-1)

    seen = flat(places)
    bend = np.linalg.lstsq(terms(seen), pixels - seen, rcond=None)[0]

    def image(points: Floats) -> Floats:
        seen = flat(points)
        return seen + terms(seen) @ bend

    return image


def _radius(image: Callable[[Floats], Floats], places: Floats, shape: Floats) -> float:
    """Radius of the circles in steps of the grid, from the areas of their ellipses under a map into the picture."""
    axes = [image(places + step) - image(places - step) for step in ([0.05, 0.0], [0.0, 0.05])]
    stretch = np.abs(np.linalg.det(np.stack(axes, axis=-1))) / 0.01
    return float(np.median(1 / np.sqrt(np.abs(np.linalg.det(shape)) * stretch)))


def _eccentricity(places: Floats, pixels: Floats, shape: Floats) -> Floats:
    """px (P, 2) from where the middle of each circle appears to the middle of the ellipse that its outline makes.

    In perspective the outline is an ellipse exactly, whose middle is not the circle's (Heikkila and Silven, 1997); a
    lens bends it further. Both are in the map: circles are drawn through it, and ellipses fitted to what they make.
    """
    image = _map(places, pixels)
    angle = 2 * np.pi * np.arange(_OUTLINE) / _OUTLINE
    circle = _radius(image, places, shape) * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    middle = image(places)
    outline = image(places[:, None] + circle) - middle[:, None]
    scale = np.abs(outline).max(axis=(1, 2))
    x, y = np.moveaxis(outline / scale[:, None, None], -1, 0)
    # a x^2 + b x y + c y^2 + d x + e y = 1; the middle is where its slopes vanish.
    rows = np.stack([x * x, x * y, y * y, x, y], axis=-1)
    a, b, c, d, e = np.linalg.pinv(rows).sum(axis=-1).T
    return np.stack([b * e - 2 * c * d, b * d - 2 * a * e], axis=-1) / (4 * a * c - b * b)[:, None] * scale[:, None]
