"""The live loop of `rig setup`: sources to framesets to search to kept Views to solutions to screens."""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass

import cv2

from quadrig.io.live.blind import BlindCameras
from quadrig.io.live.capture.framesets import LiveFrameset, LiveFramesets
from quadrig.io.live.capture.source import Source, SourceState
from quadrig.io.live.coaching import Coaching, sentence_of
from quadrig.io.live.display import Display, Screen
from quadrig.io.live.frameset_search import FramesetSearch
from quadrig.io.live.keeper import Keeper
from quadrig.io.live.plan import SetupPlan, SetupResult
from quadrig.io.live.record.kept_views import encode_views, read_earlier_views
from quadrig.io.live.record.recorder import LiveRecorder
from quadrig.io.live.search import LiveSearch, Search
from quadrig.io.live.solutions import LiveSolutions
from quadrig.io.live.solver import LiveSolver, SolveRequest, solve, thinned
from quadrig.io.live.state import SetupState
from quadrig.rig.coach.advice import good_for
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single.errors import QuadrigError
from quadrig.single.view import View

# Seconds without a frameset after which the screens are shown how the sources do.
_LONGEST_SILENCE = 0.2


def run_setup(plan: SetupPlan, screens: Sequence[Screen], stop: Callable[[], str]) -> SetupResult:
    """Capture, search, solve and coach until the accuracy is reached, `stop` says why, or every source has ended.

    The recording is closed whatever happens. Raises QuadrigError where it cannot be written or no source can be read.
    """
    began = time.monotonic()
    # Two threads search: OpenCV lets go of the interpreter while it does, and its own would be in their way.
    cv2.setNumThreads(1)
    ending = "interrupted"
    with ExitStack() as stack:
        session = _begun(plan, screens, stack)
        with suppress(KeyboardInterrupt):
            ending = session.run(stop)
    return session.result(ending, time.monotonic() - began)


def _begun(plan: SetupPlan, screens: Sequence[Screen], stack: ExitStack) -> "SetupSession":
    """A session whose parts the stack closes: the sources first, then what they feed."""
    earlier = read_earlier_views(plan.earlier, plan.cameras)
    search = LiveSearch(plan.rectangles)
    room = {"rig.toml": plan.config.text.encode()}
    recorder = stack.enter_context(closing(LiveRecorder(plan.recording, room, plan.replaces)))
    solver = stack.enter_context(closing(LiveSolver()))
    keeper = Keeper(search, plan.rectangles, stack.enter_context(ThreadPoolExecutor(1, thread_name_prefix="fit")))
    keeper.restore(earlier.views)
    pool = stack.enter_context(ThreadPoolExecutor(2, thread_name_prefix="search"))
    start = time.time_ns()
    sources = [Source(name, spec, plan.pace, start) for name, spec in plan.sources.items()]
    return SetupSession(
        plan,
        stack.enter_context(closing(LiveFramesets(sources, plan.tolerance, earlier.framesets))),
        recorder,
        FramesetSearch(search, pool, earlier.sizes),
        keeper,
        BlindCameras(plan.rectangles),
        LiveSolutions(solver, plan),
        Coaching(plan.cameras, plan.rectangles),
        Display(screens),
    )


