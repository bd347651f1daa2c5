"""Chessboards and ChArUco boards: their inner corners to sub-pixel accuracy."""

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask, Picture
from quadrig.single.detect.board_corners import (
    RECENTRE,
    alike_corners,
    better_tone,
    corner_window,
    good_corners,
    view_sigma,
)
from quadrig.single.detect.corner_fit import fit_corners
from quadrig.single.detect.dictionaries import canonical_dictionary, check_tag_id
from quadrig.single.detect.local_homography import local_homographies, mapped
from quadrig.single.detect.tone import LightImage, Tone
from quadrig.single.marking import (
    CharucoMarking,
    board_points,
    charuco_tag_squares,
    starts_with_tag,
)
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# Squares from a tag's corner to the corners of its own square, and from a corner to the next: what lies farther is
# found from those, and from those in turn, for a prediction from few tags goes astray beyond.
_BESIDE, _NEXT, _ROUNDS = 0.7, 1.5, 3
# px from the plane of most corners beyond which a corner is looked for anew.
_PLANE = 2.0


# --------------------------------------------------------------------------------------------------- ChArUco boards


def detect_charuco(grey: Picture, rectangle: Rectangle, found: dict[int, list[Floats]]) -> View | None:
    """The View of a ChArUco board from the rough corners of the tags found, by id, or None.

    At least four inner corners that are not in one line make a View.
    """
    marking = rectangle.marking
    assert isinstance(marking, CharucoMarking)
    tags, pixels = _tag_corners(marking, found)
    if not len(tags):
        return None
    tags, pixels = _agreeing(tags, pixels)
    if not len(tags):
        return None
    points = board_points(marking.columns, marking.rows, marking.square)[:, :2]
    places, axes, trusted = _predict(points, tags.reshape(-1, 2), pixels.reshape(-1, 2), marking, grey.shape, _BESIDE)
    light = LightImage(grey)
    pixels_found, sigma, good, tone = _fit_charuco(light, marking, places, axes, trusted)
    if tone is not None:
        light = LightImage(grey, tone)
        pixels_found, sigma, good, _ = _fit_charuco(light, marking, places, axes, trusted)
    for _ in range(_ROUNDS):
        good[good] = _on_one_plane(points[good], pixels_found[good])
        if np.count_nonzero(good) < 4:
            break
        places, axes, near = _predict(points, points[good], pixels_found[good], marking, grey.shape, _NEXT)
        near &= ~good
        if not near.any():
            break
        again, sigma_again, good_again, _ = _fit_charuco(light, marking, places, axes, near)
        pixels_found[good_again], sigma[good_again] = again[good_again], sigma_again[good_again]
        good |= good_again
    good &= _smooth(points, pixels_found, good, marking.square)
    if not _spans_plane(points[good] / marking.square):
        return None
    flat = np.concatenate([points, np.zeros((len(points), 1))], axis=1)
    return View(rectangle.name, flat[good], pixels_found[good], sigma=view_sigma(sigma[good]))


def _on_one_plane(points: Floats, pixels: Floats) -> Mask:
    """Which corners lie on one board with most; where a lens bends it, the others are found again from these."""
    if len(points) < 6:
        return np.ones(len(points), bool)
    cv2.setRNGSeed(1)
    homography, _ = cv2.findHomography(points * 1e3, pixels, cv2.RANSAC, _PLANE)
    if homography is None:
        return np.ones(len(points), bool)
    placed = cv2.perspectiveTransform(points[:, None] * 1e3, homography)[:, 0]
    return np.linalg.norm(placed - pixels, axis=1) < _PLANE


def _spans_plane(points: Floats) -> bool:
    """Whether points (P, 2) fix a homography: four of them, no three of the four in one line."""
    if len(points) < 4:
        return False
    ones, zero = np.ones((len(points), 1)), np.zeros((len(points), 3))
    x = np.concatenate([points, ones], axis=1)
    rows = [
        np.concatenate([x, zero, -points[:, :1] * x], axis=1),
        np.concatenate([zero, x, -points[:, 1:] * x], axis=1),
    ]
    return bool(np.linalg.matrix_rank(np.concatenate(rows), tol=1e-6) == 8)


def _tag_corners(marking: CharucoMarking, found: dict[int, list[Floats]]) -> tuple[Floats, Floats]:
    """Corners (N, 4, 2) of the board's tags that were seen: on the board (m), and in the image (px)."""
    half = marking.marker / 2
    square = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    tags, pixels = [], []
    for offset, (column, row) in enumerate(charuco_tag_squares(marking)):
        middle = np.array([column + 0.5 - marking.columns / 2, row + 0.5 - marking.rows / 2]) * marking.square
        for quad in found.get(marking.first_id + offset, []):
            tags.append(middle + square)
            pixels.append(quad)
    return np.array(tags).reshape(-1, 4, 2), np.array(pixels).reshape(-1, 4, 2)


def _agreeing(tags: Floats, pixels: Floats) -> tuple[Floats, Floats]:
    """The tags that lie on one board together; a distorted lens bends it by some per cent of its size."""
    if len(tags) < 2:
        return tags, pixels
    side = np.linalg.norm(np.roll(pixels, -1, axis=1) - pixels, axis=2).mean()
    cv2.setRNGSeed(1)
    homography, _ = cv2.findHomography(
        tags.reshape(-1, 2) * 1e3, pixels.reshape(-1, 2), cv2.RANSAC, float(max(3.0, 0.35 * side))
    )
    if homography is None:
        return tags[:0], pixels[:0]
    predicted = cv2.perspectiveTransform(tags.reshape(-1, 1, 2) * 1e3, homography).reshape(-1, 4, 2)
    near = np.linalg.norm(predicted - pixels, axis=2).max(axis=1) < max(4.0, 0.5 * side)
    return tags[near], pixels[near]


