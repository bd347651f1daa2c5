"""What a command says beside its result, on stderr: notes, unless -q; how it goes about its work, with -v."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum

from quadrig.io.plain_words import one_line, plain


class Verbosity(IntEnum):
    """How much is said: errors alone, notes and progress too, and in detail."""

    QUIET = 0
    USUAL = 1
    VERBOSE = 2


_chosen = [Verbosity.USUAL]


def choose_verbosity(chosen: Verbosity) -> None:
    """From here on, in this process."""
    _chosen[0] = chosen


def is_quiet() -> bool:
    """Whether nothing is to be said beside results and errors."""
    return _chosen[0] == Verbosity.QUIET


def say(sentence: str) -> None:
    """Unless quiet."""
    if not is_quiet():
        print(plain(sentence), file=sys.stderr, flush=True)


def note(sentence: str) -> None:
    """What a person should know of the result, unless quiet."""
    say(f"note: {one_line(sentence)}")


def detail(sentence: str) -> None:
    """What a person wants to know who asks how the work is done."""
    if _chosen[0] == Verbosity.VERBOSE:
        say(sentence)


@contextmanager
def timed(what: str) -> Iterator[None]:
    """Says, as a detail, how long the block took."""
    began = time.monotonic()
    yield
    detail(f"{what}: {time.monotonic() - began:.1f} s")
