"""Boards of squares with tags between: the inner corners that are in sight, to sub-pixel accuracy."""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask, Picture
from quadrig.single.detect.board_corners import (
    RECENTRE,
    alike_corners,
    better_tone,
    corner_window,
    good_corners,
    leak,
    view_sigma,
)
from quadrig.single.detect.dictionaries import tag_cells
from quadrig.single.rectangle import FoundTags, TagFamily
from quadrig.single.subpixel.corner_fit import SHARP, CornerFit, fit_corners
from quadrig.single.subpixel.local_homography import local_homographies, mapped
from quadrig.single.subpixel.tone import LightImage, Tone

# Squares from a tag's corner to the corners of its own square, and from a corner to the next: what lies farther is
# found from those, and from those in turn, for a prediction from few tags goes astray beyond.
_BESIDE, _NEXT, _ROUNDS = 0.7, 1.5, 3
# Corners of a tag's square that must have been found for its bits to be looked at.
_CORNERS_OF_A_SQUARE = 3
# px from the plane of most corners beyond which a corner is looked for anew.
_PLANE = 2.0
# Share of a board's tags, where so many are seen, that lie on it together if it is the one that is meant.
_AGREEING, _ENOUGH_TAGS = 0.6, 4
# Tags that agree on where the board is by no chance. Of fewer, the bits of the other tags in sight must be right more
# often than by chance, by so many sigmas of it: a board that is another, or mirrored, had a tag that was misread.
_SURE_TAGS, _NO_CHANCE = 3, 3.5


@dataclass(frozen=True, eq=False)
class TaggedBoard:
    """A board as its printer knows it, metres.

    corners (P, 2): where four squares meet; signs (P,): 1 where the square at the top left of a corner is dark, -1
    where it is light. square: the board's own step; cell: side of the smallest of the squares around a corner; clear:
    share of it around the squares' edges that is free of print.
    tags: corners (4, 2) of each tag by its id, top left first and clockwise; family: which tags they are.
    """

    corners: Floats
    signs: Ints
    square: float
    cell: float
    clear: float
    tags: Mapping[int, Floats]
    family: TagFamily


@dataclass(frozen=True, eq=False)
class FoundCorners:
    """Corners of a board in a picture: which (K,) of it, pixels (K, 2), and their standard deviation, px."""

    index: Ints
    pixels: Floats
    sigma: float


def find_board(grey: Picture, board: TaggedBoard, found: FoundTags) -> FoundCorners | None:
    """The corners of a board in a picture, from the rough corners of the tags found; None where it is not there.

    At least four corners that are not in one line are a board.
    """
    tags, pixels = seen_tags(board, found)
    if not len(tags):
        return None
    places, axes, trusted = _predict(board, tags.reshape(-1, 2), pixels.reshape(-1, 2), grey.shape, _BESIDE)
    light, blur = LightImage(grey), 0.0
    pixels_found, sigma, good, better = _fit(light, blur, board, places, axes, trusted)
    if better is not None:
        light, blur = LightImage(grey, better[0]), better[1]
        pixels_found, sigma, good, _ = _fit(light, blur, board, places, axes, trusted)
    for _ in range(_ROUNDS):
        good[good] = _on_one_plane(board.corners[good], pixels_found[good])
        if np.count_nonzero(good) < 4:
            break
        places, axes, near = _predict(board, board.corners[good], pixels_found[good], grey.shape, _NEXT)
        near &= ~good
        if not near.any():
            break
        again, sigma_again, good_again, _ = _fit(light, blur, board, places, axes, near)
        pixels_found[good_again], sigma[good_again] = again[good_again], sigma_again[good_again]
        good |= good_again
    good &= _smooth(board, pixels_found, good)
    if not _spans_plane(board.corners[good] / board.square):
        return None
    if len(tags) < _SURE_TAGS and not _bears_its_tags(grey, board, tags, board.corners[good], pixels_found[good]):
        return None
    return FoundCorners(np.flatnonzero(good), pixels_found[good], view_sigma(sigma[good]))


def _bears_its_tags(grey: Picture, board: TaggedBoard, read: Floats, known: Floats, pixels: Floats) -> bool:
    """Whether the bits of the tags between known corners (K, 2) m, seen at pixels (K, 2), are those of the board.

    read (N, 4, 2): corners m of the tags that said so, and are no witnesses.
    """
    wrong = bits = 0
    for tag, quad in board.tags.items():
        distance = np.abs(known - quad.mean(axis=0)).max(axis=1)
        near = np.argsort(distance, kind="stable")[:8]
        witness = not (read == quad).all(axis=(1, 2)).any()
        if not witness or np.count_nonzero(distance < board.square) < _CORNERS_OF_A_SQUARE:
            continue
        white = tag_cells(board.family.dictionary, tag, board.family.border)[1:-1, 1:-1] != board.family.inverted
        cells = len(white) + 2
        across, down = quad[1] - quad[0], quad[3] - quad[0]
        row, column = (np.indices(white.shape).reshape(2, -1, 1) + 1.5) / cells
        around = (quad[0] + column * across + row * down - quad.mean(axis=0)) / board.square
        local = local_homographies((known[near] - quad.mean(axis=0))[None] / board.square, pixels[near][None])
        seen = mapped(local, around[None])[0]
        if not np.isfinite(seen).all() or (seen < 0).any() or (seen > np.array(grey.shape[::-1]) - 1).any():
            continue
        x, y = np.rint(seen).astype(int).T
        values = grey[y, x].astype(float)
        wrong += np.count_nonzero((values > (values.min() + values.max()) / 2) != white.ravel())
        bits += white.size
    return wrong <= max(bits / 2 - _NO_CHANCE * np.sqrt(bits) / 2, 0)


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


