"""What boards of squares share: their size, inner corners, ink, and how they are followed."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.patch import INK, Patch
from quadrig.single.rectangle import Marking, Metres, Rectangle

# A picture 8000 px wide has 16 px for each of so many: about what a corner or a circle needs to be found.
_MOST_A_SIDE = 500


@dataclass(frozen=True)
class BoardMarking(Marking):
    """A board of columns x rows squares of side `square`, metres.

    Raises QuadrigError where there are fewer than two squares a side, or they have no size.
    """

    columns: int
    rows: int
    square: Metres

    noun: ClassVar[str] = "board"

    def __post_init__(self) -> None:
        check_counts(self.columns, self.rows, 2, "a board has two squares or more a side")
        check_length("square", self.square)

    @property
    def size(self) -> tuple[float, float]:
        return self.columns * self.square, self.rows * self.square

    def points(self, _rectangle: Rectangle, /) -> Floats:
        return board_points(self.columns, self.rows, self.square)

    def scaled(self, scale: float, /) -> Self:
        return replace(self, square=round(self.square * scale, 6))

    def quiet_zone(self, _rectangle: Rectangle, /) -> float:
        return 0.5 * self.square

    def middle_of(self, column: int, row: int) -> tuple[float, float]:
        """Middle of a square, metres in the rectangle's frame."""
        return (column + 0.5 - self.columns / 2) * self.square, (row + 0.5 - self.rows / 2) * self.square

    def ink_patches(self, first_ink: int) -> list[Patch]:
        """The dark squares: those whose column plus row is even (first_ink 0) or odd (1)."""
        side = self.square
        left, top = -self.columns / 2 * side, -self.rows / 2 * side
        return [
            Patch(left + c * side, top + r * side, left + (c + 1) * side, top + (r + 1) * side, INK)
            for r in range(self.rows)
            for c in range(self.columns)
            if (c + r) % 2 == first_ink
        ]


def check_counts(columns: int, rows: int, least: int, words: str) -> None:
    """Raises QuadrigError, with the words, where a board has fewer than `least` a side, or more than can be seen."""
    for side, count in (("columns", columns), ("rows", rows)):
        if count < least:
            raise QuadrigError(f"{side} is {count}; {words}")
        if count > _MOST_A_SIDE:
            raise QuadrigError(f"{side} is {count}; no picture shows more than {_MOST_A_SIDE} a side")


def check_length(name: str, length: float) -> None:
    """Raises QuadrigError where it is none."""
    if not (np.isfinite(length) and length > 0):
        raise QuadrigError(f"{name} is {length} m; give the measured length, above zero")


def board_points(columns: int, rows: int, square: float) -> Floats:
    """Inner corners ((columns-1)(rows-1), 3) of a board of columns x rows squares, metres, row by row from the
    top left, in the frame of the whole board's rectangle."""
    x = (np.arange(1, columns, dtype=float) - columns / 2) * square
    y = (np.arange(1, rows, dtype=float) - rows / 2) * square
    grid_y, grid_x = np.meshgrid(y, x, indexing="ij")
    return np.stack([grid_x.ravel(), grid_y.ravel(), np.zeros(grid_x.size)], axis=-1)
