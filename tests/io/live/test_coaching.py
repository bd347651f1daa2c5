"""What a session says, of all that could be said."""

import pytest

from quadrig.io.live.capture.source import SourceState
from quadrig.io.live.coaching import Coaching, sentence_of
from quadrig.rig.coach.advice import Advice
from quadrig.rig.coach.fault import Fault

ADVICE = Advice("connect", "hold the sheet where a and b both see it", ("a", "b"))
BLUR = Fault("blur", "a: the picture is out of focus", "a")


@pytest.mark.parametrize(
    ("conditions", "fault", "sentence"),
    [
        (("running", "running"), None, ADVICE.sentence),
        (("running", "ended"), BLUR, BLUR.sentence),
        (("stalled", "running"), BLUR, "no picture from a: gone; trying again"),
        (("changed", "running"), BLUR, "a gone"),
        (("changed", "lost"), BLUR, "no picture from b: gone; trying again"),
        (("failed", "failed"), None, "no picture from a, b: gone"),
        (("failed", "lost"), None, "no picture from a, b: gone; trying again"),
    ],
)
def test_a_source_that_is_gone_comes_before_a_fault_and_a_fault_before_advice(conditions, fault, sentence):
    states = [SourceState(name, condition, "gone") for name, condition in zip("ab", conditions, strict=True)]
    assert sentence_of(states, fault, ADVICE) == (sentence, sentence != ADVICE.sentence)


def test_advice_without_a_rig_names_the_cameras_that_share_nothing(room):
    coaching = Coaching(("a", "b"), [room.TAG])
    assert coaching.advice is None
    coaching.advise_without_rig([])
    assert coaching.advice is not None
    assert coaching.advice.sentence == ADVICE.sentence
