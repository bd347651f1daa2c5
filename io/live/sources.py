"""Sources: one capture thread each, so that a source that stalls or goes away never holds up the others."""

import threading
import time
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from quadrig.io.live.frame import Frame
from quadrig.io.live.source_readers import Payload, Reader, SourceLostError, SourceSpec, open_reader
from quadrig.single.errors import QuadrigError

Pace = Literal["real time", "consumed"]
Condition = Literal["opening", "running", "stalled", "lost", "ended", "failed"]

_SECOND = 1_000_000_000
# A live source is kept this many frames back: enough to find the frame of one instant among cameras of 60 and of 10
# frames a second, few enough that nothing old is ever shown.
_KEPT_FRAMES = 8
# Files that are played as fast as they are consumed decode this far ahead.
_AHEAD = 3
# A source is called stalled after this long without a picture: longer than the slowest webcam takes in the dark.
STALL_SECONDS = 1.5
# Waits between attempts to open a lost source: quick enough for a plug put back, slow enough not to hammer a camera.
_FIRST_RETRY, _LAST_RETRY = 0.5, 4.0


@dataclass(frozen=True)
class SourceState:
    """How a source does. rate: frames a second of late; frames: how many came; detail: what is wrong, in words."""

    name: str
    condition: Condition
    detail: str = ""
    frames: int = 0
    rate: float = 0.0
    retries: int = 0


class Source:
    """One camera's capture thread and the newest of its frames.

    pace: "real time" plays files by their own clock and drops what nobody fetched; "consumed" waits until each
    frame was fetched. start: the moment (ns of the wall clock) at which all files begin.
    """

    def __init__(self, name: str, spec: SourceSpec, pace: Pace = "real time", start: int | None = None) -> None:
        self.name, self.spec, self.pace = name, spec, pace
        self._start = time.time_ns() if start is None else start
        self._waits = pace == "consumed" and not spec.live
        self._frames: deque[Frame] = deque()
        self._changed = threading.Condition()
        self._stop = threading.Event()
        self._condition: Condition = "opening"
        self._detail, self._count, self._retries = "", 0, 0
        self._last = time.monotonic()
        self._arrivals: deque[tuple[float, int]] = deque(maxlen=30)
        self._thread = threading.Thread(target=self._run, name=f"source {name}", daemon=True)
        self._thread.start()

    def frames(self) -> list[Frame]:
        """The frames that wait, oldest first; they stay until drop_through."""
        with self._changed:
            return list(self._frames)

    def drop_through(self, stamp: int) -> None:
        """Forget the frames up to and with this stamp (ns)."""
        with self._changed:
            while self._frames and self._frames[0].stamp <= stamp:
                self._frames.popleft()
            self._changed.notify_all()

    def state(self) -> SourceState:
        """How the source does now. Never blocks."""
        now = time.monotonic()
        condition, detail = self._condition, self._detail
        if condition in ("running", "opening") and now - self._last > STALL_SECONDS and not self._waits:
            condition, detail = "stalled", f"nothing came for more than {STALL_SECONDS:g} s"
        recent = [arrived for arrived, _ in list(self._arrivals) if now - arrived < 2.0]
        rate = (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 2 else 0.0
        return SourceState(self.name, condition, detail, self._count, rate, self._retries)

    @property
    def period(self) -> float:
        """Seconds from frame to frame by their stamps, median over the latest; 0 while not known."""
        stamps = [stamp for _, stamp in list(self._arrivals)]
        steps = sorted(b - a for a, b in pairwise(stamps))
        return steps[len(steps) // 2] / _SECOND if steps else 0.0

    @property
    def silence(self) -> float:
        """Seconds since the last frame came."""
        return time.monotonic() - self._last

    @property
    def sequential(self) -> bool:
        """Whether every frame waits until it was fetched."""
        return self._waits

    def close(self, patience: float = 1.0) -> None:
        """Stop the thread; one that hangs in a driver is left behind after `patience` seconds."""
        self._stop.set()
        with self._changed:
            self._changed.notify_all()
        self._thread.join(patience)

    def _held_back(self) -> bool:
        return self._waits and len(self._frames) >= _AHEAD

    def _run(self) -> None:
        retry = _FIRST_RETRY
        while not self._stop.is_set():
            before = self._count
            try:
                self._play()
                self._condition = "ended"
                return
            except SourceLostError as lost:
                self._condition, self._detail = "lost", str(lost)
            except QuadrigError as error:
                self._condition, self._detail = "failed", str(error)
                return
            self._retries += 1
            retry = _FIRST_RETRY if self._count > before else min(2 * retry, _LAST_RETRY)
            self._stop.wait(retry)

    def _play(self) -> None:
        reader = open_reader(self.spec)
        try:
            self._last = time.monotonic()
            while not self._stop.is_set():
                answer = reader.read()
                if answer is None:
                    return
                if len(answer[1]):
                    self._publish(self._frame(reader, *answer))
        finally:
            reader.close()

    def _frame(self, reader: Reader, media_time: int, payload: Payload) -> Frame:
        if reader.live:
            stamp = time.time_ns()
        else:
            stamp = self._start + media_time
            if self.pace == "real time":
                self._stop.wait(max(0.0, (stamp - time.time_ns()) / _SECOND))
        arrived = time.monotonic()
        if isinstance(payload, bytes):
            return Frame(self.name, stamp, arrived, encoded=payload, timed=self.spec.timed)
        return Frame(self.name, stamp, arrived, picture=payload, timed=self.spec.timed)

    def _publish(self, frame: Frame) -> None:
        with self._changed:
            while self._held_back() and not self._stop.is_set():
                self._changed.wait()
            self._frames.append(frame)
            while not self._waits and len(self._frames) > _KEPT_FRAMES:
                self._frames.popleft()
            self._count += 1
            self._last = frame.arrived
            self._arrivals.append((frame.arrived, frame.stamp))
            self._condition, self._detail = "running", ""


@dataclass(frozen=True, eq=False)
class LiveFrameset:
    """The frames of one instant, by camera name. index counts from 0; stamp in ns."""

    index: int
    stamp: int
    frames: dict[str, Frame]


class LiveFramesets:
    """Brings the frames of one instant together, whatever the sources' rates, with or without all of them.

    Live: the newest moment that every source has reached. Files played as fast as they are consumed: each moment
    of the slowest file. tolerance: s; None takes 0.6 of each source's own period, for its nearest frame is at most
    half a period away.
    """

    # A source whose rate is not known yet counts as 10 frames a second. Pictures that a person or a trigger drops
    # into watched folders belong together within a second.
    _UNKNOWN_PERIOD, _WATCH_TOLERANCE = 0.1, 1.0
    # Longest wait for a live source that is late: a frameset without it is worth more than a late one.
    _LONGEST_WAIT = 0.25

    def __init__(self, sources: Sequence[Source], tolerance: float | None = None) -> None:
        self.sources = list(sources)
        self._tolerance = tolerance
        self._index = 0

    def next(self, timeout: float = 1.0) -> LiveFrameset | None:
        """The next frameset, or None where there is none within `timeout` s or every source has ended."""
        until = time.monotonic() + timeout
        while True:
            found = self._try()
            if found is not None or self.ended or time.monotonic() > until:
                return found
            time.sleep(0.002)

    @property
    def ended(self) -> bool:
        """Whether nothing more will come."""
        return all(s.state().condition in ("ended", "failed") and not s.frames() for s in self.sources)

    def _try(self) -> LiveFrameset | None:
        waiting = {source: source.frames() for source in self.sources}
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
        self._index += 1
        return LiveFrameset(self._index - 1, instant, chosen)

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
