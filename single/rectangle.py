"""Rectangles of known size and how they are recognised.

The frame of a rectangle: origin in its middle, x to the right along its width, y down along its height (as one
reads the sheet), z into the sheet, away from who looks at it. So a camera that looks straight at an upright sheet
has the axes of the sheet, and the corners of Eq. 4 run bottom right, bottom left, top left, top right.
"""

from dataclasses import dataclass, field

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.marking import Marking, PointsMarking
from quadrig.single.pose import Pose

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
    def corners(self) -> Floats:
        """P1 to P4 of Eq. 4, (4, 3) metres in the rectangle's frame."""
        return rectangle_corners(self.width, self.height)


def rectangle_corners(width: Floats | float, height: Floats | float) -> Floats:
    """P1(+l1,+l2) P2(-l1,+l2) P3(-l1,-l2) P4(+l1,-l2) of Eq. 4. Shapes (...) -> (..., 4, 3), metres."""
    l1, l2 = np.broadcast_arrays(np.asarray(width, float) / 2, np.asarray(height, float) / 2)
    zero = np.zeros_like(l1)
    x = np.stack([l1, -l1, -l1, l1], axis=-1)
    y = np.stack([l2, l2, -l2, -l2], axis=-1)
    return np.stack([x, y, np.broadcast_to(zero[..., None], x.shape)], axis=-1)
