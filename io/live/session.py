"""The live loop of `rig setup`: sources to framesets to search to graph to solution to screen."""

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from quadrig.io.config.rig_toml import RigConfig
from quadrig.io.live.blind import BlindCameras
from quadrig.io.live.keeper import Keeper, Kept
from quadrig.io.live.kept_views import encode_views, read_kept_views
from quadrig.io.live.recorder import LiveRecorder
from quadrig.io.live.search import LiveSearch, Search
from quadrig.io.live.solver import Job, LiveSolver, Solution, solve, thinned
from quadrig.io.live.source_readers import SourceSpec
from quadrig.io.live.sources import LiveFrameset, LiveFramesets, Pace, Source, SourceState
from quadrig.io.live.state import SetupState
from quadrig.rig.coach.advice import Situation, advise, good_for
from quadrig.rig.coach.conversation import Coach
from quadrig.rig.coach.fault import Fault
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.view import View

# Solutions take turns with rests of the same length, so that the search keeps its share of the processor.
_REST = 1.0
# Solutions in a row, each with new framesets, that must be as accurate as asked. The truth is as near after the first
# as after the second (benchmarks/stopping.py), but two or three framesets cover a corner of the room, in which a rig
# is soon good that is not where the sheet goes next.
_CONFIRMED = 2
# Frames of this long ago count into the rate and the latency that are shown.
_RATE_SECONDS = 3.0


class Screen(Protocol):
    """Something that shows a session."""

    def show(self, state: SetupState) -> None:
        """Show one moment. Must not block."""
        ...

    def close(self) -> None:
        """Leave the screen as it should stay."""
        ...


@dataclass(frozen=True, eq=False)
class SetupPlan:
    """What a session is to do.

    sources: by camera name. until: the accuracy, m, at which it stops by itself. pace: of files. earlier: the
    recordings of sessions that this one goes on from. tolerance: s, between frames of one frameset.
    """

    config: RigConfig
    sources: Mapping[str, SourceSpec]
    recording: Path
    until: float | None = None
    pace: Pace = "real time"
    earlier: tuple[Path, ...] = ()
    tolerance: float | None = None


@dataclass(frozen=True, eq=False)
class SetupResult:
    """What a session came to.

    latencies: s, of each frameset from arrival until it was handed to the screens; ending: why it stopped.
    fault: what is wrong with the sheets, though there is a rig.
    """

    rig: Rig | None
    trouble: str
    views: tuple[View, ...]
    framesets: int
    kept: int
    seconds: float
    ending: str
    dropped: int = 0
    latencies: tuple[float, ...] = ()
    cameras: tuple[CameraInput, ...] = ()
    fault: Fault | None = None


@dataclass
class _Shown:
    """What was shown of late."""

    times: deque[tuple[float, float]] = field(default_factory=deque)
    latencies: list[float] = field(default_factory=list)

    def add(self, arrived: float) -> None:
        now = time.monotonic()
        self.latencies.append(now - arrived)
        self.times.append((now, now - arrived))
        while self.times[0][0] < now - _RATE_SECONDS:
            self.times.popleft()

    @property
    def rate(self) -> float:
        if len(self.times) < 2:
            return 0.0
        return (len(self.times) - 1) / max(self.times[-1][0] - self.times[0][0], 1e-9)

    @property
    def latency(self) -> float:
        return float(np.median([latency for _, latency in self.times])) if self.times else 0.0


