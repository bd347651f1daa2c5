"""Finding the rectangles in live frames: roughly in every frame, exactly in those that are worth keeping.

A full search of a 1280x720 frame and the fit of its corners cost more than half a second for four cameras; a sheet in
a hand moves a few tens of pixels from frame to frame. So each camera is searched near where its rectangles were last;
every so often the whole frame is searched at half size. The
corners are fitted to a fraction of a pixel only by `refine`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from quadrig.single.detect import check_rectangles, detect
from quadrig.single.detect_board import detect_charuco
from quadrig.single.detect_tag import detect_tags, find_tags
from quadrig.single.dictionaries import canonical_dictionary
from quadrig.single.marking_image import charuco_tag_squares
from quadrig.single.rectangle import CharucoMarking, Rectangle, TagMarking, rectangle_corners
from quadrig.single.rotation import Array
from quadrig.single.view import View

from .frame import Frame, Picture

# Every so many frames of a camera the whole frame is searched at half size; and, where nothing is known, at full
# size, for a tag too small to be read at half.
_HALF_EVERY, _FULL_EVERY = 5, 10
# A window reaches this far beyond where the rectangle was: part of its size (motion, the quiet zone), and px.
_REACH, _LEAST_REACH = 0.45, 24
# Pictures narrower than this are searched whole, always.
_NARROW = 800

# Standard deviation (px) of a tag's corners before they are fitted.
_ROUGH_SIGMA = 1.0
# Fewest tags of a board by which it is told from somebody else's.
_LEAST_BOARD_TAGS = 2
# The order of Eq. 4 from OpenCV's (top left, top right, bottom right, bottom left).
_EQ4_FROM_OPENCV = [2, 3, 0, 1]

Box = tuple[int, int, int, int]
Family = tuple[str, bool]
FoundTags = dict[Family, dict[int, list[Array]]]


@dataclass(frozen=True, eq=False)
class Search:
    """What one frame showed. views: with camera and frameset, rough where `refine` can do better; grey: its picture.

    found: the tags' rough corners (4, 2) px in OpenCV's order, by dictionary and polarity, then by id.
    """

    camera: str
    frameset: int
    views: tuple[View, ...]
    grey: Picture
    found: FoundTags


@dataclass
class _Memory:
    boxes: dict[str, Box] = field(default_factory=dict)
    count: int = 0


class LiveSearch:
    """Searches the frames of several cameras; different cameras may be searched from different threads."""

    def __init__(self, rectangles: Sequence[Rectangle]) -> None:
        check_rectangles(rectangles)
        self._rectangles = tuple(rectangles)
        self._memories: dict[str, _Memory] = {}

    def search(self, frame: Frame, frameset: int) -> Search:
        """Where the rectangles are in one frame. Raises QuadrigError where the frame cannot be decoded."""
        grey = frame.grey()
        # Cameras take turns with their whole-frame searches, so that no frameset pays for all of them.
        memory = self._memories.setdefault(frame.camera, _Memory(count=7 * len(self._memories)))
        views, found = self._find(grey, memory)
        height, width = grey.shape
        memory.boxes = {view.rectangle: _box(view, width, height) for view in views}
        memory.count += 1
        return Search(frame.camera, frameset, _named(views, frame.camera, frameset), grey, found)

    def refine(self, search: Search) -> tuple[View, ...]:
        """The Views of a frame with corners fitted to a fraction of a pixel; what does not fit is left out."""
        views = [view for view in search.views if self._rectangle(view) not in _tagged(self._rectangles)]
        for family, members in tag_families(self._rectangles).items():
            grey, found = _polarised(search.grey, family), search.found.get(family, {})
            views += detect_tags(grey, [r for r in members if isinstance(r.marking, TagMarking)], found)
            boards = [detect_charuco(grey, r, found) for r in members if isinstance(r.marking, CharucoMarking)]
            views += [view for view in boards if view is not None]
        return _named(views, search.camera, search.frameset)

    def _rectangle(self, view: View) -> Rectangle:
        return next(rectangle for rectangle in self._rectangles if rectangle.name == view.rectangle)

    def _find(self, grey: Picture, memory: _Memory) -> tuple[list[View], FoundTags]:
        height, width = grey.shape
        everywhere = {rectangle.name: (0, 0, width, height) for rectangle in self._rectangles}
        if width < _NARROW or (not memory.boxes and memory.count % _FULL_EVERY == 0):
            return self._near(grey, everywhere)
        views, found = self._near(grey, memory.boxes)
        if views and memory.count % _HALF_EVERY:
            return views, found
        half = np.asarray(cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
        known = {view.rectangle for view in views}
        unknown = {name: (0, 0, width // 2, height // 2) for name in everywhere if name not in known}
        boxes = {view.rectangle: _box(_doubled(view), width, height) for view in self._near(half, unknown)[0]}
        more, more_found = self._near(grey, boxes)
        for family, tags in more_found.items():
            found[family] = {**tags, **found.get(family, {})}
        return [*views, *more], found

    def _near(self, grey: Picture, boxes: dict[str, Box]) -> tuple[list[View], FoundTags]:
        """Rough Views inside the windows; windows that overlap are searched as one."""
        views: list[View] = []
        found: FoundTags = {}
        wanted = [rectangle for rectangle in self._rectangles if rectangle.name in boxes]
        for family, members in tag_families(wanted).items():
            tags: dict[int, list[Array]] = {}
            for box in _merged([boxes[r.name] for r in members]):
                window, corner = _cut(grey, box)
                for identity, quads in find_tags(_polarised(window, family), family[0]).items():
                    tags.setdefault(identity, []).extend(quad + corner for quad in quads)
            found[family] = tags
            views += [view for r in members if (view := _rough_view(r, tags)) is not None]
        for rectangle in wanted:
            if rectangle not in _tagged(wanted):
                window, corner = _cut(grey, boxes[rectangle.name])
                views += [replace(view, pixels=view.pixels + corner) for view in detect(window, [rectangle])]
        return views, found


def _rough_view(rectangle: Rectangle, found: dict[int, list[Array]]) -> View | None:
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
    for rectangle in _tagged(rectangles):
        marking = rectangle.marking
        assert isinstance(marking, TagMarking | CharucoMarking)
        inverted = isinstance(marking, CharucoMarking) and marking.inverted
        families.setdefault((canonical_dictionary(marking.dictionary), inverted), []).append(rectangle)
    return families


def _tagged(rectangles: Sequence[Rectangle]) -> list[Rectangle]:
    return [r for r in rectangles if isinstance(r.marking, TagMarking | CharucoMarking)]


def _polarised(grey: Picture, family: Family) -> Picture:
    return 255 - grey if family[1] else grey


def _named(views: Sequence[View], camera: str, frameset: int) -> tuple[View, ...]:
    return tuple(replace(view, camera=camera, frameset=frameset) for view in views)


def _cut(grey: Picture, box: Box) -> tuple[Picture, Array]:
    """A window of the picture, and where its first pixel is."""
    left, top, right, bottom = box
    return np.ascontiguousarray(grey[top:bottom, left:right]), np.array([left, top], float)


def _doubled(view: View) -> View:
    """A View of the picture at half size in the pixels of the whole one, whose first pixel covers two by two."""
    return replace(view, pixels=2 * view.pixels + 0.5)


def _box(view: View, width: int, height: int) -> Box:
    """The window in which the rectangle of a View will be in the next frame."""
    low, high = _outline(view)
    reach = max(_LEAST_REACH, _REACH * float((high - low).max()))
    left, top = np.maximum(low - reach, 0).astype(int)
    right, bottom = np.minimum(high + reach + 1, [width, height]).astype(int)
    return int(left), int(top), int(right), int(bottom)


def _outline(view: View) -> tuple[Array, Array]:
    """Least and greatest pixel of the whole rectangle: a board's inner corners stand well inside of it."""
    span = np.ptp(view.points[:, :2], axis=0)
    low, high = view.pixels.min(0), view.pixels.max(0)
    inner = len(view.points) > 4
    margin = (high - low) / np.maximum(np.sqrt(len(view.points)) - 1, 1) if inner and span.all() else np.zeros(2)
    return low - margin, high + margin


def _merged(boxes: Sequence[Box]) -> list[Box]:
    merged: list[Box] = []
    for box in boxes:
        while (other := next((m for m in merged if _overlap(m, box)), None)) is not None:
            merged.remove(other)
            box = _union(box, other)
        merged.append(box)
    return merged


def _overlap(a: Box, b: Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _union(a: Box, b: Box) -> Box:
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])