@dataclass(frozen=True, eq=False)
class SetupSession:
    """The parts of a session, and how one frameset goes through them. Made by run_setup."""

    plan: SetupPlan
    framesets: LiveFramesets
    recorder: LiveRecorder
    search: FramesetSearch
    keeper: Keeper
    blind: BlindCameras
    solutions: LiveSolutions
    coaching: Coaching
    display: Display

    def run(self, stop: Callable[[], str]) -> str:
        """Frameset after frameset until the end; why it ended."""
        try:
            return self._loop(stop)
        finally:
            self._note_kept(wait=True)

    def result(self, ending: str, seconds: float) -> SetupResult:
        """What all that was kept comes to."""
        rig, trouble, fault = None, "nothing was seen: no camera gave a picture; look at the sources", None
        if self.search.sizes:
            solution = solve(self._request(self.keeper.views))
            rig, trouble, fault = solution.rig, solution.trouble, solution.fault
        return SetupResult(
            rig,
            trouble,
            tuple(self.keeper.views),
            self.framesets.count,
            self.keeper.framesets,
            seconds,
            ending,
            self.recorder.dropped,
            tuple(self.display.latencies),
            self._inputs(),
            fault,
        )

    def _loop(self, stop: Callable[[], str]) -> str:
        while not (asked := stop()):
            frameset = self.framesets.next(timeout=_LONGEST_SILENCE)
            states = self.framesets.states()
            if frameset is None and self.framesets.ended:
                return _ended(states)
            searches = self._take(frameset) if frameset is not None else ()
            self._advise(kept=self._note_kept(wait=self.plan.waits))
            self.solutions.begin(self.keeper.framesets, lambda: self._request(thinned(self.keeper.views)))
            self._show(frameset, searches, states)
            if self.solutions.reached:
                return f"reached {1000 * (self.plan.until or 0):g} mm"
        return asked

    def _take(self, frameset: LiveFrameset) -> tuple[Search, ...]:
        """Search a frameset, record it, keep it where it is worth it."""
        searches = self.search.search(frameset)
        for frame in frameset.frames.values():
            self.recorder.write(frame, wait=self.plan.waits)
        self.keeper.consider(frameset.index, frameset.stamp, searches, self.search.diagonals)
        fault = self.search.fault() or self.blind.look(searches, frameset.stamp / 1e9)
        if fault is not None:
            self.keeper.blame(fault)
        return searches

    def _note_kept(self, wait: bool) -> bool:
        """Record the Views that were kept since; whether there was anything to keep."""
        kept = self.keeper.collect(wait)
        if kept is None:
            return False
        if kept.views:
            self.coaching.see(kept.views)
            self.recorder.note(kept.stamp, encode_views(kept.frameset, kept.views, self.search.sizes))
        return True

    def _advise(self, kept: bool) -> None:
        """Advice from what was kept, until the solutions have all cameras; then from each new solution."""
        if (kept or self.coaching.advice is None) and not self.solutions.complete:
            self.coaching.advise_without_rig(self.keeper.views)
        solution = self.solutions.take()
        if solution is None:
            return
        if self.solutions.complete:
            self.coaching.hear(solution.advice)
        if solution.fault is not None:
            self.keeper.blame(solution.fault)

    def _show(
        self, frameset: LiveFrameset | None, searches: Sequence[Search], states: tuple[SourceState, ...]
    ) -> None:
        sentence, is_fault = sentence_of(states, self.keeper.fault(), self.coaching.advice)
        rig = self.solutions.rig
        note = good_for(rig) if rig is not None else ""
        state = SetupState(
            sentence,
            note if note not in sentence else "",
            is_fault,
            frameset.index if frameset else -1,
            frameset.stamp if frameset else 0,
            frameset.frames if frameset else {},
            tuple(view for search in searches for view in search.views),
            states,
            tuple(self.keeper.views),
            self.keeper.framesets,
            rig,
            self.coaching.advice,
        )
        self.display.show(state)

    def _request(self, views: Sequence[View]) -> SolveRequest:
        return SolveRequest(
            self._inputs(),
            self.plan.rectangles,
            tuple(views),
            self.plan.config.reference,
            self.plan.until,
            self.coaching.refused,
            self.coaching.refused_pairs,
        )

    def _inputs(self) -> tuple[CameraInput, ...]:
        sizes = self.search.sizes
        return tuple(self.plan.config.camera_input(name, *sizes[name]) for name in self.plan.cameras if name in sizes)


def _ended(states: Sequence[SourceState]) -> str:
    """Why sources that all ended did. Raises QuadrigError where not one of them gave a picture."""
    failed = [state.detail for state in states if state.condition == "failed"]
    if failed and all(state.frames == 0 for state in states):
        raise QuadrigError(failed[0])
    return "every source has ended"
