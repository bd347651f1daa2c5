"""Rigid transforms. Every one is named a_from_b: it takes coordinates in frame b to coordinates in frame a."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.single.rotation import (
    Floats,
    cross_matrix,
    quaternion_from_rotation,
    rotation_from_vector,
    vector_from_rotation,
)

# Below this squared angle (rad^2) two terms of the series are exact to the last bit, and the closed form is not.
_SMALL_TWIST = 1e-8
# Columns of a rotation that was written with four digits are as far from perpendicular unit ones.
_ROUNDED = 1e-3


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid transform a_from_b, or a batch of them: x_a = rotation @ x_b + translation.

    rotation (..., 3, 3), translation (..., 3) in metres. `a_from_b @ b_from_c` is a_from_c, for single poses and
    for batches that broadcast.
    """

    rotation: Floats
    translation: Floats

    @staticmethod
    def identity() -> "Pose":
        """The pose that changes nothing."""
        return Pose(np.eye(3), np.zeros(3))

    @staticmethod
    def from_vectors(rotation_vector: Floats, translation: Floats) -> "Pose":
        """Pose of a rotation vector (radians) and a translation, each (..., 3)."""
        return Pose(rotation_from_vector(rotation_vector), np.asarray(translation, float))

    @staticmethod
    def from_twist(twist: Floats) -> "Pose":
        """Exponential of a twist (..., 6) = (rotation vector, velocity): the screw motion it leads to."""
        twist = np.asarray(twist, float)
        vector, velocity = twist[..., :3], twist[..., 3:]
        square = (vector * vector).sum(axis=-1)[..., None, None]
        small = square < _SMALL_TWIST
        angle = np.sqrt(np.where(small, 1.0, square))
        ratio = np.where(small, 1 - square / 6, np.sin(angle) / angle)
        versine = np.where(small, 0.5 - square / 24, (1 - np.cos(angle)) / (angle * angle))
        rest = np.where(small, 1 / 6 - square / 120, (1 - ratio) / (angle * angle))
        cross = cross_matrix(vector)
        twice = cross @ cross
        along = np.eye(3) + versine * cross + rest * twice
        return Pose(np.eye(3) + ratio * cross + versine * twice, (along @ velocity[..., None])[..., 0])

    @staticmethod
    def from_matrix(matrix: Floats) -> "Pose":
        """Pose of a homogeneous matrix (..., 4, 4) whose last row is 0 0 0 1."""
        matrix = np.asarray(matrix, float)
        return Pose(matrix[..., :3, :3], matrix[..., :3, 3])

    def matrix(self) -> Floats:
        """Homogeneous matrix (..., 4, 4)."""
        result = np.zeros((*self.translation.shape[:-1], 4, 4))
        result[..., :3, :3] = self.rotation
        result[..., :3, 3] = self.translation
        result[..., 3, 3] = 1
        return result

    @property
    def is_rigid(self) -> bool:
        """Whether every number is finite and every rotation one: nothing is mirrored, enlarged or sheared."""
        if not (np.isfinite(self.rotation).all() and np.isfinite(self.translation).all()):
            return False
        off = np.swapaxes(self.rotation, -1, -2) @ self.rotation - np.eye(3)
        return bool((np.abs(off) < _ROUNDED).all() and (np.linalg.det(self.rotation) > 0).all())

    def quaternion(self) -> Floats:
        """Unit quaternion (..., 4) in the order (x, y, z, w), w >= 0."""
        return quaternion_from_rotation(self.rotation)

    def rotation_vector(self) -> Floats:
        """Rotation vector (..., 3) in radians."""
        return vector_from_rotation(self.rotation)

    def __matmul__(self, other: "Pose") -> "Pose":
        return Pose(self.rotation @ other.rotation, self.transform(other.translation))

    def __getitem__(self, index) -> "Pose":
        """The poses of a batch at an index of its leading axes."""
        return Pose(self.rotation[index], self.translation[index])

    def inverse(self) -> "Pose":
        """b_from_a of a_from_b."""
        transposed = np.swapaxes(self.rotation, -1, -2)
        return Pose(transposed, -(transposed @ self.translation[..., None])[..., 0])

    def transform(self, points: Floats) -> Floats:
        """Points (..., 3) in frame b to frame a; the leading axes broadcast against the pose's own."""
        return (self.rotation @ np.asarray(points, float)[..., None])[..., 0] + self.translation

    def retract(self, step: Floats) -> "Pose":
        """The pose after a small step (..., 6) = (rotation vector, translation), both in frame a.

        rotation <- exp(step[:3]) rotation, translation <- translation + step[3:]. Every pose covariance of
        quadrig is the 6x6 covariance of this step.
        """
        step = np.asarray(step, float)
        return Pose(rotation_from_vector(step[..., :3]) @ self.rotation, self.translation + step[..., 3:])

    def step_to(self, other: "Pose") -> Floats:
        """The step (..., 6) with self.retract(step) equal to other."""
        rotation = other.rotation @ np.swapaxes(self.rotation, -1, -2)
        return np.concatenate([vector_from_rotation(rotation), other.translation - self.translation], axis=-1)


def stacked(poses: Sequence[Pose]) -> Pose:
    """Poses as one batch (N,), empty where there are none."""
    rotations = [pose.rotation for pose in poses]
    return Pose(np.array(rotations).reshape(-1, 3, 3), np.array([p.translation for p in poses]).reshape(-1, 3))


def inverse_jacobian(pose: Pose) -> Floats:
    """Derivative (..., 6, 6) of the step of pose.inverse() by the step of pose."""
    transposed = np.swapaxes(pose.rotation, -1, -2)
    result = np.zeros((*pose.translation.shape[:-1], 6, 6))
    result[..., :3, :3] = -transposed
    result[..., 3:, :3] = -transposed @ cross_matrix(pose.translation)
    result[..., 3:, 3:] = -transposed
    return result


def compose_jacobians(left: Pose, right: Pose) -> tuple[Floats, Floats]:
    """Derivatives (..., 6, 6) of the step of left @ right by the steps of left and of right."""
    batch = np.broadcast_shapes(left.translation.shape[:-1], right.translation.shape[:-1])
    by_left, by_right = np.zeros((*batch, 6, 6)), np.zeros((*batch, 6, 6))
    by_left[..., :3, :3] = np.eye(3)
    by_left[..., 3:, 3:] = np.eye(3)
    by_left[..., 3:, :3] = -cross_matrix((left.rotation @ right.translation[..., None])[..., 0])
    by_right[..., :3, :3] = left.rotation
    by_right[..., 3:, 3:] = left.rotation
    return by_left, by_right


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
