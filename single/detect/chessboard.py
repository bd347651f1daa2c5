"""Chessboards: their inner corners, and which of the readings of a symmetric board."""

import numpy as np

from quadrig.single.arrays import Floats, Ints, Picture
from quadrig.single.detect.board_corners import RECENTRE, better_tone, corner_window, good_corners, view_sigma
from quadrig.single.detect.corner_fit import CornerFit, fit_corners
from quadrig.single.detect.saddle_grid import find_saddle_grid
from quadrig.single.detect.tone import LightImage
from quadrig.single.marking import ChessboardMarking, board_points
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# Share of a row of corners beyond a board's edge that shows the board to be larger.
_ENOUGH_OF_A_ROW = 0.6
# Side (px) of the smallest square whose corners are kept apart by blur and pixels.
_SMALLEST_SQUARE = 5.0


# ---------------------------------------------------------------------------------------------------- chessboards


def detect_chessboard(grey: Picture, rectangle: Rectangle, rough: Floats | None = None) -> View | None:
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
    light = LightImage(grey)
    fit = _fit_grid(light, grid, axes)
    tone = better_tone(fit, good_corners(fit))
    if tone is not None:
        light = LightImage(grey, tone)
        fit = _fit_grid(light, grid, axes)
    signs = _colour_signs(fit, grid.shape[:2])
    if not _all_sure(fit, grid, axes) or signs == 0:
        return None
    pixels = fit.pixels.reshape(grid.shape)
    if _goes_on(light, pixels, fit):
        return None
    readings = _readings(pixels, signs)
    points = board_points(marking.columns, marking.rows, marking.square)
    order = readings[0]
    back = np.argsort(order)
    return View(
        rectangle.name,
        points,
        pixels.reshape(-1, 2)[back],
        alternatives=tuple(points[other[back]] for other in readings[1:]),
        sigma=view_sigma(fit.sigma),
    )


def _right_handed(grid: Floats) -> Floats:
    """The same corners with columns mirrored where needed: the front of a sheet is never seen mirrored."""
    along, down = grid[:, -1] - grid[:, 0], grid[-1] - grid[0]
    turn = np.mean(along[:, 0]) * np.mean(down[:, 1]) - np.mean(along[:, 1]) * np.mean(down[:, 0])
    return grid if turn > 0 else grid[:, ::-1]


def _grid_axes(grid: Floats) -> Floats:
    """px along one square's side, by columns and by rows, at each corner of a grid (rows, columns, 2, 2)."""
    return np.stack([np.gradient(grid, axis=1), np.gradient(grid, axis=0)], axis=2)


def _fit_grid(light: LightImage, grid: Floats, axes: Floats) -> CornerFit:
    flat_axes = axes.reshape(-1, 2, 2)
    fit = fit_corners(light, grid.reshape(-1, 2), flat_axes, corner_window(flat_axes))
    moved = np.linalg.norm(fit.pixels - grid.reshape(-1, 2), axis=1)
    if np.max(moved, initial=0.0) > RECENTRE:
        fit = fit_corners(light, fit.pixels, flat_axes, corner_window(flat_axes))
    return fit


def _all_sure(fit: CornerFit, grid: Floats, axes: Floats) -> bool:
    moved = np.linalg.norm(fit.pixels - grid.reshape(-1, 2), axis=1)
    side = np.linalg.norm(axes.reshape(-1, 2, 2), axis=2).min(axis=1)
    # A corner that ran a third of a square away went to another edge.
    near = np.all(moved < np.maximum(1.5, 0.33 * side))
    return bool(near and np.all(good_corners(fit)) and np.min(side) > _SMALLEST_SQUARE)


def _goes_on(light: LightImage, grid: Floats, fit: CornerFit) -> bool:
    """Whether a row of corners follows beyond the grid's edge: then it is a part of a larger board."""
    contrast, noise, blur = np.abs(fit.contrast).mean(), np.median(fit.noise), np.median(fit.blur)
    for turned in (grid, grid[::-1], np.swapaxes(grid, 0, 1), np.swapaxes(grid, 0, 1)[::-1]):
        beyond = 2 * turned[0] - turned[1]
        axes = np.stack([np.gradient(beyond, axis=0), turned[1] - turned[0]], axis=1)
        inside = ((beyond > 3) & (beyond < np.array(light.grey.shape[::-1]) - 4)).all(axis=1)
        if np.count_nonzero(inside) < _ENOUGH_OF_A_ROW * len(beyond):
            continue
        more = fit_corners(light, beyond[inside], axes[inside], corner_window(axes[inside]))
        side = np.linalg.norm(axes[inside], axis=2).min(axis=1)
        near = np.linalg.norm(more.pixels - beyond[inside], axis=1) < np.maximum(1.5, 0.15 * side)
        # The ends of the outermost black squares look like soft, noisy corners; true ones are like their fellows.
        same = (np.abs(more.contrast) > 0.5 * contrast) & (more.noise < np.maximum(2.5 * noise, 0.04 * contrast))
        same &= more.blur < 1.5 * blur + 0.3
        if np.count_nonzero(good_corners(more) & near & same) >= _ENOUGH_OF_A_ROW * len(beyond):
            return True
    return False


def _colour_signs(fit: CornerFit, shape: tuple[int, ...]) -> int:
    """+1 where the square at the top left of the grid's first corner is black, -1 white, 0 where colours mingle."""
    checker = 1 - 2 * (np.add.outer(np.arange(shape[0]), np.arange(shape[1])) % 2)
    signs = np.sign(fit.contrast).reshape(shape) * checker
    return int(signs[0, 0]) if np.all(signs == signs[0, 0]) else 0


def _readings(pixels: Floats, sign: int) -> list[Ints]:
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
