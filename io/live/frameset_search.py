"""All frames of a frameset searched at once."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.capture.framesets import LiveFrameset
from quadrig.io.live.search import LiveSearch, Search
from quadrig.single.errors import QuadrigError


class FramesetSearch:
    """Searches on the threads of `pool`. sizes: width and height, px, of each camera's pictures as far as known."""

    def __init__(self, search: LiveSearch, pool: ThreadPoolExecutor, sizes: Mapping[str, tuple[int, int]]) -> None:
        self.sizes = dict(sizes)
        self._search, self._pool = search, pool

    @property
    def diagonals(self) -> dict[str, float]:
        """Diagonal, px, of each camera's pictures."""
        return {camera: float(np.hypot(*size)) for camera, size in self.sizes.items()}

    def search(self, frameset: LiveFrameset) -> tuple[Search, ...]:
        """What each frame showed, but for damaged ones."""
        searches = self._pool.map(lambda frame: self._search_frame(frame, frameset.index), frameset.frames.values())
        whole = tuple(search for search in searches if search is not None)
        for search in whole:
            height, width = search.grey.shape
            self.sizes[search.camera] = (width, height)
        return whole

    def _search_frame(self, frame: Frame, frameset: int) -> Search | None:
        try:
            return self._search.search(frame, frameset)
        except QuadrigError:
            # A damaged frame is one frame lost; the source's own state says when it goes on.
            return None
