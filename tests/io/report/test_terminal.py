"""What is printed: broken between words on a terminal, whole in a pipe, coloured on a terminal alone."""

import io

import pytest
from rich.console import Console

from quadrig.io.report.terminal import print_sentence, print_table
from quadrig.rig.words import Column

SENTENCE = "clocks disagree by 123 ms: look at /a/very/long/path/that/nobody/should/break/in/two.mcap or cam-0 " * 2


def printed(width: int, what, *, terminal: bool) -> str:
    out = io.StringIO()
    what(Console(file=out, width=width, force_terminal=terminal, highlight=False))
    return out.getvalue()


@pytest.mark.parametrize("width", [60, 80])
def test_sentences_are_broken_between_words_on_a_terminal(width):
    lines = printed(width, lambda where: print_sentence(SENTENCE.strip(), where, "- "), terminal=True).splitlines()
    assert len(lines) > 2
    assert all(len(line) <= width for line in lines)
    assert [line[:2] for line in lines] == ["- ", *["  "] * (len(lines) - 1)]
    assert " ".join(line[2:] for line in lines) == SENTENCE.strip()
    assert not any(line.endswith("123") for line in lines)


def test_a_pipe_has_each_sentence_in_one_line():
    assert printed(60, lambda where: print_sentence(SENTENCE, where), terminal=False) == SENTENCE + "\n"


@pytest.mark.parametrize("terminal", [False, True])
def test_colour_is_for_terminals_alone(terminal):
    columns = [Column("camera", "", ("[red]a", "b"), words=True), Column("focal", "px", ("1", "2"))]
    text = printed(60, lambda where: print_table(columns, where, "title", ["bold red", None]), terminal=terminal)
    assert ("\x1b[" in text) == terminal
    assert "[red]a" in text