def seen_tags(board: TaggedBoard, found: FoundTags) -> tuple[Floats, Floats]:
    """Corners (N, 4, 2) of the board's tags that were seen, m on the board and px in the image: those that lie on one
    board together.

    Some print AprilGrids with each tag half a turn from where Kalibr has it: its outline is the same.
    """
    seen = [(corners, quad) for tag, corners in board.tags.items() for quad in found.get(tag, [])]
    tags, pixels = (np.array([pair[k] for pair in seen]).reshape(-1, 4, 2) for k in (0, 1))
    upright = _agreeing(tags, pixels)
    if len(upright[0]) >= _SURE_TAGS or len(tags) < _SURE_TAGS:
        return upright
    turned = _agreeing(tags, np.roll(pixels, 2, axis=1))
    return turned if len(turned[0]) >= _SURE_TAGS else upright


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
    if len(near) >= _ENOUGH_TAGS and np.mean(near) < _AGREEING:
        # The print of another board: half of its tags agree by chance where it is of another size or pattern.
        return tags[:0], pixels[:0]
    return tags[near], pixels[near]


def _predict(
    board: TaggedBoard, known: Floats, pixels: Floats, shape: tuple[int, ...], reach: float
) -> tuple[Floats, Floats, Mask]:
    """Where the board's corners should appear, by the homography of the known points nearest to each.

    Returns places (P, 2) px, axes (P, 2, 2) px of one cell's sides, and which places are within reach (in squares)
    of known points.
    """
    points, square = board.corners, board.square
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
    axes = 2 * board.cell / square * np.stack([seen[:, 1] - seen[:, 2], seen[:, 3] - seen[:, 4]], axis=1)
    known_well = np.all(np.isfinite(seen), axis=(1, 2))
    places = np.where(known_well[:, None], places, -1e3)
    axes = np.where(known_well[:, None, None], axes, np.eye(2))
    trusted = distance.min(axis=1) < reach * square
    inside = (places > 2).all(axis=1) & (places < np.array(shape[::-1]) - 3).all(axis=1)
    return places, axes, known_well & trusted & inside & (np.linalg.det(axes) > 4)


def _fit(
    light: LightImage, blur: float, board: TaggedBoard, places: Floats, axes: Floats, wanted: Mask
) -> tuple[Floats, Floats, Mask, tuple[Tone, float] | None]:
    """Corners (P, 2), sigma (P,), which (P,) of the wanted ones are sure, and the tone and blur (px) that would suit
    better."""
    pixels, sigma, good = places.copy(), np.full(len(places), np.inf), np.zeros(len(places), bool)
    index = np.flatnonzero(wanted)
    if not len(index):
        return pixels, sigma, good, None
    fit = fit_corners(light, places[index], axes[index], corner_window(axes[index]), board.clear, blur)
    shift = fit.pixels - places[index]
    far = np.linalg.norm(shift, axis=1)
    again = np.flatnonzero(far > RECENTRE)
    if len(again):
        # The window follows the corner, a few pixels at most, so that it holds the four squares evenly.
        here = places[index[again]] + shift[again] * np.minimum(1, 4 / far[again, None])
        own_axes = axes[index[again]]
        fit = fit.changed(again, fit_corners(light, here, own_axes, corner_window(own_axes), board.clear, blur))
    side = np.linalg.norm(axes[index], axis=2).min(axis=1)
    moved = np.linalg.norm(fit.pixels - places[index], axis=1)
    sure = good_corners(fit) & alike_corners(fit) & (moved < np.maximum(1.5, 0.2 * side))
    sure &= np.sign(fit.contrast) == board.signs[index]
    pixels[index], good[index] = fit.pixels, sure
    sigma[index] = np.hypot(fit.sigma, leak(axes[index], fit.blur))
    return pixels, sigma, good, _better(light, fit, sure)


def _better(light: LightImage, fit: CornerFit, sure: Mask) -> tuple[Tone, float] | None:
    """Tone and blur (px) by corners that are sure, fitted in those of a usual sharp picture; None where these do."""
    tone, blur = better_tone(fit, sure), float(np.median(fit.blur[sure])) if sure.any() else 0.0
    return None if tone is None and blur < SHARP else (tone or light.tone, blur)


def _smooth(board: TaggedBoard, pixels: Floats, good: Mask) -> Mask:
    """Which corners agree with the homography of their neighbours: a corner on a wrong edge does not."""
    keep = good.copy()
    index = np.flatnonzero(good)
    if len(index) < 6:
        return keep
    place = board.corners[index] / board.square
    distance = np.linalg.norm(place[:, None] - place[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    near = np.argsort(distance, axis=1, kind="stable")[:, : min(8, len(index) - 1)]
    local = local_homographies(place[near] - place[:, None], pixels[index][near])
    with np.errstate(invalid="ignore"):
        side = board.cell / board.square * np.sqrt(np.abs(np.linalg.det(local[:, :2, :2])))
    error = np.linalg.norm(local[:, :2, 2] - pixels[index], axis=1)
    # Extrapolating by a square through a strongly distorted lens misses by some per cent of a square; where the
    # neighbours fix no homography (nan) there is no evidence against the corner.
    keep[index] = ~(error > np.maximum(1.0, 0.12 * side))
    return keep
