"""Figures as people say them."""

import pytest

from quadrig.rig.words import length, read_length
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


def test_a_bare_number_is_in_the_unit_that_is_asked_for():
    assert [read_length(text, "mm") for text in ("80", "80 mm", "8cm")] == pytest.approx([0.08] * 3)


@pytest.mark.parametrize("text", ["", "mm", "1 foot", "-1mm", "0mm", "1.2.3mm"])
def test_what_is_no_length(text):
    with pytest.raises(QuadrigError, match="is no length"):
        read_length(text)
