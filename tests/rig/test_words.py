"""Figures as people say them."""

import pytest

from quadrig.rig.words import length, read_coordinate, read_length
from quadrig.single.errors import QuadrigError


@pytest.mark.parametrize(
    ("metres", "words"),
    [(0.00083, "0.83 mm"), (0.0123, "12.3 mm"), (-0.0123, "-12.3 mm"), (0.3, "0.30 m"), (float("nan"), "unknown")],
)
def test_lengths_as_people_say_them(metres, words):
    assert length(metres) == words


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("1mm", 0.001),
        ("0.5 cm", 0.005),
        ("0.002", 0.002),
        ("2m", 2.0),
        (".08m", 0.08),
        ("3in", 0.0762),
        ("1e-3", 0.001),
    ],
)
def test_lengths_as_people_type_them(text, metres):
    assert read_length(text) == pytest.approx(metres)


def test_a_bare_number_is_metres_where_as_millimetres_it_would_be_absurd():
    assert read_length("0.08") == read_length("80 mm") == read_length("8cm") == 0.08
    assert read_length("0.005", bare_below=0.01) == 0.005
    for text, below in (("80", 1.0), ("1", 1.0), ("0.5", 0.01), ("1.5", 0.0)):
        with pytest.raises(QuadrigError, match=f"no unit: give {text}mm or {text}m"):
            read_length(text, below)


def test_a_coordinate_may_be_zero_or_below():
    assert [read_coordinate(text) for text in ("0", "-0.2", "-80mm", "+1m")] == [0.0, -0.2, -0.08, 1.0]


@pytest.mark.parametrize("text", ["", "mm", "1 foot", "-1mm", "0mm", "1.2.3mm"])
def test_what_is_no_length(text):
    with pytest.raises(QuadrigError, match="is no length"):
        read_length(text)
