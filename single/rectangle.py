"""Rectangles of known size and how they are recognised.

The frame of a rectangle: origin in its middle, x to the right along its width, y down along its height (as one
reads the sheet), z into the sheet, away from who looks at it. So a camera that looks straight at an upright sheet
has the axes of the sheet, and the corners of Eq. 4 run bottom right, bottom left, top left, top right.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from .errors import QuadrigError
from .pose import Pose
from .rotation import Array

PAPER_SIZES = {
    "A5": (0.210, 0.148),
    "A4": (0.297, 0.210),
    "A3": (0.420, 0.297),
    "A2": (0.594, 0.420),
    "letter": (0.2794, 0.2159),
    "legal": (0.3556, 0.2159),
}
"""Width and height in metres of papers lying across (ISO 216; ANSI in inches of 25.4 mm)."""


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


@dataclass(frozen=True)
class Rectangle:
    """A rectangle of known size, metres; a moving one has a new pose in every frameset.

    world_from_rect: its surveyed pose (R', T' of Eq. 50), where there is one.
    Raises QuadrigError where a side is not a positive length.
    """

    name: str
    width: float
    height: float
    marking: Marking = field(default_factory=PointsMarking)
    moving: bool = False
    world_from_rect: Pose | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        for side, length in (("width", self.width), ("height", self.height)):
            if not (np.isfinite(length) and length > 0):
                raise QuadrigError(
                    f"rectangle {self.name!r}: {side} is {length} m; give the measured length, above zero"
                )

    @property
    def corners(self) -> Array:
        """P1 to P4 of Eq. 4, (4, 3) metres in the rectangle's frame."""
        return rectangle_corners(self.width, self.height)


def rectangle_corners(width: Array | float, height: Array | float) -> Array:
    """P1(+l1,+l2) P2(-l1,+l2) P3(-l1,-l2) P4(+l1,-l2) of Eq. 4. Shapes (...) -> (..., 4, 3), metres."""
    l1, l2 = np.broadcast_arrays(np.asarray(width, float) / 2, np.asarray(height, float) / 2)
    zero = np.zeros_like(l1)
    x = np.stack([l1, -l1, -l1, l1], axis=-1)
    y = np.stack([l2, l2, -l2, -l2], axis=-1)
    return np.stack([x, y, np.broadcast_to(zero[..., None], x.shape)], axis=-1)


def board_points(columns: int, rows: int, square: float) -> Array:
    """Inner corners ((columns-1)(rows-1), 3) of a board of columns x rows squares, metres, row by row from the
    top left, in the frame of the whole board's rectangle."""
    x = (np.arange(1, columns) - columns / 2) * square
    y = (np.arange(1, rows) - rows / 2) * square
    grid_y, grid_x = np.meshgrid(y, x, indexing="ij")
    return np.stack([grid_x.ravel(), grid_y.ravel(), np.zeros(grid_x.size)], axis=-1)
