"""The rate and the latency that screens show."""

import time

import pytest

from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.display import Display
from quadrig.io.live.state import SetupState


class Seen:
    """A screen that keeps what it was shown."""

    def __init__(self) -> None:
        self.states: list[SetupState] = []

    def show(self, state: SetupState) -> None:
        self.states.append(state)

    def close(self) -> None:
        pass


def test_every_screen_is_shown_each_moment_with_the_latency_of_those_before():
    screens = [Seen(), Seen()]
    display = Display(screens)
    for _ in range(3):
        frames = {name: Frame(name, 0, time.monotonic() - late) for name, late in (("a", 0.2), ("b", 0.1))}
        display.show(SetupState("one", frames=frames))
    display.show(SetupState("nothing came"))
    for screen in screens:
        assert [state.sentence for state in screen.states] == ["one", "one", "one", "nothing came"]
        assert screen.states[0].latency == 0
        # A frameset is as old as its oldest frame.
        assert screen.states[-1].latency == pytest.approx(0.2, abs=0.05)
        assert screen.states[-1].rate > 0
    assert len(display.latencies) == 3
