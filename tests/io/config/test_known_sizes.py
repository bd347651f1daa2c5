"""Known sizes hold together: papers by halving, courts by what their own marks add up to."""

import numpy as np
import pytest

from quadrig.io.config.known_sizes import KNOWN_SIZES, known_size
from quadrig.single.errors import QuadrigError


def test_a_paper_is_half_of_the_next_larger():
    for number in range(6):
        larger, smaller = known_size(f"A{number}"), known_size(f"A{number + 1}")
        assert smaller.width == larger.height
        # ISO 216 rounds down to whole millimetres.
        assert 0 <= larger.width / 2 - smaller.height < 0.001
        assert larger.width * larger.height == pytest.approx(0.5**number, rel=0.01)


def test_courts_agree_with_their_own_marks():
    # ITF CS 04/02: full-court diagonal 26.184, service lines 12.802 apart, sidelines to singles sidelines 1.372.
    court, singles = known_size("tennis court"), known_size("tennis singles court")
    assert np.hypot(court.width, court.height) == pytest.approx(26.184, abs=0.01)
    assert (court.height - singles.height) / 2 == pytest.approx(1.372, abs=0.003)
    box, area = known_size("tennis service box"), known_size("tennis service area")
    assert (2 * box.width, 2 * box.height) == (area.width, area.height)
    goal = known_size("football goal")
    for name in ("football penalty area", "football goal area"):
        assert known_size(name).height == pytest.approx(goal.width + 2 * known_size(name).width)
    front, back = known_size("badminton front area"), known_size("badminton doubles service area")
    # Two service courts of 3.96 m and the front area between them.
    assert back.width == pytest.approx(front.width + 2 * 3.96)
    assert known_size("padel service area").width == pytest.approx(2 * 6.95)


def test_each_says_its_edge_and_its_source():
    for known in KNOWN_SIZES.values():
        assert known.width > 0
        assert known.height > 0
        assert known.edge
        assert known.source


def test_names_are_read_in_any_letters_and_papers_stand_upright():
    assert known_size("  TENNIS  court") == known_size("tennis court")
    lying, upright = known_size("A4"), known_size("a4 upright")
    assert (upright.width, upright.height) == (lying.height, lying.width)
    with pytest.raises(QuadrigError, match=r"'squash court'.*tennis court.*width and height"):
        known_size("squash court")
