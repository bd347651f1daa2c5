"""Rectangles of known size and what a marking must answer of them.

The frame of a rectangle: origin in its middle, x to the right along its width, y down along its height (as one
reads the sheet), z into the sheet, away from who looks at it. So a camera that looks straight at an upright sheet
has the axes of the sheet, and the corners of Eq. 4 run bottom right, bottom left, top left, top right.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, NamedTuple, Self

import numpy as np

from quadrig.single.arrays import Floats, Picture
from quadrig.single.errors import QuadrigError
from quadrig.single.patch import Patch
from quadrig.single.pose import Pose
from quadrig.single.view import View

Metres = Annotated[float, "metres"]
"""A length: a field of a marking that is one may have a unit where people write it."""

WORLD = "world"
"""The body that surveyed rectangles stand on."""

PRINT_SCALE_SIGMA = 0.001
"""How well the size of a sheet that was printed and not measured is known, as a share of it."""
# Who knows a size no better than this cannot calibrate with it.
_LARGEST_SCALE_SIGMA = 0.5

FoundTags = Mapping[int, Sequence[Floats]]
"""Rough corners (4, 2) px of the tags seen in a picture, by id: top left first and clockwise on the printed tag."""


class TagFamily(NamedTuple):
    """Tags that one search finds: of a dictionary, by its canonical name, black on white or inverted, with a border
    of so many cells."""

    dictionary: str
    inverted: bool = False
    border: int = 1


@dataclass(frozen=True)
class Tags:
    """The tags that a marking bears and is found by."""

    family: TagFamily
    ids: frozenset[int]


@dataclass(frozen=True)
class Marking:
    """How a rectangle is recognised: all that differs from one kind of marking to the next.

    A kind is a frozen dataclass derived from this one; its fields are its keys in rig.toml. What is said here holds
    for a marking that no picture shows by itself (and needs few of the arguments: those begin with an underscore).
    """

    kind: ClassVar[str]
    """Its name in rig.toml and in results."""

    noun: ClassVar[str] = "sheet"
    """What a rectangle with it is called where nobody gives it a name."""

    by_hand: ClassVar[bool] = False
    """Whether a person points at its corners: no picture is searched for it."""

    @property
    def description(self) -> str:
        """What to look for, in words."""
        return f"a {self.kind}"

    @property
    def not_found(self) -> str:
        """What to say and to advise where a picture that should show it does not."""
        return f"{self.description} was not found; show it whole, sharp and flat"

    @property
    def size(self) -> tuple[float, float] | None:
        """Width and height in metres where they follow from the marking; None where the sheet's are to be given."""
        return None

    @property
    def tags(self) -> Tags | None:
        """The tags that it bears, or None."""
        return None

    @property
    def marks(self) -> frozenset[Hashable]:
        """What a picture can show of it; two markings that share one of these look alike."""
        return frozenset() if self.tags is None else frozenset((self.tags.family, tag) for tag in self.tags.ids)

    def meant_instead(self, _grey: Picture, /) -> "Sequence[Marking]":
        """What may be meant where a picture does not show this: its sizes counted otherwise, the other polarity."""
        return ()

    def scaled(self, _scale: float, /) -> Self:
        """The marking as a printer of this scale made it, its lengths rounded to a micrometre."""
        return self

    def points(self, rectangle: "Rectangle", /) -> Floats:
        """All points (P, 3) that a View may have, metres in the frame of the rectangle that bears it."""
        return rectangle.corners

    def quiet_zone(self, _rectangle: "Rectangle", /) -> float:
        """Width in metres of the empty border that the marking needs around the rectangle to be found."""
        return 0.0

    def patches(self, _rectangle: "Rectangle", sheet: Patch, /) -> list[Patch]:
        """The drawing of the marking on a sheet of paper, in the order in which its patches are painted."""
        return [sheet]

    def find(self, _grey: Picture, _rectangle: "Rectangle", _found: FoundTags, /) -> View | None:
        """The View of the rectangle if it is surely in the picture (h, w).

        found: the tags of its family in the picture; empty for a marking without tags.
        """
        return None

    def follow(self, _grey: Picture, _rectangle: "Rectangle", _before: View, /) -> View | None:
        """The View of the rectangle if it is near where an earlier picture of the same camera showed it."""
        return None

    @classmethod
    def find_all(cls, grey: Picture, members: "Sequence[Rectangle]", found: FoundTags, /) -> list[View]:
        """What `find` gives of rectangles with markings of this kind and family: for those quicker together."""
        views = [rectangle.marking.find(grey, rectangle, found) for rectangle in members]
        return [view for view in views if view is not None]

    @classmethod
    def follow_all(cls, grey: Picture, members: "Sequence[Rectangle]", near: Mapping[str, View], /) -> list[View]:
        """What `follow` gives of them; near: earlier Views by rectangle."""
        views = [one.marking.follow(grey, one, near[one.name]) for one in members if one.name in near]
        return [view for view in views if view is not None]

    def rough(self, _rectangle: "Rectangle", _found: FoundTags, /) -> View | None:
        """A View of what the search for tags found, before anything is fitted; None where that is too little."""
        return None


