"""The damping of Levenberg and Marquardt's method, which all loops share."""

import numpy as np
import pytest

from quadrig.single.damping import UNSOLVABLE, Damping, gain


@pytest.mark.parametrize(
    ("before", "after", "promised", "expected"),
    [(10.0, 8.0, 4.0, 0.5), (10.0, 12.0, 4.0, -0.5), (10.0, 8.0, 0.0, -1.0), (10.0, 8.0, -1.0, -1.0)],
)
def test_gain_is_the_share_of_the_promise_that_came(before, after, promised, expected):
    assert gain(before, after, promised) == expected


def test_a_cost_that_is_no_number_is_no_gain():
    assert not gain(10.0, np.nan, 1.0) > 0
    assert Damping.of(1.0).after(gain(10.0, np.nan, 1.0)).value > 1


def test_each_member_of_a_batch_has_its_own():
    gains = np.array([1.0, 0.5, 0.1, -0.1])
    found = Damping.of(np.ones(4)).after(gains)
    np.testing.assert_allclose(found.value, [0.1, 1.0, 10.0, 10.0])
    np.testing.assert_array_equal(found.raised, [False, False, True, True])


def test_what_was_too_little_is_not_tried_again_at_once():
    raised = Damping.of(1e-9).after(UNSOLVABLE)
    assert raised.value == pytest.approx(1e-5)
    kept = raised.after(np.array(1.0))
    assert kept.value == raised.value
    assert kept.after(np.array(1.0)).value == pytest.approx(1e-6)
