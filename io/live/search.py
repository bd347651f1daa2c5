"""Finding the rectangles in live frames: roughly in every frame, exactly in those that are worth keeping.

One quick pass over a 1280x720 frame finds nearly all tags that a thorough search finds, at a fifth of its cost; over
the same frame at half its size, at a tenth, those that are not too small. So the cameras take turns with the thorough
search, which shows what size will do for the next frames. The corners are fitted to a fraction of a pixel only by
`refine`.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from quadrig.io.live.capture.frame import Frame
from quadrig.single.arrays import Floats, Picture
from quadrig.single.detect.charuco import detect_charuco
from quadrig.single.detect.dictionaries import canonical_dictionary
from quadrig.single.detect.image_search import check_rectangles, detect_views
from quadrig.single.detect.tag import detect_tags, find_tags
from quadrig.single.detect.tag_ids import known_tags
from quadrig.single.marking import CharucoMarking, TagMarking, charuco_tag_squares
from quadrig.single.rectangle import Rectangle, rectangle_corners
from quadrig.single.view import View

# Of so many frames of a camera one is searched thoroughly: blurred and badly lit tags show up now and then.
_THOROUGH_EVERY = 8
# A window for what bears no tags reaches this far beyond where it was: part of its size (motion), and px.
_REACH, _LEAST_REACH = 0.45, 24

# Standard deviation (px) of a tag's corners before they are fitted.
_ROUGH_SIGMA = 1.0
# Fewest tags of a board that distinguish it from somebody else's.
_LEAST_BOARD_TAGS = 2
# The order of Eq. 4 from OpenCV's (top left, top right, bottom right, bottom left).
_EQ4_FROM_OPENCV = [2, 3, 0, 1]

Family = tuple[str, bool]
FoundTags = dict[Family, dict[int, list[Floats]]]


@dataclass(frozen=True, eq=False)
class Search:
    """What one frame showed. views: with camera, frameset and time, rough where `refine` can do better; grey: its
    picture; time: s, of the frame, nan where unknown.

    found: the tags' rough corners (4, 2) px in OpenCV's order, by dictionary and polarity, then by id.
    """

    camera: str
    frameset: int
    views: tuple[View, ...]
    grey: Picture
    found: FoundTags
    time: float = float("nan")


@dataclass
class _Memory:
    """count: frames of one camera so far; at_half: whether all tags of a family are found at half size, too;
    untagged: what bears no tags, in its last frame."""

    count: int
    at_half: dict[Family, bool] = field(default_factory=dict)
    untagged: dict[str, View] = field(default_factory=dict)


class LiveSearch:
    """Searches the frames of several cameras; different cameras may be searched from different threads."""

    def __init__(self, rectangles: Sequence[Rectangle]) -> None:
        check_rectangles(rectangles)
        self._families = tag_families(rectangles)
        self._untagged = [r for r in rectangles if not isinstance(r.marking, TagMarking | CharucoMarking)]
        self._memories: dict[str, _Memory] = {}

    def search(self, frame: Frame, frameset: int) -> Search:
        """Where the rectangles are in one frame. Raises QuadrigError where the frame cannot be decoded."""
        grey = frame.grey
        # Cameras take turns with their thorough searches, so that no frameset pays for all of them.
        memory = self._memories.setdefault(frame.camera, _Memory(count=3 * len(self._memories)))
        thorough = memory.count % _THOROUGH_EVERY == 0
        memory.count += 1
        half = halved(grey)
        found = {family: self._tags_in(grey, half, family, memory, thorough) for family in self._families}
        views = [
            view
            for family, members in self._families.items()
            for rectangle in members
            if (view := _rough_view(rectangle, found[family])) is not None
        ]
        others = self._without_tags(grey, memory.untagged, thorough)
        memory.untagged = {view.rectangle: view for view in others}
        search = Search(frame.camera, frameset, (), grey, found, frame.time)
        return replace(search, views=_named([*views, *others], search))

    def refine(self, search: Search, names: Collection[str]) -> tuple[View, ...]:
        """The Views of these rectangles with corners fitted to a fraction of a pixel, where they can be."""
        untagged = {rectangle.name for rectangle in self._untagged} & set(names)
        views = [view for view in search.views if view.rectangle in untagged]
        for family, members in self._families.items():
            grey, found = _polarised(search.grey, family), search.found[family]
            wanted = [rectangle for rectangle in members if rectangle.name in names]
            views += detect_tags(grey, [r for r in wanted if isinstance(r.marking, TagMarking)], found)
            boards = [detect_charuco(grey, r, found) for r in wanted if isinstance(r.marking, CharucoMarking)]
            views += [view for view in boards if view is not None]
        return _named(views, search)

    def _tags_in(
        self, grey: Picture, half: Picture, family: Family, memory: _Memory, thorough: bool
    ) -> dict[int, list[Floats]]:
        """Rough corners by id: of all that can be found, or quickly, at the size that did for them last time."""
        if thorough:
            found = self._tags(grey, family, thorough=True)
            memory.at_half[family] = bool(found) and self._tags(half, family).keys() >= found.keys()
            return found
        if memory.at_half.get(family, False) and (small := self._tags(half, family)):
            return _doubled(small)
        return self._tags(grey, family)

    def _tags(self, grey: Picture, family: Family, thorough: bool = False) -> dict[int, list[Floats]]:
        ids = [frozenset(tag for _, tag in known_tags([rectangle])) for rectangle in self._families[family]]
        wanted, boards = frozenset().union(*ids), [board for board in ids if len(board) > 1]
        return find_tags(_polarised(grey, family), family[0], wanted, boards, quick=not thorough)

    def _without_tags(self, grey: Picture, before: dict[str, View], thorough: bool) -> list[View]:
        """Chessboards and plain sheets, near where they were; elsewhere only now and then, for it takes long."""
        views: list[View] = []
        for rectangle in self._untagged:
            if rectangle.name in before:
                window, corner = _window(grey, before[rectangle.name])
                views += [replace(view, pixels=view.pixels + corner) for view in detect_views(window, [rectangle])]
            elif thorough:
                views += detect_views(grey, [rectangle])
        return views


def halved(grey: Picture) -> Picture:
    """A picture (H, W) at half its size."""
    return np.asarray(cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)


def _doubled(found: dict[int, list[Floats]]) -> dict[int, list[Floats]]:
    """Corners in a picture at half size in the pixels of the whole one, whose first pixel covers two by two."""
    return {tag: [2 * quad + 0.5 for quad in quads] for tag, quads in found.items()}


def _rough_view(rectangle: Rectangle, found: dict[int, list[Floats]]) -> View | None:
    """A View of the corners of a rectangle's tags as the search found them."""
    marking = rectangle.marking
    if isinstance(marking, TagMarking):
        quads = found.get(marking.id, [])
        if len(quads) != 1:
            return None
        return View(rectangle.name, rectangle.corners, quads[0][_EQ4_FROM_OPENCV], sigma=_ROUGH_SIGMA)
    assert isinstance(marking, CharucoMarking)
    points, pixels = [], []
    corners = rectangle_corners(marking.marker, marking.marker)
    for offset, (column, row) in enumerate(charuco_tag_squares(marking)):
        quads = found.get(marking.first_id + offset, [])
        if len(quads) == 1:
            middle = np.array([column + 0.5 - marking.columns / 2, row + 0.5 - marking.rows / 2, 0.0])
            points.append(corners + middle * marking.square)
            pixels.append(quads[0][_EQ4_FROM_OPENCV])
    if len(points) < _LEAST_BOARD_TAGS:
        return None
    return View(rectangle.name, np.concatenate(points), np.concatenate(pixels), sigma=_ROUGH_SIGMA)


