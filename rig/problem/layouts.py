"""Where rectangles stand on their bodies: which are to be found, which are given, and which is the body's frame.

A rectangle by itself is a body of one, and its frame the body's; so is that of one rectangle of each body of which no
pose is given: nothing else says where a body's frame is.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose, stacked
from quadrig.single.rectangle import Rectangle

# Nothing stands farther from its body's frame than 100 m (1/m^2; in 1/rad^2 it says nothing): what no View shows
# stays solvable.
_UNKNOWN = 1e-4


@dataclass(frozen=True, eq=False)
class Layouts:
    """L poses body_from_rect of rectangles that are not their body's frame, those that are to be found first.

    names (L,): of the rectangles; number (R,): the row of each rectangle of the problem, -1 for one that is the frame
    of its body; rectangles that are one sheet share theirs. found: how many of them are to be found. given: a batch
    (L,), identity where nothing is given; information (L, 6): how well each is known beforehand, 1/variance of its
    step.
    """

    names: tuple[str, ...]
    number: Ints
    found: int
    given: Pose
    information: Floats

    @property
    def is_given(self) -> Mask:
        """Which of the poses (L,) bool are given, exactly or not."""
        return (self.information > _UNKNOWN).any(axis=1) | (np.arange(len(self.names)) >= self.found)


def body_of(rectangle: Rectangle) -> str:
    """The body that a rectangle stands on: its own name where it is a body by itself."""
    return rectangle.body or rectangle.name


def sheets_of(rectangles: Mapping[str, Rectangle]) -> dict[str, str]:
    """The name of the sheet that each rectangle is, by name."""
    return {name: one.sheet if one.sheet in rectangles else name for name, one in rectangles.items()}


def layouts_of(rectangles: Mapping[str, Rectangle], seen: Mapping[str, int], frame: str | None) -> Layouts:
    """The layouts of rectangles of whose sheets so many Views are there, by name. frame: a rectangle that is to be
    the frame of its body, where no pose on that is given."""
    sheet_of = sheets_of(rectangles)
    sheets = [one for name, one in rectangles.items() if sheet_of[name] == name]
    frames = _frames(sheets, seen, frame)
    known = [r for r in sheets if r.body_from_rect is not None]
    open_ones = [r for r in sheets if r.body_from_rect is None and r.name not in frames and seen.get(r.name)]
    loose = [r for r in known if max(r.layout_sigma) > 0 and seen.get(r.name)]
    firm = [r for r in known if r not in loose]
    ordered = [*open_ones, *loose, *firm]
    row = {rectangle.name: index for index, rectangle in enumerate(ordered)}
    information = np.full((len(ordered), 6), _UNKNOWN)
    for index, rectangle in enumerate(loose, len(open_ones)):
        # Of rotation and position one may be known exactly: to a micrometre or microradian, which is as good.
        information[index] = np.repeat(1 / np.maximum(rectangle.layout_sigma, 1e-6) ** 2, 3)
    return Layouts(
        tuple(row),
        np.array([row.get(sheet_of[name], -1) for name in rectangles], int),
        len(open_ones) + len(loose),
        stacked([r.body_from_rect or Pose.identity() for r in ordered]),
        information,
    )


def _frames(rectangles: Iterable[Rectangle], seen: Mapping[str, int], frame: str | None) -> set[str]:
    """The rectangle of each body without given poses that is its frame: the one asked for, else the best seen."""
    bodies: dict[str, list[Rectangle]] = {}
    for rectangle in rectangles:
        bodies.setdefault(body_of(rectangle), []).append(rectangle)
    chosen = set()
    for members in bodies.values():
        if all(one.body_from_rect is None for one in members):
            chosen.add(max(members, key=lambda one: (one.name == frame, seen.get(one.name, 0))).name)
    return chosen


def check_bodies(rectangles: Iterable[Rectangle]) -> None:
    """Raises QuadrigError where rectangles of one body do not move alike, or a body has the name of a rectangle."""
    rectangles = list(rectangles)
    names = {rectangle.name for rectangle in rectangles}
    moving: dict[str, Rectangle] = {}
    for one in rectangles:
        if not one.body:
            continue
        if one.body in names:
            raise QuadrigError(f"body {one.body!r} has the name of a rectangle; give it one of its own")
        other = moving.setdefault(one.body, one)
        if other.moving != one.moving:
            moves, stands = (one, other) if one.moving else (other, one)
            raise QuadrigError(
                f"body {one.body!r}: rectangle {moves.name!r} of it moves and {stands.name!r} stands still; "
                "rectangles of one body are fixed to each other: let both move, or neither"
            )
