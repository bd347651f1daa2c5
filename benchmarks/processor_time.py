"""What a piece of work takes of the processors, its worker processes counted when they have ended."""

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

Result = TypeVar("Result")


@dataclass(frozen=True)
class Spent:
    """processor: seconds of user and system, of this process and its ended children; seconds: that passed."""

    processor: float
    seconds: float

    def __add__(self, other: "Spent") -> "Spent":
        """Both, one after the other."""
        return Spent(self.processor + other.processor, self.seconds + other.seconds)


def spent(work: Callable[[], Result]) -> tuple[Result, Spent]:
    """What the work returns, and what it took. Workers that it leaves running are not counted."""
    began, processor = time.perf_counter(), _processor()
    result = work()
    return result, Spent(_processor() - processor, time.perf_counter() - began)


def _processor() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)
