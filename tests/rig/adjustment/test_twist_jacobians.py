"""Steps of poses by twists: derivatives are those of differences."""

import numpy as np

from quadrig.rig.adjustment.twist_jacobians import step_by_camera_twist, step_by_inner_twist, step_by_left_twist
from quadrig.single.pose import Pose


def some(seed):
    rng = np.random.default_rng(seed)
    return Pose.from_vectors(rng.normal(size=3), rng.normal(size=3))


def slopes(step_of_twist):
    """Columns of d step_of_twist(twist) at zero, central differences good to their size squared."""
    return np.stack([(step_of_twist(1e-5 * e) - step_of_twist(-1e-5 * e)) / 2e-5 for e in np.eye(6)], axis=-1)


def test_a_twist_before_the_pose():
    pose = some(1)
    slope = slopes(lambda twist: pose.step_to(Pose.from_twist(twist) @ pose))
    np.testing.assert_allclose(step_by_left_twist(pose), slope, atol=1e-9)


def test_a_twist_within_a_chain():
    first, second = some(2), some(3)
    slope = slopes(lambda twist: (first @ second).step_to(first @ Pose.from_twist(twist) @ second))
    np.testing.assert_allclose(step_by_inner_twist(first.rotation, second.translation), slope, atol=1e-9)


def test_a_twist_of_a_camera():
    rig_from_camera = some(4)

    def step(twist):
        return rig_from_camera.step_to((rig_from_camera.inverse() @ Pose.from_twist(twist)).inverse())

    np.testing.assert_allclose(step_by_camera_twist(rig_from_camera), slopes(step), atol=1e-9)
