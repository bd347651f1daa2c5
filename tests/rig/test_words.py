"""Figures as people say them."""

import pytest

from quadrig.rig.words import millimetres


@pytest.mark.parametrize(
    ("metres", "words"),
    [(0.00083, "0.83 mm"), (0.012, "12 mm"), (0.3, "30 cm"), (float("nan"), "an unknown accuracy")],
)
def test_lengths_as_people_say_them(metres, words):
    assert millimetres(metres) == words