class SetupSession:
    """One session. run() returns when the accuracy is reached, `stop` says so, or every source has ended."""

    def __init__(self, plan: SetupPlan, screens: Sequence[Screen], stop: Callable[[], str]) -> None:
        self._plan, self._screens, self._stop = plan, list(screens), stop
        self._rectangles = plan.config.rectangles
        self._names = tuple(plan.sources)
        self._search = LiveSearch(self._rectangles)
        self._blind = BlindCameras(self._rectangles)
        self._coach = Coach()
        self._solution: Solution | None = None
        self._sizes: dict[str, tuple[int, int]] = {}
        self._shown = _Shown()
        self._solved, self._rest_until, self._begun = 0, 0.0, 0.0
        self._accurate = 0
        self._framesets = 0
        self._seen_since: frozenset[str] = frozenset()

    def run(self) -> SetupResult:
        """Capture, search, solve and coach until the end; the recording is closed whatever happens."""
        began = time.monotonic()
        # Two threads search: OpenCV lets go of the interpreter while it does, and its own would be in their way.
        cv2.setNumThreads(1)
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="search")
        self._fitters = ThreadPoolExecutor(1, thread_name_prefix="fit")
        self._keeper = Keeper(self._search, self._rectangles, self._fitters)
        self._solver = LiveSolver()
        offset = self._restore()
        self._recorder = LiveRecorder(self._plan.recording, {"rig.toml": self._plan.config.text.encode()})
        start = time.time_ns()
        sources = [Source(name, spec, self._plan.pace, start) for name, spec in self._plan.sources.items()]
        framesets = LiveFramesets(sources, self._plan.tolerance)
        ending = "interrupted"
        try:
            ending = self._loop(framesets, offset)
        except KeyboardInterrupt:
            pass
        finally:
            for source in sources:
                source.close()
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._keep_last()
            self._fitters.shutdown(wait=True, cancel_futures=True)
            self._solver.close()
            self._recorder.close()
        return self._result(ending, time.monotonic() - began)

    def _restore(self) -> int:
        """Take over the Views of earlier recordings; the number of the first new frameset."""
        views: list[View] = []
        for path in self._plan.earlier:
            earlier, sizes = read_kept_views(path)
            views += [view for view in earlier if view.camera in self._names]
            self._sizes.update({name: size for name, size in sizes.items() if name in self._names})
        self._keeper.restore(views)
        return max((view.frameset for view in views), default=-1) + 1

    def _loop(self, framesets: LiveFramesets, offset: int) -> str:
        while True:
            if asked := self._stop():
                return asked
            frameset = framesets.next(timeout=0.2)
            states = tuple(source.state() for source in framesets.sources)
            searches: list[Search] = []
            if frameset is not None:
                searches = self._take(frameset, offset)
            elif framesets.ended:
                return self._ended(states)
            self._collect()
            self._show(frameset, searches, states, offset)
            if self._accurate >= _CONFIRMED:
                return f"reached {1000 * (self._plan.until or 0):g} mm"

    def _take(self, frameset: LiveFrameset, offset: int) -> list[Search]:
        index = offset + frameset.index
        waits = self._plan.pace == "consumed"
        searches = list(self._pool.map(lambda f: self._search_frame(f, index), frameset.frames.values()))
        for frame in frameset.frames.values():
            self._recorder.write(frame, wait=waits)
        whole = [search for search in searches if search is not None]
        for search in whole:
            height, width = search.grey.shape
            self._sizes[search.camera] = (width, height)
        diagonals = {name: float(np.hypot(*size)) for name, size in self._sizes.items()}
        self._keeper.consider(index, frameset.stamp, whole, diagonals)
        fault = self._blind.look(whole, frameset.stamp / 1e9)
        if fault is not None:
            self._keeper.blame(fault)
        self._framesets += 1
        return whole

    def _search_frame(self, frame, index: int) -> Search | None:
        try:
            return self._search.search(frame, index)
        except QuadrigError:
            # A damaged frame is one frame lost; the source's own state tells when it goes on.
            return None

    def _collect(self) -> None:
        kept = self._keeper.collect(wait=self._plan.pace == "consumed")
        if kept is not None:
            self._note(kept)
            self._advise_at_once()
        # Files that are played until an accuracy is reached stop at the same frameset on every run.
        waits = self._plan.pace == "consumed" and self._plan.until is not None
        solution = self._solver.take(wait=waits)
        if solution is not None:
            now = time.monotonic()
            self._solution = solution
            self._accurate = self._accurate + 1 if self._is_accurate(solution.rig) else 0
            if solution.rig is not None and len(solution.rig.cameras) == len(self._names):
                self._coach = self._coach.hear(solution.advice, self._take_shown(), now)
            if solution.fault is not None:
                self._keeper.blame(solution.fault)
            self._rest_until = now if waits else now + _REST * (now - self._begun)
        if self._keeper.framesets > self._solved and self._solver.idle and time.monotonic() >= self._rest_until:
            self._begun, self._solved = time.monotonic(), self._keeper.framesets
            self._solver.begin(self._job(live=True))

    def _advise_at_once(self) -> None:
        """Advice that needs no rig: until all cameras have one, a solution would only bring older news."""
        rig = self._solution.rig if self._solution else None
        if rig is None or len(rig.cameras) < len(self._names):
            situation = Situation(
                self._names, self._rectangles, tuple(self._keeper.views), refused_pairs=self._coach.refused_pairs
            )
            self._coach = self._coach.hear(advise(situation), self._take_shown(), time.monotonic())

    def _take_shown(self) -> frozenset[str]:
        """The cameras that something new was shown since the coach last heard of it."""
        shown, self._seen_since = self._seen_since, frozenset()
        return shown

    def _note(self, kept: Kept) -> None:
        if kept.views:
            self._seen_since = self._seen_since | {view.camera for view in kept.views}
            self._recorder.note(kept.stamp, encode_views(kept.frameset, kept.views, self._sizes))

    def _keep_last(self) -> None:
        kept = self._keeper.collect(wait=True)
        if kept is not None:
            self._note(kept)

    def _inputs(self) -> tuple[CameraInput, ...]:
        return tuple(
            self._plan.config.camera_input(name, *self._sizes[name]) for name in self._names if name in self._sizes
        )

    def _job(self, live: bool) -> Job:
        views = self._keeper.views
        return Job(
            self._inputs(),
            self._rectangles,
            thinned(views) if live else tuple(views),
            self._plan.config.reference,
            self._plan.until,
            self._coach.refused,
            self._coach.refused_pairs,
        )

    def _is_accurate(self, rig: Rig | None) -> bool:
        """Whether what was asked for is reached, by all cameras."""
        if self._plan.until is None or rig is None or len(rig.cameras) < len(self._names):
            return False
        return bool(rig.working_accuracy <= self._plan.until)

    def _show(
        self, frameset: LiveFrameset | None, searches: Sequence[Search], states: tuple[SourceState, ...], offset: int
    ) -> None:
        sentence, fault = self._sentence(states)
        rig = self._solution.rig if self._solution else None
        note = good_for(rig) if rig is not None else ""
        views = tuple(view for search in searches for view in search.views)
        state = SetupState(
            sentence,
            note if note not in sentence else "",
            fault,
            offset + frameset.index if frameset else -1,
            frameset.stamp if frameset else 0,
            frameset.frames if frameset else {},
            views,
            states,
            tuple(self._keeper.views),
            self._keeper.framesets,
            rig,
            self._coach.advice,
            self._shown.rate,
            self._shown.latency,
        )
        for screen in self._screens:
            screen.show(state)
        if frameset is not None:
            self._shown.add(min(frame.arrived for frame in frameset.frames.values()))

    def _sentence(self, states: Sequence[SourceState]) -> tuple[str, bool]:
        """The one sentence: a source that is gone, then a fault, then the advice."""
        gone = [state for state in states if state.condition in ("stalled", "lost", "failed")]
        if gone:
            names = ", ".join(state.name for state in gone)
            details = ", ".join(dict.fromkeys(state.detail for state in gone))
            again = "" if all(state.condition == "failed" for state in gone) else "; trying again"
            return f"no picture from {names}: {details}{again}", True
        fault = self._keeper.fault()
        if fault is not None:
            return fault.sentence, True
        if self._coach.advice is None:
            self._advise_at_once()
        return (self._coach.advice.sentence if self._coach.advice else "", False)

    @staticmethod
    def _ended(states: Sequence[SourceState]) -> str:
        failed = [state.detail for state in states if state.condition == "failed"]
        if failed and all(state.frames == 0 for state in states):
            raise QuadrigError(failed[0])
        return "every source has ended"

    def _result(self, ending: str, seconds: float) -> SetupResult:
        views = tuple(self._keeper.views)
        rig, trouble, fault = None, "nothing was seen: no camera gave a picture; look at the sources", None
        if self._sizes:
            solution = solve(self._job(live=False))
            rig, trouble, fault = solution.rig, solution.trouble, solution.fault
        return SetupResult(
            rig,
            trouble,
            views,
            self._framesets,
            self._keeper.framesets,
            seconds,
            ending,
            self._recorder.dropped,
            tuple(self._shown.latencies),
            self._inputs(),
            fault,
        )
