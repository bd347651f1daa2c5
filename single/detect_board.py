"""Chessboards and ChArUco boards: their inner corners to sub-pixel accuracy."""

import cv2
import numpy as np

from .dictionaries import canonical_dictionary, check_tag_id
from .local_homography import local_homographies, mapped
from .marking_image import charuco_tag_squares, starts_with_tag
from .rectangle import CharucoMarking, ChessboardMarking, Rectangle, board_points
from .rotation import Array
from .saddle_grid import find_saddle_grid
from .subpixel import CornerFit, fit_corners
from .view import View

# A corner whose fit leaves more than this share of its contrast unexplained (rms) is covered, torn or no corner.
_UNEXPLAINED = 0.2
_ALWAYS_EXPLAINED = 0.05
# Grey levels between the squares below which a corner is lost in the noise.
_LEAST_CONTRAST = 12.0
# sigma (px) above which a corner says too little to be worth the risk.
_WORST_SIGMA = 0.5
# A corner this many px from the middle of its window is fitted again in a window of its own.
_RECENTRE = 1.5
# Share of a row of corners beyond a board's edge that shows the board to be larger.
_ENOUGH_OF_A_ROW = 0.6
# Side (px) of the smallest square whose corners are kept apart by blur and pixels.
_SMALLEST_SQUARE = 5.0
# px that the model is wrong by on real lenses, added to what noise explains.
_MODEL_SIGMA = 0.02
# Squares from a tag's corner to the corners of its own square, and from a corner to the next: what lies farther is
# found from those, and from those in turn, for a prediction from few tags goes astray beyond.
_BESIDE, _NEXT, _ROUNDS = 0.7, 1.5, 3
# px from the plane of most corners beyond which a corner is looked for anew.
_PLANE = 2.0
# Largest window (px): farther out the lens bends the squares' edges.
_WIDEST = 7.0


# ---------------------------------------------------------------------------------------------------- chessboards


def detect_chessboard(grey: Array, rectangle: Rectangle, rough: Array | None = None) -> View | None:
    """The View of a chessboard whose corners are all in sight, or None.

    The board's top left square is black. A board of columns + rows even looks the same after half a turn, a square
    one of odd columns after a quarter: all readings that the colours allow are in the View, the one nearest to
    upright in the image first. rough (rows - 1, columns - 1, 2): where to look instead of searching, px.
    """
    marking = rectangle.marking
    assert isinstance(marking, ChessboardMarking)
    grid = find_saddle_grid(grey, marking.columns - 1, marking.rows - 1) if rough is None else rough
    if grid is None:
        return None
    grid = _right_handed(grid)
    axes = _grid_axes(grid)
    fit = _fit_grid(grey, grid, axes)
    signs = _colour_signs(fit, grid.shape[:2])
    if not _all_sure(fit, grid, axes) or signs == 0:
        return None
    pixels = fit.pixels.reshape(grid.shape)
    if _goes_on(grey, pixels, fit):
        return None
    readings = _readings(marking, pixels, signs)
    points = board_points(marking.columns, marking.rows, marking.square)
    order = readings[0]
    back = np.argsort(order)
    return View(
        rectangle.name,
        points,
        pixels.reshape(-1, 2)[back],
        alternatives=tuple(points[other[back]] for other in readings[1:]),
        sigma=_view_sigma(fit.sigma),
    )


def _right_handed(grid: Array) -> Array:
    """The same corners with columns mirrored where needed: the front of a sheet is never seen mirrored."""
    along, down = grid[:, -1] - grid[:, 0], grid[-1] - grid[0]
    turn = np.mean(along[:, 0]) * np.mean(down[:, 1]) - np.mean(along[:, 1]) * np.mean(down[:, 0])
    return grid if turn > 0 else grid[:, ::-1]


def _grid_axes(grid: Array) -> Array:
    """px along one square's side, by columns and by rows, at each corner of a grid (rows, columns, 2, 2)."""
    return np.stack([np.gradient(grid, axis=1), np.gradient(grid, axis=0)], axis=2)


def _fit_grid(grey: Array, grid: Array, axes: Array) -> CornerFit:
    flat_axes = axes.reshape(-1, 2, 2)
    fit = fit_corners(grey, grid.reshape(-1, 2), flat_axes, _window(flat_axes))
    moved = np.linalg.norm(fit.pixels - grid.reshape(-1, 2), axis=1)
    if np.max(moved, initial=0.0) > _RECENTRE:
        fit = fit_corners(grey, fit.pixels, flat_axes, _window(flat_axes))
    return fit


def _window(axes: Array) -> Array:
    """Radius in px that holds the four squares of a corner and nothing beyond them."""
    area = np.abs(np.linalg.det(axes))
    across = area / np.max(np.linalg.norm(axes, axis=2), axis=1)
    return np.clip(0.7 * across, 2.0, _WIDEST)


