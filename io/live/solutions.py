"""When a session solves: one solution after the other, with rests, until they are as accurate as asked."""

import time
from collections.abc import Callable

from quadrig.io.live.plan import SetupPlan
from quadrig.io.live.solver import LiveSolution, LiveSolver, SolveRequest
from quadrig.rig.doubt.lens_accuracy import accuracy
from quadrig.rig.result import Rig

# Solutions alternate with rests of the same length, so that the search keeps its share of the processor.
_REST = 1.0
# Solutions in a row, each with new framesets, that must be as accurate as asked. The truth is as near after the first
# as after the second (benchmarks/stopping.py), but two or three framesets cover a corner of the room, in which a rig
# is soon good that is not where the sheet goes next.
_CONFIRMED = 2


class LiveSolutions:
    """The solutions of a session, one at a time. rig: of the newest, None where there is none yet."""

    def __init__(self, solver: LiveSolver, plan: SetupPlan) -> None:
        self.rig: Rig | None = None
        self._solver, self._plan = solver, plan
        # Files that are played until an accuracy is reached stop at the same frameset on every run.
        self._waits = plan.waits and plan.until is not None
        self._begun = self._rest_until = 0.0
        self._framesets = self._accurate = 0

    @property
    def complete(self) -> bool:
        """Whether the newest rig has all cameras."""
        return self.rig is not None and len(self.rig.cameras) == len(self._plan.cameras)

    @property
    def reached(self) -> bool:
        """Whether the accuracy that was asked for is reached, by all cameras."""
        return self._accurate >= _CONFIRMED

    def take(self) -> LiveSolution | None:
        """The solution that was begun, once it is there."""
        solution = self._solver.take(wait=self._waits)
        if solution is None:
            return None
        now = time.monotonic()
        self._rest_until = now if self._waits else now + _REST * (now - self._begun)
        self.rig = solution.rig
        self._accurate = self._accurate + 1 if self._is_accurate() else 0
        return solution

    def begin(self, framesets: int, request: Callable[[], SolveRequest]) -> None:
        """Begin the next one where it is time for it, and more framesets were kept than the last one had."""
        if framesets > self._framesets and self._solver.idle and time.monotonic() >= self._rest_until:
            self._begun, self._framesets = time.monotonic(), framesets
            self._solver.begin(request())

    def _is_accurate(self) -> bool:
        until = self._plan.until
        return until is not None and self.rig is not None and self.complete and accuracy(self.rig) <= until
