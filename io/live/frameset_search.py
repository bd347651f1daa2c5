"""All frames of a frameset searched at once."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.capture.framesets import LiveFrameset
from quadrig.io.live.search import LiveSearch, Search
from quadrig.rig.coach.fault import Fault
from quadrig.single.errors import QuadrigError


class FramesetSearch:
    """Searches on the threads of `pool`.

    sizes: width and height, px, of each camera's pictures as far as known: those of its first. others: those that a
    camera gives now and that are none of its own, for another size is another lens.
    """

    def __init__(self, search: LiveSearch, pool: ThreadPoolExecutor, sizes: Mapping[str, tuple[int, int]]) -> None:
        self.sizes = dict(sizes)
        self.others: dict[str, tuple[int, int]] = {}
        self._search, self._pool = search, pool

    @property
    def diagonals(self) -> dict[str, float]:
        """Diagonal, px, of each camera's pictures."""
        return {camera: float(np.hypot(*size)) for camera, size in self.sizes.items()}

    def search(self, frameset: LiveFrameset) -> tuple[Search, ...]:
        """What each frame showed, but for damaged ones and those of another size than the camera's first."""
        searches = self._pool.map(lambda frame: self._search_frame(frame, frameset.index), frameset.frames.values())
        whole = tuple(search for search in searches if search is not None)
        own = []
        for search in whole:
            height, width = search.grey.shape
            if self.sizes.setdefault(search.camera, (width, height)) == (width, height):
                self.others.pop(search.camera, None)
                own.append(search)
            else:
                self.others[search.camera] = (width, height)
        return tuple(own)

    def fault(self) -> Fault | None:
        """What to say of a camera whose pictures have another size now."""
        for camera, (width, height) in self.others.items():
            before = "{}x{}".format(*self.sizes[camera])
            return Fault(
                "another size",
                f"{camera} gives pictures of {width}x{height} and gave {before}: another size is another lens; set "
                "it back, or begin again",
                camera,
            )
        return None

    def _search_frame(self, frame: Frame, frameset: int) -> Search | None:
        try:
            return self._search.search(frame, frameset)
        except QuadrigError:
            # A damaged frame is one frame lost; the source's own state says when it goes on.
            return None
