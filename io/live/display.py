"""The screens of a session, and how quickly moments come to them."""

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from quadrig.io.live.state import SetupState

# Frames of this long ago (s) count into the rate and the latency that are shown.
_RATE_SECONDS = 3.0


class Screen(Protocol):
    """Something that shows a session."""

    def show(self, state: SetupState) -> None:
        """Show one moment. Must not block."""
        ...

    def close(self) -> None:
        """Leave the screen as it should stay."""
        ...


class Display:
    """Hands each moment to every screen. latencies: s, of each frameset from its arrival until then."""

    def __init__(self, screens: Sequence[Screen]) -> None:
        self.latencies: list[float] = []
        self._screens = tuple(screens)
        self._shown: deque[tuple[float, float]] = deque()

    def show(self, state: SetupState) -> None:
        """Show one moment, with the rate and the latency of the latest."""
        state = replace(state, rate=self._rate(), latency=self._latency())
        for screen in self._screens:
            screen.show(state)
        if state.frames:
            self._count(min(frame.arrived for frame in state.frames.values()))

    def _count(self, arrived: float) -> None:
        now = time.monotonic()
        self.latencies.append(now - arrived)
        self._shown.append((now, now - arrived))
        while self._shown[0][0] < now - _RATE_SECONDS:
            self._shown.popleft()

    def _rate(self) -> float:
        if len(self._shown) < 2:
            return 0.0
        return (len(self._shown) - 1) / max(self._shown[-1][0] - self._shown[0][0], 1e-9)

    def _latency(self) -> float:
        return float(np.median([latency for _, latency in self._shown])) if self._shown else 0.0
