"""What a session says to the person with the sheet: one sentence at a time."""

import time
from collections.abc import Sequence

from quadrig.io.live.capture.source import SourceState
from quadrig.rig.coach.advice import Advice, Situation, advise
from quadrig.rig.coach.conversation import Coach
from quadrig.rig.coach.fault import Fault
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View


class Coaching:
    """The advice of a session, from one proposal to the next."""

    def __init__(self, cameras: Sequence[str], rectangles: Sequence[Rectangle]) -> None:
        self._cameras, self._rectangles = tuple(cameras), tuple(rectangles)
        self._coach = Coach()
        self._shown: frozenset[str] = frozenset()

    @property
    def advice(self) -> Advice | None:
        """What is being said."""
        return self._coach.advice

    @property
    def refused(self) -> tuple[Pose, ...]:
        """Poses that could not be reached."""
        return self._coach.refused

    @property
    def refused_pairs(self) -> frozenset[frozenset[str]]:
        """Cameras to which nothing could be shown at once."""
        return self._coach.refused_pairs

    def see(self, views: Sequence[View]) -> None:
        """Take note of Views that were kept: their cameras were shown something new."""
        self._shown = self._shown | {view.camera for view in views}

    def hear(self, advice: Advice) -> None:
        """Take over a proposal where what is being said was followed, or cannot be."""
        self._coach = self._coach.hear(advice, self._shown, time.monotonic())
        self._shown = frozenset()

    def advise_without_rig(self, views: Sequence[View]) -> None:
        """Advice from what was kept alone, while no rig has all cameras: a solution would bring older news."""
        situation = Situation(self._cameras, self._rectangles, tuple(views), refused_pairs=self.refused_pairs)
        self.hear(advise(situation))


def sentence_of(states: Sequence[SourceState], fault: Fault | None, advice: Advice | None) -> tuple[str, bool]:
    """The one sentence, and whether it is a fault: a source that is gone or another, a fault, the advice."""
    gone = [state for state in states if state.condition in ("stalled", "lost", "failed")]
    if gone:
        names = ", ".join(state.name for state in gone)
        details = ", ".join(dict.fromkeys(state.detail for state in gone))
        again = "" if all(state.condition == "failed" for state in gone) else "; trying again"
        return f"no picture from {names}: {details}{again}", True
    changed = next((state for state in states if state.condition == "changed"), None)
    if changed is not None:
        return changed.sentence, True
    if fault is not None:
        return fault.sentence, True
    return advice.sentence if advice is not None else "", False
