"""Tags: one square of an ArUco or AprilTag dictionary."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from quadrig.single.arrays import Floats, Mask, Picture
from quadrig.single.detect.dictionaries import canonical_dictionary, check_tag_ids, tag_cells
from quadrig.single.detect.tag import EQ4_FROM_OPENCV, reads_as, refine_tags, toned_corners
from quadrig.single.patch import INK, PAPER, Patch
from quadrig.single.rectangle import FoundTags, Marking, Rectangle, TagFamily, Tags
from quadrig.single.view import View

ROUGH_SIGMA = 1.0
"""Standard deviation (px) of a tag's corners before they are fitted."""


@dataclass(frozen=True)
class TagMarking(Marking):
    """One ArUco or AprilTag square; dictionary such as "apriltag_36h11" or "aruco_4x4_50", whose canonical name it
    keeps.

    Raises QuadrigError where there is no such dictionary or tag.
    """

    dictionary: str
    id: int

    kind: ClassVar[str] = "tag"
    noun: ClassVar[str] = "tag"

    def __post_init__(self) -> None:
        check_tag_ids(self.dictionary, self.id)
        object.__setattr__(self, "dictionary", canonical_dictionary(self.dictionary))

    @property
    def description(self) -> str:
        return f"tag {self.id} of {self.dictionary}"

    @property
    def tags(self) -> Tags:
        return Tags(TagFamily(self.dictionary), frozenset([self.id]))

    def quiet_zone(self, rectangle: Rectangle, /) -> float:
        # One cell is what detectors ask for; half a cell more survives blur and a crooked cut.
        return 1.5 * max(rectangle.width, rectangle.height) / len(tag_cells(self.dictionary, self.id))

    def patches(self, rectangle: Rectangle, sheet: Patch, /) -> list[Patch]:
        return [sheet, *tag_patches(self.dictionary, self.id, (0, 0), (rectangle.width, rectangle.height))]

    def find(self, grey: Picture, rectangle: Rectangle, found: FoundTags, /) -> View | None:
        return next(iter(self.find_all(grey, [rectangle], found)), None)

    @classmethod
    def find_all(cls, grey: Picture, members: Sequence[Rectangle], found: FoundTags, /) -> list[View]:
        # A tag that is seen twice in one picture is not used: which of the two is meant is unknown.
        seen = {r.name: quads[0] for r in members if len(quads := found.get(_tag_of(r)[1], [])) == 1}
        return _fitted(grey, [r for r in members if r.name in seen], seen, followed=False)

    @classmethod
    def follow_all(cls, grey: Picture, members: Sequence[Rectangle], near: Mapping[str, View], /) -> list[View]:
        known = {r.name: r for r in members if r.name in near and len(near[r.name].pixels) == 4}
        before = {name: near[name].pixels[EQ4_FROM_OPENCV] for name in known}
        views = _fitted(grey, list(known.values()), before, followed=True)
        return [v for v in views if reads_as(grey, v.pixels[EQ4_FROM_OPENCV], *_tag_of(known[v.rectangle]))]

    def rough(self, rectangle: Rectangle, found: FoundTags, /) -> View | None:
        quads = found.get(self.id, [])
        if len(quads) != 1:
            return None
        return View(rectangle.name, rectangle.corners, quads[0][EQ4_FROM_OPENCV], sigma=ROUGH_SIGMA)


def _tag_of(rectangle: Rectangle) -> tuple[str, int]:
    """Dictionary and id of the one tag on a rectangle."""
    assert rectangle.marking.tags is not None
    (tag,) = rectangle.marking.tags.ids
    return rectangle.marking.tags.family.dictionary, tag


def _fitted(grey: Picture, members: Sequence[Rectangle], rough: Mapping[str, Floats], followed: bool) -> list[View]:
    """Views of tags, all of one dictionary, from rough corners (4, 2) px, top left first, by rectangle. followed:
    these are those of the picture before."""
    if not members:
        return []
    cells = np.array([tag_cells(*_tag_of(rectangle)) for rectangle in members])
    before = np.stack([rough[rectangle.name] for rectangle in members])
    outlines = refine_tags(grey, before, cells.shape[1], followed)
    if followed:
        # What moved farther than one close fit reaches gets both fits.
        again = np.flatnonzero(~outlines.sure)
        outlines.replace(again, refine_tags(grey, before[again], cells.shape[1]))
    corners, common = toned_corners(grey, outlines, cells)
    return [
        View(
            members[k].name,
            members[k].corners,
            corners[k, EQ4_FROM_OPENCV],
            sigma=float(outlines.sigma[k]),
            common=common[k, EQ4_FROM_OPENCV],
        )
        for k in np.flatnonzero(outlines.sure).tolist()
    ]


def tag_patches(dictionary: str, tag_id: int, middle: tuple[float, float], size: tuple[float, float]) -> list[Patch]:
    """Runs of white cells on one black rectangle; middle and size in metres."""
    return cell_patches(tag_cells(dictionary, tag_id), middle, size)


def cell_patches(cells: Mask, middle: tuple[float, float], size: tuple[float, float]) -> list[Patch]:
    """The patches of a tag of these cells (n, n), true where they are white."""
    steps = np.arange(len(cells) + 1) / len(cells) - 0.5
    edges_x, edges_y = (middle[0] + size[0] * steps).tolist(), (middle[1] + size[1] * steps).tolist()
    patches = [Patch(edges_x[0], edges_y[0], edges_x[-1], edges_y[-1], INK)]
    for row, line in enumerate(cells):
        changes = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(int)))
        for start, stop in changes.reshape(-1, 2):
            patches.append(Patch(edges_x[start], edges_y[row], edges_x[stop], edges_y[row + 1], PAPER))
    return patches
