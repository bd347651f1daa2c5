"""Notes are said unless quiet, details only where asked for."""

import pytest

from quadrig.io.progress import progress_bar
from quadrig.io.verbosity import Verbosity, choose_verbosity, detail, note, say, timed


@pytest.fixture(autouse=True)
def usual():
    yield
    choose_verbosity(Verbosity.USUAL)


@pytest.mark.parametrize(
    ("chosen", "lines"),
    [(Verbosity.QUIET, 0), (Verbosity.USUAL, 2), (Verbosity.VERBOSE, 5)],
)
def test_what_is_said(chosen, lines, capsys):
    choose_verbosity(chosen)
    say("done")
    note("one picture is damaged")
    detail("with two workers")
    with timed("solving"):
        pass
    with progress_bar("search", 3) as advance:
        advance(3)
    said = capsys.readouterr()
    assert said.out == ""
    assert len(said.err.splitlines()) == lines
