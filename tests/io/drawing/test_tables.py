"""Tables fit any width: nothing in them is cut or lost, and a name cannot break them."""

import pytest

from quadrig.io.drawing.tables import html_table, markdown_table, text_table
from quadrig.rig.words import Column

COLUMNS = [
    Column("camera", "", ("left", "right\x1b\nhand", "東京"), words=True),
    Column("focal", "px", ("1234.56 ± 0.12", "99.0 ± 1.5", "7 ± unknown")),
    Column("position", "m", ("-1.4167 0.1613 10.6465", "rig frame", "0.0000 0.0000 0.0001")),
    Column("position", "± mm", ("0.75", "", "12")),
    Column("lens", "", ("all", "f c k1", "none"), words=True),
]


@pytest.mark.parametrize("width", [24, 40, 60, 80, 200])
def test_nothing_is_cut_or_lost_at_any_width(width):
    blocks = text_table(COLUMNS, width)
    text = "\n".join(line for block in blocks for line in block)
    for column in COLUMNS[1:]:
        for word in (column.name, *column.cells):
            assert word in text
    assert "right\\u001b hand" in text
    if width > 24:
        # Letters of East Asia are two columns wide.
        assert all(
            len(line) + sum(letter in "東京" for letter in line) <= width for block in blocks for line in block
        )


def test_every_block_names_its_rows_in_order():
    blocks = text_table(COLUMNS, 40)
    assert len(blocks) > 1
    for block in blocks:
        assert block[0].startswith("camera")
        assert [line.split()[0] for line in block[2:]] == ["left", "right\\u001b", "東京"]
    assert len(text_table(COLUMNS, 200)) == 1


def test_long_names_stand_above_their_rows():
    long = [
        Column("camera", "", ("x" * 70, "y"), words=True),
        *(Column(c.name, c.unit, c.cells[:2]) for c in COLUMNS[1:]),
    ]
    for block in text_table(long, 60):
        assert [line for line in block if line in ("x" * 70, "y")] == ["x" * 70, "y"]
        assert all(len(line) <= 60 for line in block if line[0] != "x")


def test_names_are_neither_markdown_nor_markup():
    odd = [Column("camera", "", ("a|b\n\tc", "<b>"), words=True), Column("Views", "", ("1", "2"))]
    assert markdown_table(odd)[2:] == ["| a\\|b c | 1 |", "| <b> | 2 |"]
    assert "<b>" not in html_table(odd)
    assert "&lt;b&gt;" in html_table(odd)
