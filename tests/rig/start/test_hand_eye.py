"""Two motions of one body, seen by cameras that never see the same of it."""

import numpy as np
import pytest

from quadrig.rig.start.hand_eye import REAL, Moving, hand_eye
from quadrig.single.pose import Pose

X = Pose.from_vectors(np.array([0.1, 3.0, -0.2]), np.array([0.02, -0.1, 0.3]))
Y = Pose.from_vectors(np.array([-0.3, 0.2, 1.5]), np.array([0.4, 0.9, -2.0]))
TURN, SHIFT = 3e-4, 5e-4


def motions(axes, framesets=80, seed=0):
    """Poses of two parts of a body, with noise; axes: how far it turns about each, rad."""
    rng = np.random.default_rng(seed)
    turns = rng.normal(size=(framesets, 3)) * axes
    shift = (
        rng.normal(size=(framesets, 3))
        * [0.3, 0.2, 0.3]
        * (np.array(axes) == 0 if np.count_nonzero(axes) == 1 else 1)
    )
    other = Pose.from_vectors(turns, shift) @ Pose.from_vectors(np.array([0.2, 0.4, 0.1]), np.array([0.0, 0.1, 1.5]))
    one = X @ other @ Y
    sigmas = np.full(framesets, TURN * np.sqrt(3)), np.full(framesets, SHIFT * np.sqrt(3))

    def noisy(pose):
        step = np.concatenate(
            [TURN * rng.normal(size=(framesets, 3)), SHIFT * rng.normal(size=(framesets, 3))], axis=1
        )
        return Moving(pose.retract(step), *sigmas)

    return noisy(one), noisy(other)


def test_both_poses_are_found_to_the_noise():
    found = hand_eye(*motions([0.3, 0.3, 0.3]))
    assert found is not None
    step = X.step_to(found.one_from_other)
    assert np.linalg.norm(step[:3]) < 5 * TURN / 0.3
    assert np.linalg.norm(step[3:]) < 5 * SHIFT / 0.3
    # The other pose carries the lever of 2 m.
    assert np.linalg.norm(Y.step_to(found.part_from_part)[3:]) < 20 * SHIFT / 0.3
    assert found.share > 0.99
    assert found.support > 0.9 * found.voters


def test_poses_of_twins_do_not_lead_astray():
    one, other = motions([0.3, 0.3, 0.3])
    rng = np.random.default_rng(1)
    wrong = rng.choice(80, 16, replace=False)
    step = np.zeros((80, 6))
    step[wrong, :3] = 0.7 * rng.normal(size=(16, 3))
    found = hand_eye(Moving(one.pose.retract(step), one.rotation, one.translation), other)
    assert found is not None
    assert np.linalg.norm(X.step_to(found.one_from_other)[3:]) < 5 * SHIFT / 0.3
    assert found.support <= 64


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_turning_about_one_axis_leaves_open_where_along_it_the_cameras_stand(axis):
    axes = np.zeros(3)
    axes[axis] = 0.4
    found = hand_eye(*motions(axes))
    assert found is not None
    assert found.share < REAL
    # The axis as the one sees it; across it the position is found all the same.
    seen = X.rotation[:, axis]
    assert abs(found.axis @ seen) > 0.9999
    off = found.one_from_other.translation - X.translation
    assert np.linalg.norm(off - (off @ seen) * seen) < 0.01
    assert np.linalg.norm(X.step_to(found.one_from_other)[:3]) < 0.02
    assert abs(found.axis @ found.one_from_other.translation) < 1e-3


def test_without_turning_nothing_is_said():
    assert hand_eye(*motions([0.0, 0.0, 0.0])) is None


def test_motions_that_have_nothing_to_do_with_each_other_tie_nothing():
    one, _ = motions([0.3, 0.3, 0.3])
    _, other = motions([0.3, 0.3, 0.3], seed=5)
    assert hand_eye(one, other) is None
