"""Solving while frames come in: a process of its own, so that neither search nor screen waits for the solution."""

import multiprocessing
import os
import signal
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass

import numpy as np

from quadrig.io.workers import end_processes, leave_with_parent
from quadrig.rig.adjustment.motion import LONGEST_GAP
from quadrig.rig.calibration import calibrate
from quadrig.rig.coach.advice import Advice, Situation, advise
from quadrig.rig.coach.fault import Fault
from quadrig.rig.coach.in_hand import in_hand
from quadrig.rig.coach.printed_scale import scale_fault
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# Framesets that a live solution uses at most: half a second on one core. The last solution uses all of them.
_LIVE_FRAMESETS = 100
# ... of which so many in a row: the velocity and the acceleration of a sheet need three.
_RUN = 3


@dataclass(frozen=True, eq=False)
class SolveRequest:
    """What is to be solved and advised on."""

    cameras: tuple[CameraInput, ...]
    rectangles: tuple[Rectangle, ...]
    views: tuple[View, ...]
    reference: str | None = None
    target: float | None = None
    refused: tuple[Pose, ...] = ()
    refused_pairs: frozenset[frozenset[str]] = frozenset()


@dataclass(frozen=True, eq=False)
class LiveSolution:
    """The rig as far as it can be known, what to do next, what is wrong; trouble: why there is no rig yet."""

    rig: Rig | None
    advice: Advice
    fault: Fault | None = None
    trouble: str = ""
    framesets: int = 0


def solve(request: SolveRequest) -> LiveSolution:
    """The rig of the Views so far and the advice for the next one."""
    rig, trouble = None, ""
    try:
        rig = calibrate(request.cameras, request.rectangles, request.views, request.reference)
    except QuadrigError as error:
        trouble = str(error)
    except np.linalg.LinAlgError:
        # The first few Views may leave a system that cannot be solved; the next ones mend it.
        more = in_hand(request.rectangles)
        todo = more.so_that("all see more of it") if more.body else "show the sheet in more places, tilted"
        trouble = f"what was seen so far does not fix the rig; {todo}"
    situation = Situation(
        tuple(camera.name for camera in request.cameras),
        request.rectangles,
        request.views,
        rig,
        request.target,
        request.refused,
        request.refused_pairs,
    )
    fault = scale_fault(rig) if rig is not None else None
    return LiveSolution(rig, advise(situation), fault, trouble, len({view.frameset for view in request.views}))


def thinned(views: Sequence[View], most: int = _LIVE_FRAMESETS) -> tuple[View, ...]:
    """The Views of at most `most` framesets, spread evenly, those that many cameras share first."""
    cameras: dict[int, set[str]] = {}
    times: dict[int, float] = {}
    for view in views:
        cameras.setdefault(view.frameset, set()).add(view.camera)
        times.setdefault(view.frameset, view.time)
    if len(cameras) <= most:
        return tuple(views)
    shared = {frameset: times[frameset] for frameset, names in cameras.items() if len(names) > 1}
    alone = {frameset: times[frameset] for frameset, names in cameras.items() if len(names) == 1}
    kept = set(_spread(shared, most) + _spread(alone, max(most - len(shared), most // 4)))
    return tuple(view for view in views if view.frameset in kept)


def _spread(framesets: Mapping[int, float], most: int) -> list[int]:
    """Framesets (with their times, s) spread evenly, in runs that follow on one another: single ones show no motion,
    and without motion no clock is known."""
    if len(framesets) <= most:
        return list(framesets)
    runs: list[list[int]] = []
    for frameset, time in framesets.items():
        if runs and len(runs[-1]) < _RUN and time - framesets[runs[-1][-1]] < LONGEST_GAP:
            runs[-1].append(frameset)
        else:
            runs.append([frameset])
    count = most * len(runs) // len(framesets)
    return [frameset for k in range(count) for frameset in runs[k * len(runs) // count]][:most]


class LiveSolver:
    """Solves one job at a time in a process of its own, which is started again where it was killed."""

    def __init__(self) -> None:
        # Matrices of some tens of rows gain nothing from more threads, and the search would lose its own.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        self._running: Future[LiveSolution] | None = None
        self._start()

    @property
    def idle(self) -> bool:
        """Whether a job would be begun at once."""
        return self._running is None

    def begin(self, request: SolveRequest) -> None:
        """Begin a solution; `idle` must be true."""
        try:
            self._running = self._pool.submit(solve, request)
        except BrokenProcessPool:
            self._start()
            self._running = self._pool.submit(solve, request)

    def take(self, wait: bool = False) -> LiveSolution | None:
        """The solution of the job that was begun, once it is there; where `wait`, when it is there.

        None where its process was killed: the next job brings what this one would have.
        """
        if self._running is None or not (wait or self._running.done()):
            return None
        running, self._running = self._running, None
        try:
            return running.result()
        except BrokenProcessPool:
            return None

    def close(self) -> None:
        """End the process, also in the middle of a job: at exit Python would wait for it."""
        end_processes(self._processes)
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _start(self) -> None:
        # A fresh process: capture threads and video decoders do not survive a fork.
        context, before = multiprocessing.get_context("spawn"), set(multiprocessing.active_children())
        self._pool = ProcessPoolExecutor(1, mp_context=context, initializer=_stand_back)
        self._pool.submit(_warm_up)
        self._processes = set(multiprocessing.active_children()) - before


def _stand_back() -> None:
    """Leave interrupts to the session, and the processor to the search."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if os.nice(0) < 5:
        os.nice(5)
    leave_with_parent()


def _warm_up() -> None:
    """Import what the first solution would import, while the person takes up the sheet."""
    import networkx  # noqa: F401 - the import is all that is wanted
    import scipy.linalg
    import scipy.sparse.csgraph  # noqa: F401 - as above
