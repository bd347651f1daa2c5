"""Chessboards, and their readings: a board of columns + rows even looks the same after half a turn."""

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from quadrig.single.arrays import Floats, Ints, Picture
from quadrig.single.detect.chessboard import find_chessboard
from quadrig.single.detect.pictures import window_around
from quadrig.single.detect.saddle_grid import largest_grid
from quadrig.single.markings.boards import BoardMarking
from quadrig.single.patch import Patch
from quadrig.single.rectangle import FoundTags, Rectangle
from quadrig.single.view import View


@dataclass(frozen=True)
class ChessboardMarking(BoardMarking):
    """A chessboard of columns x rows squares of side `square` metres, corners (columns-1) x (rows-1); its top left
    square is black."""

    kind: ClassVar[str] = "chessboard"

    @property
    def not_found(self) -> str:
        corners = f"{self.columns - 1} x {self.rows - 1} inner corners"
        return f"a chessboard of {corners} was not found; show all of its squares, sharp and flat"

    @property
    def marks(self) -> frozenset[Hashable]:
        return frozenset([("chessboard", *sorted((self.columns, self.rows)))])

    def meant_instead(self, grey: Picture, /) -> "list[ChessboardMarking]":
        grid = largest_grid(grey)
        if grid is None:
            return []
        longer, shorter = max(grid) + 1, min(grid) + 1
        sides = (longer, shorter) if self.columns >= self.rows else (shorter, longer)
        return [ChessboardMarking(*sides, self.square)] if sides != (self.columns, self.rows) else []

    def patches(self, _rectangle: Rectangle, sheet: Patch, /) -> list[Patch]:
        return [sheet, *self.ink_patches(first_ink=0)]

    def find(self, grey: Picture, rectangle: Rectangle, _found: FoundTags, /) -> View | None:
        grid = find_chessboard(grey, self.columns - 1, self.rows - 1)
        if grid is None:
            return None
        points, orders = self.points(rectangle), _readings(grid.pixels, grid.sign)
        back = np.argsort(orders[0])
        return View(
            rectangle.name,
            points,
            grid.pixels.reshape(-1, 2)[back],
            alternatives=tuple(points[order[back]] for order in orders[1:]),
            sigma=grid.sigma,
        )

    def follow(self, grey: Picture, rectangle: Rectangle, before: View, /) -> View | None:
        window, start = window_around(grey, before.pixels)
        view = self.find(window, rectangle, {})
        return None if view is None else replace(view, pixels=view.pixels + start)


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
