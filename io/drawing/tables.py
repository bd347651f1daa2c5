"""Tables as text for any width, as Markdown and as HTML: the same columns in the same order everywhere."""

import unicodedata
from collections.abc import Sequence
from html import escape

from quadrig.io.plain_words import one_line
from quadrig.rig.words import Column

_GAP = "  "
# A first column wider than this share of the width leaves too little for the others: it has lines of its own.
_LARGE_SHARE = 0.4
_FITS_PHONE = 3


def text_table(columns: Sequence[Column], width: int) -> list[list[str]]:
    """Blocks of lines, each no wider than `width` where one cell is not: the first line or two are the heading.

    The first column names the rows and begins every block; columns that find no room begin the next one. No cell is
    cut, and no heading lost.
    """
    names, *rest = columns
    label = _lines(names)
    room = max(map(_wide, label))
    if room > _LARGE_SHARE * width:
        return [_under_names(label, block) for block in _blocks(rest, width - len(_GAP))]
    blocks = _blocks(rest, width - room - len(_GAP))
    return [_joined([label, *map(_lines, block)], [names, *block]) for block in blocks]


def markdown_table(columns: Sequence[Column]) -> list[str]:
    """Lines of a Markdown table."""
    heads = [_escaped(column.heading) for column in columns]
    rules = ["---" if column.words else "--:" for column in columns]
    rows = zip(*([_escaped(_cell(cell)) for cell in column.cells] for column in columns), strict=True)
    return [f"| {' | '.join(row)} |" for row in (heads, rules, *rows)]


def html_table(columns: Sequence[Column], marks: Sequence[str] = ()) -> str:
    """A table; marks: HTML before the first cell of each row. Each cell carries its heading, for pages too narrow for
    columns."""
    heads = "".join(f"<th{_class(c)}>{escape(c.name)}<br><small>{escape(c.unit)}</small></th>" for c in columns)
    rows = []
    for index in range(len(columns[0].cells)):
        cells = [
            f'<td{_class(c)} data-label="{escape(c.heading)}">{escape(_cell(c.cells[index]))}</td>' for c in columns
        ]
        if marks:
            cells[0] = cells[0].replace(">", f">{marks[index]} ", 1)
        rows.append(f"<tr>{''.join(cells)}</tr>")
    # On a phone few columns fit; of more, each row stands by itself.
    rows_apart = ' class="rows"' if len(columns) > _FITS_PHONE else ""
    return f"<table{rows_apart}><thead><tr>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def _class(column: Column) -> str:
    return ' class="words"' if column.words else ""


def _cell(words: str) -> str:
    return one_line(words).replace("\t", " ")


def _escaped(cell: str) -> str:
    return cell.replace("|", "\\|")


def _lines(column: Column) -> list[str]:
    """Name and unit above each other, then the cells, as wide as the widest."""
    words = [column.name, column.unit, *map(_cell, column.cells)]
    width = max(map(_wide, words))
    spaces = [" " * (width - _wide(word)) for word in words]
    return [w + space if column.words else space + w for w, space in zip(words, spaces, strict=True)]


def _blocks(columns: Sequence[Column], width: int) -> list[list[Column]]:
    """Columns in as many groups as the width asks for."""
    blocks: list[list[Column]] = []
    used = 0
    for column in columns:
        wide = _wide(_lines(column)[0])
        if not blocks or used + len(_GAP) + wide > width:
            blocks.append([])
            used = -len(_GAP)
        blocks[-1].append(column)
        used += len(_GAP) + wide
    return blocks or [[]]


def _joined(cells: Sequence[Sequence[str]], columns: Sequence[Column]) -> list[str]:
    lines = [_GAP.join(row).rstrip() for row in zip(*cells, strict=True)]
    # Where no column has a unit, one line is the whole heading.
    return lines if any(column.unit for column in columns) else [lines[0], *lines[2:]]


def _under_names(label: Sequence[str], block: Sequence[Column]) -> list[str]:
    """Each row below its name, which has a line of its own."""
    head = 2 if any(column.unit for column in block) else 1
    lines = [_GAP + line for line in _joined([_lines(column) for column in block], block)]
    named = [line for name, row in zip(label[2:], lines[head:], strict=True) for line in (name.rstrip(), row)]
    return [*lines[:head], *named]


def _wide(word: str) -> int:
    """Columns of a terminal: letters of East Asia take two, marks upon others none."""
    return sum(
        0 if unicodedata.combining(letter) else 2 if unicodedata.east_asian_width(letter) in "WF" else 1
        for letter in word
    )
