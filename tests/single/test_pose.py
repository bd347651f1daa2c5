"""Poses: chains cancel as they are read, steps come back, derivatives are those of differences."""

import numpy as np

from quadrig.single.pose import (
    Pose,
    compose_jacobians,
    inverse_jacobian,
    step_by_camera_twist,
    step_by_inner_twist,
    step_by_left_twist,
)


def some(count=None, seed=0):
    rng = np.random.default_rng(seed)
    shape = () if count is None else (count,)
    return Pose.from_vectors(rng.normal(size=(*shape, 3)), rng.normal(size=(*shape, 3)))


def differences(function, size=1e-6):
    """Columns of d function(step) by a step of six, as central differences (good to size^2 and 1e-16 / size)."""
    columns = [(function(size * e) - function(-size * e)) / (2 * size) for e in np.eye(6)]
    return np.stack(columns, axis=-1)


def close(a, b, atol=1e-14):
    np.testing.assert_allclose(a.rotation, b.rotation, atol=atol)
    np.testing.assert_allclose(a.translation, b.translation, atol=atol)


def test_a_chain_takes_points_as_its_links_do():
    a_from_b, b_from_c = some(7, 1), some(7, 2)
    points = np.random.default_rng(3).normal(size=(7, 3))
    chained = (a_from_b @ b_from_c).transform(points)
    np.testing.assert_allclose(chained, a_from_b.transform(b_from_c.transform(points)), atol=1e-14)


def test_a_pose_and_its_inverse_cancel_on_both_sides():
    pose, still = some(), Pose.identity()
    close(pose @ pose.inverse(), still)
    close(pose.inverse() @ pose, still)
    close(pose.inverse().inverse(), pose)


def test_chains_associate_and_batches_broadcast():
    a, b, c = some(4, 1), some(seed=2), some(4, 3)
    close((a @ b) @ c, a @ (b @ c))
    close((b @ a)[2], b @ a[2])


def test_the_matrix_is_the_same_pose():
    a, b = some(4, 1), some(4, 2)
    np.testing.assert_allclose((a @ b).matrix(), a.matrix() @ b.matrix(), atol=1e-14)
    close(Pose.from_matrix(a.matrix()), a)


def test_a_step_there_is_the_step_between():
    pose, other = some(5, 1), some(5, 2)
    close(pose.retract(pose.step_to(other)), other)
    step = 1e-3 * np.random.default_rng(5).normal(size=(5, 6))
    np.testing.assert_allclose(pose.step_to(pose.retract(step)), step, atol=1e-15)
    np.testing.assert_allclose(pose.step_to(pose), 0, atol=1e-15)


def test_the_inverse_moves_as_its_jacobian_says():
    pose = some()
    numeric = differences(lambda step: pose.inverse().step_to(pose.retract(step).inverse()))
    np.testing.assert_allclose(inverse_jacobian(pose), numeric, atol=1e-9)


def test_going_there_and_back_has_inverse_jacobians():
    pose = some(6)
    np.testing.assert_allclose(
        inverse_jacobian(pose.inverse()) @ inverse_jacobian(pose), np.broadcast_to(np.eye(6), (6, 6, 6)), atol=1e-13
    )


def test_a_chain_moves_with_its_links_as_the_jacobians_say():
    left, right = some(seed=1), some(seed=2)
    by_left, by_right = compose_jacobians(left, right)
    both = left @ right
    np.testing.assert_allclose(by_left, differences(lambda step: both.step_to(left.retract(step) @ right)), atol=1e-9)
    np.testing.assert_allclose(
        by_right, differences(lambda step: both.step_to(left @ right.retract(step))), atol=1e-9
    )


def test_a_twist_before_the_pose():
    pose = some(seed=1)
    slope = differences(lambda twist: pose.step_to(Pose.from_twist(twist) @ pose))
    np.testing.assert_allclose(step_by_left_twist(pose), slope, atol=1e-8)


def test_a_twist_within_a_chain():
    first, second = some(seed=2), some(seed=3)
    slope = differences(lambda twist: (first @ second).step_to(first @ Pose.from_twist(twist) @ second))
    np.testing.assert_allclose(step_by_inner_twist(first.rotation, second.translation), slope, atol=1e-8)


def test_a_twist_of_a_camera():
    rig_from_camera = some(seed=4)

    def step(twist):
        return rig_from_camera.step_to((rig_from_camera.inverse() @ Pose.from_twist(twist)).inverse())

    np.testing.assert_allclose(step_by_camera_twist(rig_from_camera), differences(step), atol=1e-9)
