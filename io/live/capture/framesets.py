"""Framesets of live sources: the frames of one instant, whatever the sources' rates."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.capture.source import Source, SourceState

_SECOND = 1_000_000_000


@dataclass(frozen=True, eq=False)
class LiveFrameset:
    """The frames of one instant, by camera name. stamp in ns."""

    index: int
    stamp: int
    frames: dict[str, Frame]


class LiveFramesets:
    """Brings the frames of one instant together, whatever the sources' rates, with or without all of them.

    Live: the newest moment that every source has reached. Files played as fast as they are consumed: each moment
    of the slowest file. tolerance: s; None takes 0.6 of each source's own period, for its nearest frame is at most
    half a period away. first: the index of the first frameset. count: how many there were.
    """

    # A source whose rate is not known yet counts as 10 frames a second. Pictures that a person or a trigger drops
    # into watched folders belong together within a second.
    _UNKNOWN_PERIOD, _WATCH_TOLERANCE = 0.1, 1.0
    # Longest wait for a live source that is late: a frameset without it is worth more than a late one.
    _LONGEST_WAIT = 0.25

    def __init__(self, sources: Sequence[Source], tolerance: float | None = None, first: int = 0) -> None:
        self.count = 0
        self._sources, self._tolerance, self._first = tuple(sources), tolerance, first

    def next(self, timeout: float = 1.0) -> LiveFrameset | None:
        """The next frameset, or None where there is none within `timeout` s or every source has ended."""
        until = time.monotonic() + timeout
        while True:
            found = self._try()
            if found is not None or self.ended or time.monotonic() > until:
                return found
            time.sleep(0.002)

    def states(self) -> tuple[SourceState, ...]:
        """How each source does now. Never blocks."""
        return tuple(source.state() for source in self._sources)

    def close(self) -> None:
        """Stop the sources."""
        for source in self._sources:
            source.close()

    @property
    def ended(self) -> bool:
        """Whether nothing more will come."""
        return all(s.state().condition in ("ended", "failed") and not s.frames() for s in self._sources)

    def _try(self) -> LiveFrameset | None:
        waiting = {source: source.frames() for source in self._sources}
        if any(not frames and self._worth_waiting(source) for source, frames in waiting.items()):
            return None
        ready = {source: frames for source, frames in waiting.items() if frames}
        if not ready:
            return None
        instant = self._instant(ready)
        for source in ready:
            source.drop_through(instant - self._limit(source) - 1)
        if any(s.sequential and not s.frames() and self._worth_waiting(s) for s in ready):
            return None
        return self._take(instant, ready)

    def _take(self, instant: int, sources: Iterable[Source]) -> LiveFrameset | None:
        chosen: dict[str, Frame] = {}
        for source in sources:
            nearest = min(source.frames(), key=lambda frame: abs(frame.stamp - instant), default=None)
            if nearest is not None and abs(nearest.stamp - instant) <= self._limit(source):
                chosen[source.name] = nearest
                source.drop_through(nearest.stamp)
        if not chosen:
            return None
        self.count += 1
        return LiveFrameset(self._first + self.count - 1, instant, chosen)

    def _worth_waiting(self, source: Source) -> bool:
        condition = source.state().condition
        if source.sequential:
            return condition in ("opening", "running", "stalled")
        return condition == "running" and source.silence < min(2 * (source.period or 1.0), self._LONGEST_WAIT)

    @staticmethod
    def _instant(ready: dict[Source, list[Frame]]) -> int:
        files = [frames[0].stamp for source, frames in ready.items() if source.sequential]
        live = [frames[-1].stamp for source, frames in ready.items() if not source.sequential]
        return min(live) if live else max(files)

    def _limit(self, source: Source) -> int:
        if self._tolerance is not None:
            return int(self._tolerance * _SECOND)
        if source.spec.kind == "watch":
            return int(self._WATCH_TOLERANCE * _SECOND)
        return int(0.6 * (source.period or self._UNKNOWN_PERIOD) * _SECOND)
