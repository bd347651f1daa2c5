"""Markings: how a rectangle is recognised."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from quadrig.single.arrays import Floats


@dataclass(frozen=True)
class TagMarking:
    """One ArUco or AprilTag square; dictionary such as "apriltag_36h11" or "aruco_4x4_50"."""

    dictionary: str
    id: int
    kind: Literal["tag"] = "tag"


@dataclass(frozen=True)
class CharucoMarking:
    """A ChArUco board of columns x rows squares of side `square`, tags of side `marker`, metres.

    legacy: OpenCV's pattern before 4.6 (a board of even rows starts with a tag). inverted: white on black.
    first_id: the id of the board's first tag; the others count on from it, row by row.
    """

    columns: int
    rows: int
    square: float
    marker: float
    dictionary: str
    legacy: bool = False
    inverted: bool = False
    first_id: int = 0
    kind: Literal["charuco"] = "charuco"


@dataclass(frozen=True)
class ChessboardMarking:
    """A chessboard of columns x rows squares of side `square` metres, corners (columns-1) x (rows-1)."""

    columns: int
    rows: int
    square: float
    kind: Literal["chessboard"] = "chessboard"


@dataclass(frozen=True)
class PlainMarking:
    """An unmarked sheet, lighter or darker than what it lies on."""

    kind: Literal["plain"] = "plain"


@dataclass(frozen=True)
class PointsMarking:
    """Corners given by hand."""

    kind: Literal["points"] = "points"


Marking = TagMarking | CharucoMarking | ChessboardMarking | PlainMarking | PointsMarking


def board_points(columns: int, rows: int, square: float) -> Floats:
    """Inner corners ((columns-1)(rows-1), 3) of a board of columns x rows squares, metres, row by row from the
    top left, in the frame of the whole board's rectangle."""
    x = (np.arange(1, columns, dtype=float) - columns / 2) * square
    y = (np.arange(1, rows, dtype=float) - rows / 2) * square
    grid_y, grid_x = np.meshgrid(y, x, indexing="ij")
    return np.stack([grid_x.ravel(), grid_y.ravel(), np.zeros(grid_x.size)], axis=-1)


def starts_with_tag(marking: CharucoMarking) -> bool:
    """Whether the top left square of the board holds a tag (legacy boards of even rows) instead of ink."""
    return marking.legacy and marking.rows % 2 == 0


def charuco_tag_squares(marking: CharucoMarking) -> list[tuple[int, int]]:
    """(column, row) of the squares that hold tags, in the order of their ids."""
    parity = 0 if starts_with_tag(marking) else 1
    return [(c, r) for r in range(marking.rows) for c in range(marking.columns) if (c + r) % 2 == parity]
