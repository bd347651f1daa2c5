"""A source: one capture thread each, so that a source that stalls or goes away never holds up the others."""

import threading
import time
from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.capture.reader import PictureData, Reader, SourceLostError
from quadrig.io.live.capture.readers import open_reader
from quadrig.io.live.capture.same_camera import SameCamera
from quadrig.io.live.capture.source_spec import SourceSpec
from quadrig.single.errors import QuadrigError

Pace = Literal["real time", "consumed"]
Condition = Literal["opening", "running", "stalled", "lost", "changed", "ended", "failed"]

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
# What a network or driver held back through a stall comes at once, and its arrival is not when it was taken: frames
# that follow each other in less than this share of the usual period.
_HURRIED = 0.5


@dataclass(frozen=True)
class SourceState:
    """How a source does. rate: frames a second of late; frames: how many came; detail: what is wrong, in words.

    left_out: frames that were not of the camera that was there before (SameCamera).
    """

    name: str
    condition: Condition
    detail: str = ""
    frames: int = 0
    rate: float = 0.0
    retries: int = 0
    left_out: int = 0

    @property
    def sentence(self) -> str:
        """How it does, in words."""
        if self.condition == "changed":
            return f"{self.name} {self.detail}"
        return f"{self.name} is {self.condition}{self.detail and f': {self.detail}'}"


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
        self._last, self._late, self._camera = time.monotonic(), False, SameCamera()
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
        if condition in ("running", "opening", "changed") and now - self._last > STALL_SECONDS and not self._waits:
            condition, detail = "stalled", f"nothing came for more than {STALL_SECONDS:g} s"
        recent = [arrived for arrived, _ in list(self._arrivals) if now - arrived < 2.0]
        rate = (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 2 else 0.0
        return SourceState(self.name, condition, detail, self._count, rate, self._retries, self._camera.left_out)

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
                self._camera.doubt()
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
                    frame = self._frame(reader, *answer)
                    if not reader.live or self._is_now_and_ours(frame):
                        self._publish(frame)
        finally:
            reader.close()

    def _frame(self, reader: Reader, media_time: int, payload: PictureData) -> Frame:
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

    def _is_now_and_ours(self, frame: Frame) -> bool:
        """Whether a live frame was taken when it came, and by the camera whose name it has."""
        gap, self._last = frame.arrived - self._last, frame.arrived
        # Pictures are put into a watched folder whenever somebody does.
        if self._count and gap > STALL_SECONDS and self.spec.kind != "watch":
            self._camera.doubt()
            self._late = True
            return False
        self._late = self._late and gap < _HURRIED * self.period
        if self._late:
            return False
        ours = self._camera.admits(frame)
        if self._camera.trouble:
            self._condition, self._detail = "changed", self._camera.trouble
        return ours

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
