"""Looking for sheets that rig.toml does not know, now and then, where a camera sees none that it does."""

import time
from collections.abc import Sequence

import cv2
import numpy as np

from quadrig.single.detect_tag import find_tags
from quadrig.single.rectangle import Rectangle

from .live_search import Search, tag_families

# One camera is looked at this often (s): without wanted ids its picture costs as much as a frameset.
_EVERY = 0.5
# Dictionaries people print, looked for in turn after those of rig.toml. Small ones of many ids read clutter as tags.
_USUAL = ("apriltag_36h11", "aruco_4x4_50", "aruco_5x5_100", "aruco_6x6_250", "apriltag_25h9")


class ForeignTags:
    """Remembers what was found, so that only a tag seen twice in a row is believed."""

    def __init__(self, rectangles: Sequence[Rectangle]) -> None:
        own = [family[0] for family in tag_families(rectangles)]
        self._own = own
        self._others = [name for name in _USUAL if name not in own]
        self._turn, self._last = 0, 0.0
        self._before: dict[str, set[tuple[str, int]]] = {}

    def look(self, searches: Sequence[Search]) -> dict[str, list[tuple[str, int]]]:
        """For one camera that sees no known sheet: the tags (dictionary, id) it has seen in two looks."""
        blind = [search for search in searches if not search.views]
        now = time.monotonic()
        if not blind or now - self._last < _EVERY:
            return {}
        self._last, self._turn = now, self._turn + 1
        # Two looks in a row go to one camera and one dictionary beside rig.toml's own.
        search = blind[self._turn // 2 % len(blind)]
        other = [self._others[self._turn // 2 // max(1, len(blind)) % len(self._others)]] if self._others else []
        half = np.asarray(cv2.resize(search.grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
        seen = {(name, tag) for name in [*self._own, *other] for tag in find_tags(half, name, quick=True)}
        twice = seen & self._before.get(search.camera, set())
        self._before[search.camera] = seen
        return {search.camera: sorted(twice)} if twice else {}
