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
from quadrig.single.arrays import Picture
from quadrig.single.detect.image_search import (
    check_rectangles,
    detect_views,
    families,
    find_mirrored,
    find_views,
    follow_views,
    search_tags,
)
from quadrig.single.rectangle import FoundTags, Rectangle, TagFamily
from quadrig.single.view import View

# Of so many frames of a camera one is searched thoroughly: blurred and badly lit tags show up now and then.
_THOROUGH_EVERY = 8


@dataclass(frozen=True, eq=False)
class Search:
    """What one frame showed. views: with camera, frameset and time, rough where `refine` can do better; grey: its
    picture; time: s, of the frame, nan where unknown.

    found: the tags' rough corners (4, 2) px in OpenCV's order, by dictionary and polarity, then by id. behind: exact
    Views of rectangles seen from behind; views has them too.
    """

    camera: str
    frameset: int
    views: tuple[View, ...]
    grey: Picture
    found: dict[TagFamily, FoundTags]
    time: float = float("nan")
    behind: tuple[View, ...] = ()


@dataclass
class _Memory:
    """count: frames of one camera so far; at_half: whether all tags of a family are found at half size, too;
    untagged: what bears no tags, in its last frame; behind: what was seen from behind in it."""

    count: int
    at_half: dict[TagFamily, bool] = field(default_factory=dict)
    untagged: dict[str, View] = field(default_factory=dict)
    behind: tuple[View, ...] = ()


class LiveSearch:
    """Searches the frames of several cameras; different cameras may be searched from different threads."""

    def __init__(self, rectangles: Sequence[Rectangle]) -> None:
        check_rectangles(rectangles)
        self._families = families(rectangles)
        self._two_sided = [rectangle for rectangle in rectangles if rectangle.back]
        self._untagged = [rectangle for rectangle in rectangles if rectangle.marking.tags is None]
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
            if (view := rectangle.marking.rough(rectangle, found[family])) is not None
        ]
        others = self._without_tags(grey, memory.untagged, thorough)
        memory.untagged = {view.rectangle: view for view in others}
        memory.behind = self._behind(grey, {view.rectangle for view in views}, memory.behind, thorough)
        search = Search(frame.camera, frameset, (), grey, found, frame.time, memory.behind)
        return replace(search, views=_named([*views, *others, *memory.behind], search))

    def refine(self, search: Search, names: Collection[str]) -> tuple[View, ...]:
        """The Views of these rectangles with corners fitted to a fraction of a pixel, where they can be."""
        untagged = {rectangle.name for rectangle in self._untagged} & set(names)
        views = [view for view in search.views if view.rectangle in untagged]
        for family, members in self._families.items():
            wanted = [rectangle for rectangle in members if rectangle.name in names]
            views += find_views(search.grey, wanted, search.found[family])
        views += [view for view in search.behind if view.rectangle in names]
        return _named(views, search)

    def _tags_in(self, grey: Picture, half: Picture, family: TagFamily, memory: _Memory, thorough: bool) -> FoundTags:
        """Rough corners by id: of all that can be found, or quickly, at the size that did for them last time."""
        if thorough:
            found = self._tags(grey, family, thorough=True)
            memory.at_half[family] = bool(found) and self._tags(half, family).keys() >= found.keys()
            return found
        if memory.at_half.get(family, False) and (small := self._tags(half, family)):
            return _doubled(small)
        return self._tags(grey, family)

    def _tags(self, grey: Picture, family: TagFamily, thorough: bool = False) -> FoundTags:
        return search_tags(grey, self._families[family], quick=not thorough)

    def _behind(self, grey: Picture, in_front: set[str], before: Sequence[View], thorough: bool) -> tuple[View, ...]:
        """What is seen from behind, where it was a frame ago; elsewhere now and then, for it is a second search."""
        there = {view.rectangle for view in before}
        sought = [r for r in self._two_sided if r.name not in in_front and (thorough or r.name in there)]
        return tuple(find_mirrored(grey, sought, near=None if thorough else before))

    def _without_tags(self, grey: Picture, before: dict[str, View], thorough: bool) -> list[View]:
        """Chessboards and plain sheets, near where they were; elsewhere only now and then, for it takes long."""
        views = follow_views(grey, self._untagged, before)
        elsewhere = [rectangle for rectangle in self._untagged if rectangle.name not in before]
        return [*views, *detect_views(grey, elsewhere)] if thorough else views


def halved(grey: Picture) -> Picture:
    """A picture (H, W) at half its size."""
    return np.asarray(cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)


def _doubled(found: FoundTags) -> FoundTags:
    """Corners in a picture at half size in the pixels of the whole one, whose first pixel covers two by two."""
    return {tag: [2 * quad + 0.5 for quad in quads] for tag, quads in found.items()}


def _named(views: Sequence[View], search: Search) -> tuple[View, ...]:
    return tuple(replace(view, camera=search.camera, frameset=search.frameset, time=search.time) for view in views)