def _good(fit: CornerFit) -> Array:
    strength = np.abs(fit.contrast)
    explained = fit.noise < _UNEXPLAINED * strength
    return explained & (strength > _LEAST_CONTRAST) & (fit.sigma < _WORST_SIGMA) & np.isfinite(fit.pixels).all(axis=1)


def _alike(fit: CornerFit) -> Array:
    """Which corners leave about as much unexplained as their fellows: one with much more is touched by something."""
    return fit.noise < np.maximum(3 * np.median(fit.noise), _ALWAYS_EXPLAINED * np.abs(fit.contrast))


def _all_sure(fit: CornerFit, grid: Array, axes: Array) -> bool:
    moved = np.linalg.norm(fit.pixels - grid.reshape(-1, 2), axis=1)
    side = np.linalg.norm(axes.reshape(-1, 2, 2), axis=2).min(axis=1)
    # A corner that ran a third of a square away went to another edge.
    near = np.all(moved < np.maximum(1.5, 0.33 * side))
    return bool(near and np.all(_good(fit)) and np.min(side) > _SMALLEST_SQUARE)


def _goes_on(grey: Array, grid: Array, fit: CornerFit) -> bool:
    """Whether a row of corners follows beyond the grid's edge: then it is a part of a larger board."""
    contrast, noise, blur = np.abs(fit.contrast).mean(), np.median(fit.noise), np.median(fit.blur)
    for turned in (grid, grid[::-1], np.swapaxes(grid, 0, 1), np.swapaxes(grid, 0, 1)[::-1]):
        beyond = 2 * turned[0] - turned[1]
        axes = np.stack([np.gradient(beyond, axis=0), turned[1] - turned[0]], axis=1)
        inside = ((beyond > 3) & (beyond < np.array(grey.shape[::-1]) - 4)).all(axis=1)
        if np.count_nonzero(inside) < _ENOUGH_OF_A_ROW * len(beyond):
            continue
        more = fit_corners(grey, beyond[inside], axes[inside], _window(axes[inside]))
        side = np.linalg.norm(axes[inside], axis=2).min(axis=1)
        near = np.linalg.norm(more.pixels - beyond[inside], axis=1) < np.maximum(1.5, 0.15 * side)
        # The ends of the outermost black squares look like soft, noisy corners; true ones are like their fellows.
        same = (np.abs(more.contrast) > 0.5 * contrast) & (more.noise < np.maximum(2.5 * noise, 0.04 * contrast))
        same &= more.blur < 1.5 * blur + 0.3
        if np.count_nonzero(_good(more) & near & same) >= _ENOUGH_OF_A_ROW * len(beyond):
            return True
    return False


def _colour_signs(fit: CornerFit, shape: tuple[int, ...]) -> int:
    """+1 where the square at the top left of the grid's first corner is black, -1 white, 0 where colours mingle."""
    checker = 1 - 2 * (np.add.outer(np.arange(shape[0]), np.arange(shape[1])) % 2)
    signs = np.sign(fit.contrast).reshape(shape) * checker
    return int(signs[0, 0]) if np.all(signs == signs[0, 0]) else 0


def _readings(marking: ChessboardMarking, pixels: Array, sign: int) -> list[Array]:
    """For each reading, the board's point index of every corner in the grid's order; the most upright first."""
    rows, columns = pixels.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    turned, uprightness = [], []
    along, down = np.mean(pixels[:, -1] - pixels[:, 0], axis=0), np.mean(pixels[-1] - pixels[0], axis=0)
    for quarter, right in enumerate((along, down, -along, -down)):
        # A quarter turn of the reading swaps the diagonals of every corner, and may change whose corner is first.
        if quarter % 2 and rows != columns:
            continue
        swaps = (quarter % 2 == 1) ^ bool(_first_parity(rows, columns, quarter))
        if (sign < 0) == swaps:
            turned.append(np.rot90(index, -quarter))
            uprightness.append(right[0] / np.linalg.norm(right))
    if not turned:
        # No turn shows a black top left square: the board is the mirrored print; its points are where they are.
        turned, uprightness = [index, np.rot90(index, 2)], [along[0], -along[0]]
    return [turned[k].ravel() for k in np.argsort(uprightness)[::-1]]


def _first_parity(rows: int, columns: int, quarter: int) -> int:
    """Parity of the grid place that a reading turned by quarters takes for its first corner."""
    first = np.argwhere(np.rot90(np.arange(rows * columns).reshape(rows, columns), -quarter) == 0)[0]
    return int(first.sum() % 2)


# --------------------------------------------------------------------------------------------------- ChArUco boards