def _predict(
    points: Floats, known: Floats, pixels: Floats, marking: CharucoMarking, shape: tuple[int, ...], reach: float
) -> tuple[Floats, Floats, Mask]:
    """Where board points (P, 2) should appear, by the homography of the known points nearest to each.

    Returns places (P, 2) px, axes (P, 2, 2) px of one square's sides, and which places are within reach (in squares)
    of known points.
    """
    square = marking.square
    distance = np.abs(known[None] - points[:, None]).max(axis=2)
    count = min(8, len(known))
    near = np.argsort(distance, axis=1, kind="stable")[:, :count]
    around = (known[near] - points[:, None]) / square
    local = local_homographies(around, pixels[near])
    whole = local_homographies(
        ((known[None] - points[:, None]) / square), np.broadcast_to(pixels, (len(points), *pixels.shape))
    )
    alone = np.take_along_axis(distance, near[:, -1:], axis=1)[:, 0] > 2.5 * square
    far = alone | np.isnan(local).any(axis=(1, 2))
    homography = np.where(far[:, None, None], whole, local)
    seen = mapped(homography, np.array([[0, 0], [0.25, 0], [-0.25, 0], [0, 0.25], [0, -0.25]]))
    places = seen[:, 0]
    axes = 2 * np.stack([seen[:, 1] - seen[:, 2], seen[:, 3] - seen[:, 4]], axis=1)
    known_well = np.all(np.isfinite(seen), axis=(1, 2))
    places = np.where(known_well[:, None], places, -1e3)
    axes = np.where(known_well[:, None, None], axes, np.eye(2))
    trusted = distance.min(axis=1) < reach * square
    inside = (places > 2).all(axis=1) & (places < np.array(shape[::-1]) - 3).all(axis=1)
    return places, axes, known_well & trusted & inside & (np.linalg.det(axes) > 4)


def _fit_charuco(
    light: LightImage, marking: CharucoMarking, places: Floats, axes: Floats, wanted: Mask
) -> tuple[Floats, Floats, Mask, Tone | None]:
    """Corners (P, 2), sigma (P,), which (P,) of the wanted ones are sure, and the tone that would suit better."""
    pixels, sigma, good = places.copy(), np.full(len(places), np.inf), np.zeros(len(places), bool)
    index = np.flatnonzero(wanted)
    if not len(index):
        return pixels, sigma, good, None
    clear = (1 - marking.marker / marking.square) / 2
    fit = fit_corners(light, places[index], axes[index], corner_window(axes[index]), clear)
    shift = fit.pixels - places[index]
    far = np.linalg.norm(shift, axis=1)
    again = np.flatnonzero(far > RECENTRE)
    if len(again):
        # The window follows the corner, a few pixels at most, so that it holds the four squares evenly.
        here = places[index[again]] + shift[again] * np.minimum(1, 4 / far[again, None])
        own_axes = axes[index[again]]
        fit = fit.changed(again, fit_corners(light, here, own_axes, corner_window(own_axes), clear))
    side = np.linalg.norm(axes[index], axis=2).min(axis=1)
    moved = np.linalg.norm(fit.pixels - places[index], axis=1)
    sure = good_corners(fit) & alike_corners(fit) & (moved < np.maximum(1.5, 0.2 * side))
    sure &= np.sign(fit.contrast) == _expected_signs(marking)[index]
    pixels[index], sigma[index], good[index] = fit.pixels, fit.sigma, sure
    return pixels, sigma, good, better_tone(fit, sure)


def _expected_signs(marking: CharucoMarking) -> Ints:
    rows, columns = np.meshgrid(np.arange(marking.rows - 1), np.arange(marking.columns - 1), indexing="ij")
    black_first = -1 if starts_with_tag(marking) != marking.inverted else 1
    return (black_first * (1 - 2 * ((rows + columns) % 2))).ravel()


def _smooth(points: Floats, pixels: Floats, good: Mask, square: float) -> Mask:
    """Which corners agree with the homography of their neighbours: a corner on a wrong edge does not."""
    keep = good.copy()
    index = np.flatnonzero(good)
    if len(index) < 6:
        return keep
    place = points[index] / square
    distance = np.linalg.norm(place[:, None] - place[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    near = np.argsort(distance, axis=1, kind="stable")[:, : min(8, len(index) - 1)]
    local = local_homographies(place[near] - place[:, None], pixels[index][near])
    with np.errstate(invalid="ignore"):
        side = np.sqrt(np.abs(np.linalg.det(local[:, :2, :2])))
    error = np.linalg.norm(local[:, :2, 2] - pixels[index], axis=1)
    # Extrapolating by a square through a strongly distorted lens misses by some per cent of a square; where the
    # neighbours fix no homography (nan) there is no evidence against the corner.
    keep[index] = ~(error > np.maximum(1.0, 0.12 * side))
    return keep


def check_board_rectangle(rectangle: Rectangle) -> str:
    """The canonical name of a ChArUco board's dictionary. Raises QuadrigError where it has too few tags."""
    marking = rectangle.marking
    assert isinstance(marking, CharucoMarking)
    name = canonical_dictionary(marking.dictionary)
    for tag_id in (marking.first_id, marking.first_id + len(charuco_tag_squares(marking)) - 1):
        check_tag_id(name, tag_id, f"rectangle {rectangle.name!r}")
    return name
