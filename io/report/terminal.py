"""Sentences and tables on stdout, for a terminal of any width, a file or a pipe."""

import re
import textwrap
from collections.abc import Sequence

from rich.console import Console

from quadrig.io.drawing.tables import text_table
from quadrig.io.plain_words import one_line
from quadrig.rig.words import Column

# Sentences that are broken into lines are harder to read in wide ones.
_WIDEST_SENTENCE = 110
_BEFORE_UNIT = re.compile(r"(?<=\d) (?=(?:mm|m|ms|s|px|%)(?!\w))")


def print_sentence(sentence: str, where: Console, mark: str = "", style: str | None = None) -> None:
    """A sentence, behind its mark: on a terminal broken between words, in a file or pipe one line."""
    sentence = one_line(sentence)
    lines = [mark + sentence]
    if where.is_terminal:
        width = min(where.width, _WIDEST_SENTENCE)
        # A figure keeps its unit, a path or name all its letters.
        bound = _BEFORE_UNIT.sub("\0", sentence)
        lines = textwrap.wrap(
            bound,
            width,
            initial_indent=mark,
            subsequent_indent=" " * len(mark),
            break_long_words=False,
            break_on_hyphens=False,
        )
        lines = [line.replace("\0", " ") for line in lines]
    where.print("\n".join(lines), style=style, markup=False, soft_wrap=True)


def print_table(
    columns: Sequence[Column], where: Console, title: str = "", styles: Sequence[str | None] | None = None
) -> None:
    """A table below an empty line and its title, in blocks that fit the width. styles: of its rows, on a terminal."""
    where.print(f"\n[bold]{title}[/]" if title else "")
    for number, block in enumerate(text_table(columns, where.width)):
        if number:
            where.print()
        body = len(block) - len(columns[0].cells) if styles else len(block)
        for index, line in enumerate(block):
            style = styles[index - body] if styles and index >= body else None
            where.print(line, style=style, markup=False, soft_wrap=True)
