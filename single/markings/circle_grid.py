"""Grids of circles, symmetric and asymmetric as OpenCV and Kalibr know them."""

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from quadrig.single.arrays import Floats, Ints, Picture
from quadrig.single.detect.circle_grid import find_circle_grid
from quadrig.single.detect.pictures import window_around
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.boards import check_counts, check_length
from quadrig.single.patch import INK, PAPER, Patch
from quadrig.single.rectangle import FoundTags, Marking, Metres, Rectangle
from quadrig.single.view import View


@dataclass(frozen=True)
class CircleGridMarking(Marking):
    """A grid of columns x rows circles.

    spacing: metres from row to row; columns are as far apart, but twice that in an asymmetric grid, where every other
    row is shifted by one spacing (OpenCV's and Kalibr's count). diameter: of a circle, metres, as it is printed; half
    the distance of neighbours where None. It is measured in every picture. inverted: light on dark.
    The rectangle reaches half a spacing beyond the outermost middles.
    Raises QuadrigError where a length is none, there are too few circles, or they touch.
    """

    columns: int
    rows: int
    spacing: Metres
    diameter: Metres | None = None
    asymmetric: bool = False
    inverted: bool = False

    kind: ClassVar[str] = "circles"
    noun: ClassVar[str] = "board"

    def __post_init__(self) -> None:
        check_counts(self.columns, self.rows, 3, "a grid has three circles or more a side")
        check_length("spacing", self.spacing)
        if self.diameter is not None:
            check_length("diameter", self.diameter)
            if self.diameter >= self._nearest:
                raise QuadrigError(
                    f"diameter is {self.diameter} m and circles are {self._nearest:g} m apart; they must not touch"
                )

    @property
    def description(self) -> str:
        kind = "an asymmetric" if self.asymmetric else "a"
        return f"{kind} grid of {self.columns} x {self.rows} circles"

    @property
    def not_found(self) -> str:
        return f"{self.description} was not found; show all of its circles, sharp and flat"

    @property
    def size(self) -> tuple[float, float]:
        return (1 + self.asymmetric) * self.columns * self.spacing, self.rows * self.spacing

    @property
    def marks(self) -> frozenset[Hashable]:
        sides = (self.columns, self.rows) if self.asymmetric else tuple(sorted((self.columns, self.rows)))
        return frozenset([("circles", self.asymmetric, self.inverted, *sides)])

    @property
    def places(self) -> Ints:
        """Where the circles (P, 2) are, in spacings from the first one, row by row."""
        row, column = np.indices((self.rows, self.columns)).reshape(2, -1)
        return np.column_stack([2 * column + row % 2 if self.asymmetric else column, row])

    @property
    def _nearest(self) -> float:
        """Metres from a circle's middle to the nearest other."""
        return self.spacing * (np.sqrt(2.0) if self.asymmetric else 1.0)

    def meant_instead(self, _grey: Picture, /) -> "list[CircleGridMarking]":
        return [
            replace(self, columns=columns, rows=rows, diameter=None, asymmetric=asymmetric, inverted=inverted)
            for inverted in (self.inverted, not self.inverted)
            for asymmetric in (self.asymmetric, not self.asymmetric)
            for columns, rows in ((self.columns, self.rows), (self.rows, self.columns))
        ]

    def scaled(self, scale: float, /) -> Self:
        diameter = None if self.diameter is None else round(self.diameter * scale, 6)
        return replace(self, spacing=round(self.spacing * scale, 6), diameter=diameter)

    def points(self, _rectangle: Rectangle, /) -> Floats:
        middle = (self.places.min(axis=0) + self.places.max(axis=0)) / 2
        return np.pad((self.places - middle) * self.spacing, ((0, 0), (0, 1)))

    def quiet_zone(self, _rectangle: Rectangle, /) -> float:
        return 0.5 * self.spacing

    def patches(self, rectangle: Rectangle, sheet: Patch, /) -> list[Patch]:
        radius = (self.diameter or 0.5 * self._nearest) / 2
        ink, paper = (PAPER, INK) if self.inverted else (INK, PAPER)
        circles = [
            Patch(x - radius, y - radius, x + radius, y + radius, ink, round=True)
            for x, y, _ in self.points(rectangle).tolist()
        ]
        return [replace(sheet, tone=paper), *circles]

    def find(self, grey: Picture, rectangle: Rectangle, _found: FoundTags, /) -> View | None:
        grid = find_circle_grid(grey, self.places, self.inverted)
        if grid is None:
            return None
        points, back = self.points(rectangle), [np.argsort(order) for order in grid.orders]
        return View(
            rectangle.name,
            points,
            grid.pixels[grid.orders[0]],
            alternatives=tuple(points[one][grid.orders[0]] for one in back[1:]),
            sigma=grid.sigma,
        )

    def follow(self, grey: Picture, rectangle: Rectangle, before: View, /) -> View | None:
        window, start = window_around(grey, before.pixels)
        view = self.find(window, rectangle, {})
        return None if view is None else replace(view, pixels=view.pixels + start)
