"""Chessboards: all of their inner corners, and the colours that say which way round they are."""

from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats, Picture
from quadrig.single.detect.board_corners import RECENTRE, better_tone, corner_window, good_corners, leak, view_sigma
from quadrig.single.detect.saddle_grid import find_saddle_grid
from quadrig.single.subpixel.corner_fit import CornerFit, fit_corners
from quadrig.single.subpixel.tone import LightImage

# Share of a row of squares beyond a board's edge that must be in the picture to show the board to be larger.
_ENOUGH_OF_A_ROW = 0.6
# Squares beyond that edge at which they are looked at; share of the contrast by which their colours alternate.
_BEYOND, _BOTH_COLOURS = 0.4, 0.4
# Side (px) of the smallest square whose corners are kept apart by blur and pixels.
_SMALLEST_SQUARE = 5.0


@dataclass(frozen=True, eq=False)
class FoundGrid:
    """A chessboard in a picture: pixels (rows, columns, 2) of its inner corners and their standard deviation, px.

    sign: 1 where the square at the top left of the first corner is black, -1 where it is white.
    """

    pixels: Floats
    sign: int
    sigma: float


def find_chessboard(grey: Picture, columns: int, rows: int) -> FoundGrid | None:
    """The whole chessboard of columns x rows inner corners in a picture, or None.

    Rows and columns run as on the front of a sheet; which of the turns that look alike it is stays open.
    """
    grid = find_saddle_grid(grey, columns, rows)
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
    sign = _colour_sign(fit, grid.shape[:2])
    if not _all_sure(fit, grid, axes) or sign == 0:
        return None
    pixels = fit.pixels.reshape(grid.shape)
    sigma = view_sigma(np.hypot(fit.sigma, leak(axes.reshape(-1, 2, 2), fit.blur)))
    return None if _goes_on(grey, pixels, fit) else FoundGrid(pixels, sign, sigma)


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


def _goes_on(grey: Picture, grid: Floats, fit: CornerFit) -> bool:
    """Whether squares of both colours follow beyond the board's edge: then it is a part of a larger board.

    The squares themselves are looked at, not their corners: in blur and noise the ends of a board's outermost black
    squares look like corners.
    """
    contrast = float(np.mean(np.abs(fit.grey_contrast)))
    for turned in (grid, grid[::-1], np.swapaxes(grid, 0, 1), np.swapaxes(grid, 0, 1)[::-1]):
        outward = turned[0] - turned[1]
        beyond = turned[0] + (1 + _BEYOND) * outward
        middles = np.rint((beyond[1:] + beyond[:-1]) / 2).astype(int)
        inside = ((middles >= 1) & (middles < np.array(grey.shape[::-1]) - 1)).all(axis=1)
        if np.count_nonzero(inside) < max(_ENOUGH_OF_A_ROW * len(middles), 2):
            continue
        patches = np.array([grey[y - 1 : y + 2, x - 1 : x + 2].mean() for x, y in middles[inside]])
        colours = (1 - 2 * (np.arange(len(middles)) % 2))[inside]
        wave = float(np.mean(colours * (patches - patches.mean())))
        # Half the contrast where the board goes on; nothing on a white border.
        if abs(wave) > _BOTH_COLOURS * contrast:
            return True
    return False


def _colour_sign(fit: CornerFit, shape: tuple[int, ...]) -> int:
    """+1 where the square at the top left of the grid's first corner is black, -1 white, 0 where colours mingle."""
    checker = 1 - 2 * (np.add.outer(np.arange(shape[0]), np.arange(shape[1])) % 2)
    signs = np.sign(fit.contrast).reshape(shape) * checker
    return int(signs[0, 0]) if np.all(signs == signs[0, 0]) else 0