@dataclass(frozen=True)
class PointsMarking(Marking):
    """Corners given by hand: no picture is searched for them. What a rectangle has that nobody marked."""

    kind: ClassVar[str] = "points"
    by_hand: ClassVar[bool] = True

    @property
    def description(self) -> str:
        return "corners given by hand"


@dataclass(frozen=True)
class Rectangle:
    """A rectangle of known size, metres; a moving one has a new pose in every frameset.

    body: the rectangles of one body are fixed to each other and move together; one without is a body by itself.
    body_from_rect: its pose on the body (R', T' of Eq. 50), where that is given; found where it is None.
    layout_sigma: how well that is known, rad about and m along each axis; exactly where both are zero.
    back: it is seen from behind too, where the marking appears mirrored (on glass, or printed through).
    scale_sigma: how well its size is known, as a share of it: a printer's scale, or what was measured.
    sheet: the rectangle that it is the same sheet as, at another time: of the same shape, and in the same place on
    its body, wherever that stands; itself where empty.
    Raises QuadrigError where a side is not a positive length, back is asked of a marking that looks the same from
    there, scale_sigma is not a small positive share, or a pose is given on no body or is no rigid one.
    """

    name: str
    width: float
    height: float
    marking: Marking = field(default_factory=PointsMarking)
    moving: bool = False
    back: bool = False
    scale_sigma: float = PRINT_SCALE_SIGMA
    body: str = ""
    body_from_rect: Pose | None = field(default=None, compare=False)
    layout_sigma: tuple[float, float] = (0.0, 0.0)
    sheet: str = ""

    def __post_init__(self) -> None:
        if self.back and self.marking.tags is None:
            raise QuadrigError(
                f"rectangle {self.name!r}: {self.marking.description} looks the same from behind; "
                "leave back out, or take a marking with tags"
            )
        for side, length in (("width", self.width), ("height", self.height)):
            if not (np.isfinite(length) and length > 0):
                raise QuadrigError(
                    f"rectangle {self.name!r}: {side} is {length} m; give the measured length, above zero"
                )
        if not 0 < self.scale_sigma < _LARGEST_SCALE_SIGMA:
            raise QuadrigError(
                f"rectangle {self.name!r}: scale_sigma is {self.scale_sigma}; give how well its size is known, as a "
                f"share above 0 and below {_LARGEST_SCALE_SIGMA} (0.001 for 0.1 %)"
            )
        if self.body_from_rect is not None and not self.body:
            raise QuadrigError(f"rectangle {self.name!r}: body_from_rect is a pose on no body; give its body's name")
        if self.body_from_rect is not None and not self.body_from_rect.is_rigid:
            raise QuadrigError(
                f"rectangle {self.name!r}: body_from_rect is no rotation and position of finite numbers (it mirrors, "
                "enlarges or shears); give a matrix of perpendicular unit columns with determinant 1"
            )
        if not all(0 <= sigma < np.inf for sigma in self.layout_sigma):
            raise QuadrigError(
                f"rectangle {self.name!r}: layout_sigma is {self.layout_sigma}; give two numbers (rad, m), zero "
                "where its pose on the body is known exactly"
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