def detect_charuco(grey: Array, rectangle: Rectangle, found: dict[int, list[Array]]) -> View | None:
    """The View of a ChArUco board from the rough corners of the tags found, by id, or None.

    grey: light squares lighter than dark ones; an inverted board is given on the inverted image. At least four
    inner corners that are not in one line make a View.
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
    pixels_found, sigma, good = _fit_charuco(grey, marking, places, axes, trusted)
    for _ in range(_ROUNDS):
        good[good] = _on_one_plane(points[good], pixels_found[good])
        if np.count_nonzero(good) < 4:
            break
        places, axes, near = _predict(points, points[good], pixels_found[good], marking, grey.shape, _NEXT)
        near &= ~good
        if not near.any():
            break
        again, sigma_again, good_again = _fit_charuco(grey, marking, places, axes, near)
        pixels_found[good_again], sigma[good_again] = again[good_again], sigma_again[good_again]
        good |= good_again
    good &= _smooth(points, pixels_found, good, marking.square)
    if not _spans_plane(points[good] / marking.square):
        return None
    flat = np.concatenate([points, np.zeros((len(points), 1))], axis=1)
    return View(rectangle.name, flat[good], pixels_found[good], sigma=_view_sigma(sigma[good]))


def _on_one_plane(points: Array, pixels: Array) -> Array:
    """Which corners lie on one board with most; where a lens bends it, the others are found again from these."""
    if len(points) < 6:
        return np.ones(len(points), bool)
    cv2.setRNGSeed(1)
    homography, _ = cv2.findHomography(points * 1e3, pixels, cv2.RANSAC, _PLANE)
    if homography is None:
        return np.ones(len(points), bool)
    placed = cv2.perspectiveTransform(points[:, None] * 1e3, homography)[:, 0]
    return np.linalg.norm(placed - pixels, axis=1) < _PLANE


def _spans_plane(points: Array) -> bool:
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


def _view_sigma(sigma: Array) -> float:
    return float(np.hypot(np.sqrt(np.mean(sigma**2)), _MODEL_SIGMA))


def _tag_corners(marking: CharucoMarking, found: dict[int, list[Array]]) -> tuple[Array, Array]:
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


def _agreeing(tags: Array, pixels: Array) -> tuple[Array, Array]:
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
    points: Array, known: Array, pixels: Array, marking: CharucoMarking, shape, reach: float
) -> tuple[Array, Array, Array]:
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
    far = (np.take_along_axis(distance, near[:, -1:], axis=1)[:, 0] > 2.5 * square) | np.isnan(local).any(axis=(1, 2))
    homography = np.where(far[:, None, None], whole, local)
    seen = mapped(homography, np.array([[0, 0], [0.25, 0], [-0.25, 0], [0, 0.25], [0, -0.25]]))
    places = seen[:, 0]
    axes = 2 * np.stack([seen[:, 1] - seen[:, 2], seen[:, 3] - seen[:, 4]], axis=1)
    known_well = np.isfinite(seen).all(axis=(1, 2))
    places = np.where(known_well[:, None], places, -1e3)
    axes = np.where(known_well[:, None, None], axes, np.eye(2))
    trusted = distance.min(axis=1) < reach * square
    inside = (places > 2).all(axis=1) & (places < np.array(shape[::-1]) - 3).all(axis=1)
    return places, axes, known_well & trusted & inside & (np.linalg.det(axes) > 4)


def _fit_charuco(grey: Array, marking: CharucoMarking, places: Array, axes: Array, wanted: Array):
    """Corners (P, 2), sigma (P,) and which (P,) of the wanted ones are sure."""
    pixels, sigma, good = places.copy(), np.full(len(places), np.inf), np.zeros(len(places), bool)
    index = np.flatnonzero(wanted)
    if not len(index):
        return pixels, sigma, good
    clear = (1 - marking.marker / marking.square) / 2
    fit = fit_corners(grey, places[index], axes[index], _window(axes[index]), clear)
    shift = fit.pixels - places[index]
    far = np.linalg.norm(shift, axis=1)
    again = np.flatnonzero(far > _RECENTRE)
    if len(again):
        # The window follows the corner, a few pixels at most, so that it holds the four squares evenly.
        here = places[index[again]] + shift[again] * np.minimum(1, 4 / far[again, None])
        own_axes = axes[index[again]]
        fit = fit.changed(again, fit_corners(grey, here, own_axes, _window(own_axes), clear))
    side = np.linalg.norm(axes[index], axis=2).min(axis=1)
    moved = np.linalg.norm(fit.pixels - places[index], axis=1)
    sure = _good(fit) & _alike(fit) & (moved < np.maximum(1.5, 0.2 * side))
    sure &= np.sign(fit.contrast) == _expected_signs(marking)[index]
    pixels[index], sigma[index], good[index] = fit.pixels, fit.sigma, sure
    return pixels, sigma, good


def _expected_signs(marking: CharucoMarking) -> Array:
    rows, columns = np.meshgrid(np.arange(marking.rows - 1), np.arange(marking.columns - 1), indexing="ij")
    black_first = -1 if starts_with_tag(marking) else 1
    return (black_first * (1 - 2 * ((rows + columns) % 2))).ravel()


def _smooth(points: Array, pixels: Array, good: Array, square: float) -> Array:
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