def tag_families(rectangles: Sequence[Rectangle]) -> dict[Family, list[Rectangle]]:
    """Tags and ChArUco boards by dictionary and by whether they are white on black."""
    families: dict[Family, list[Rectangle]] = {}
    for rectangle in rectangles:
        marking = rectangle.marking
        if isinstance(marking, TagMarking | CharucoMarking):
            inverted = isinstance(marking, CharucoMarking) and marking.inverted
            families.setdefault((canonical_dictionary(marking.dictionary), inverted), []).append(rectangle)
    return families


def _polarised(grey: Picture, family: Family) -> Picture:
    return 255 - grey if family[1] else grey


def _named(views: Sequence[View], search: Search) -> tuple[View, ...]:
    return tuple(replace(view, camera=search.camera, frameset=search.frameset, time=search.time) for view in views)


def _window(grey: Picture, view: View) -> tuple[Picture, Floats]:
    """The part of the picture in which the rectangle of a View will be in the next frame, and its first pixel."""
    low, high = view.pixels.min(0), view.pixels.max(0)
    # A board's corners stand a square inside of it.
    columns = np.sqrt(len(view.points))
    reach = np.maximum(_LEAST_REACH, (_REACH + 1 / columns) * float((high - low).max()))
    left, top = np.maximum(low - reach, 0).astype(int)
    right, bottom = (high + reach + 1).astype(int)
    return np.ascontiguousarray(grey[top:bottom, left:right]), np.array([left, top], float)
