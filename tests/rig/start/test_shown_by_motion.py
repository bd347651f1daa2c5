"""What a motion shows of cameras that see different parts of one body, each direction against its noise."""

import numpy as np
import pytest

from quadrig.rig.start.shown_by_motion import REAL, adjoint, shown_by_motion
from quadrig.single.pose import Pose, step_by_left_twist

SIGMAS = np.array([4e-4, 4e-4, 1e-4, 2e-4, 2e-4, 8e-4])
AXIS, POINT = np.array([0.36, 0.48, 0.8]), np.array([0.3, -0.2, 0.5])


def shown(turns, shifts, seed):
    """Of 80 poses of these rotation vectors and positions, seen from a frame that is tilted to them, with noise."""
    rng = np.random.default_rng(seed)
    true = Pose.from_vectors(turns, shifts) @ Pose.from_vectors(np.array([0.1, 0.2, 0.3]), np.array([0.1, 0, 1.2]))
    to_twist = np.linalg.inv(step_by_left_twist(true))
    covariance = to_twist * SIGMAS**2 @ np.swapaxes(to_twist, -1, -2)
    return shown_by_motion(true.retract(SIGMAS * rng.normal(size=(80, 6))), covariance)


def turns_about_the_axis(seed, sway=0.0):
    """All turn about a line through POINT, which itself sways by so much, m."""
    rng = np.random.default_rng([seed, 1])
    turned = Pose.from_vectors(0.3 * rng.normal(size=(80, 1)) * AXIS, np.zeros((80, 3)))
    shifts = POINT - turned.rotation @ POINT + sway * rng.normal(size=(80, 3))
    return shown(turned.rotation_vector(), shifts, seed)


@pytest.mark.parametrize("seed", range(5))
def test_turning_about_a_fixed_axis_leaves_open_the_turn_about_it_and_the_position_along_it(seed):
    found = turns_about_the_axis(seed)
    open_ones = np.linalg.qr(np.stack([np.r_[AXIS, np.cross(POINT, AXIS)], np.r_[0, 0, 0, AXIS]]).T)[0]
    assert found.open.shape == (6, 2)
    np.testing.assert_allclose(np.linalg.svd(found.open.T @ open_ones)[1], 1, atol=1e-3)
    assert (np.sort(found.share)[2:] > 0.9).all()


@pytest.mark.parametrize("seed", range(5))
def test_a_few_millimetres_of_sway_show_the_turn_but_not_the_position(seed):
    found = turns_about_the_axis(seed, sway=0.004)
    assert found.open.shape == (6, 1)
    np.testing.assert_allclose(np.abs(found.open[:, 0]), np.r_[0, 0, 0, AXIS], atol=0.01)


def test_turning_all_ways_shows_all_and_turning_not_at_all_no_position():
    rng = np.random.default_rng(0)
    shifts = 0.1 * rng.normal(size=(80, 3))
    assert shown(0.2 * rng.normal(size=(80, 3)), shifts, 0).share.min() > 0.99
    still = shown(np.zeros((80, 3)), shifts, 0)
    assert (still.share <= REAL).sum() == 3
    np.testing.assert_allclose(still.open[:3], 0, atol=1e-12)


def test_the_shares_are_those_of_any_frame():
    found, b_from_a = turns_about_the_axis(0), Pose.from_vectors(np.array([1.0, 2, 0.5]), np.array([3.0, -1, 2]))
    moved = found.moved(b_from_a)
    np.testing.assert_allclose(moved.duals @ adjoint(b_from_a) @ found.twists, np.eye(6), atol=1e-8)
