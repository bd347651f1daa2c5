"""Derivatives by twists: what a small screw motion of one pose does to a pose that it is a factor of."""

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose
from quadrig.single.rotation import cross_matrix


def step_by_left_twist(pose: Pose) -> Floats:
    """Derivative (..., 6, 6) of the step of exp(twist) @ pose by the twist."""
    result = np.zeros((*pose.translation.shape[:-1], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = np.eye(3)
    result[..., 3:, :3] = -cross_matrix(pose.translation)
    return result


def step_by_inner_twist(rotation: Floats, position: Floats) -> Floats:
    """Derivative (..., 6, 6) of the step of a_from_b @ exp(twist) @ b_from_c by the twist.

    rotation (..., 3, 3): of a_from_b. position (..., 3): of b_from_c.
    """
    result = np.zeros((*position.shape[:-1], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = rotation
    result[..., 3:, :3] = -rotation @ cross_matrix(position)
    return result


def step_by_camera_twist(rig_from_camera: Pose) -> Floats:
    """Derivative (..., 6, 6) of the step of rig_from_camera by the twist of camera_from_rig @ exp(twist)."""
    return -step_by_left_twist(rig_from_camera)
