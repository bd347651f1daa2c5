"""Rotations: every way there has its way back, near zero and near half a turn too."""

import cv2
import numpy as np
import pytest

from quadrig.single.rotation import (
    angles_from_rotation,
    cross_matrix,
    nearest_rotation,
    quaternion_from_rotation,
    rotation_from_angles,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation,
)

ANGLES = [0.0, 1e-15, 1e-9, 1e-5, 0.9999e-4, 1.0001e-4, 1e-3, 0.5, 2.0, np.pi - 1e-3, np.pi - 1e-7, np.pi - 1e-12]


def directions(count=50, seed=0):
    v = np.random.default_rng(seed).normal(size=(count, 3))
    v = np.concatenate([v, np.eye(3), -np.eye(3)])
    return v / np.linalg.norm(v, axis=1, keepdims=True)


@pytest.mark.parametrize("angle", ANGLES)
def test_a_vector_comes_back_from_its_rotation(angle):
    vector = angle * directions()
    rotation = rotation_from_vector(vector)
    np.testing.assert_allclose(
        rotation @ np.swapaxes(rotation, -1, -2), np.broadcast_to(np.eye(3), rotation.shape), atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-14)
    # Relative to the angle where it is small: a step of 1e-9 must not come back as rounding.
    np.testing.assert_allclose(vector_from_rotation(rotation), vector, atol=1e-15 + 1e-13 * angle)


def test_half_a_turn_comes_back_as_the_same_rotation():
    rotation = rotation_from_vector(np.pi * directions())
    again = rotation_from_vector(vector_from_rotation(rotation))
    np.testing.assert_allclose(again, rotation, atol=1e-14)


def test_rotations_are_opencvs():
    for vector in 1.3 * directions(5):
        np.testing.assert_allclose(rotation_from_vector(vector), cv2.Rodrigues(vector)[0], atol=1e-14)


def test_the_cross_matrix_is_the_cross_product_and_the_slope_of_a_rotation():
    a, b = directions(20, 1), directions(20, 2)
    np.testing.assert_allclose((cross_matrix(a) @ b[..., None])[..., 0], np.cross(a, b), atol=1e-15)
    # Central differences of step 1e-6 are good to its square and to 1e-16 over it.
    slope = (rotation_from_vector(1e-6 * a) - rotation_from_vector(-1e-6 * a)) / 2e-6
    np.testing.assert_allclose(slope, cross_matrix(a), atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-8, 1.0, np.pi])
def test_a_quaternion_comes_back_with_its_real_part_not_negative(angle):
    rotation = rotation_from_vector(angle * directions())
    quaternion = quaternion_from_rotation(rotation)
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=-1), 1, atol=1e-15)
    assert (quaternion[..., 3] >= 0).all()
    np.testing.assert_allclose(rotation_from_quaternion(quaternion), rotation, atol=1e-14)
    np.testing.assert_allclose(rotation_from_quaternion(-3 * quaternion), rotation, atol=1e-14)


def test_the_papers_angles_come_back_and_follow_equation_2():
    rng = np.random.default_rng(3)
    x, y, z = rng.uniform(-np.pi, np.pi, 100), rng.uniform(-1.57, 1.57, 100), rng.uniform(-np.pi, np.pi, 100)
    rotation = rotation_from_angles(x, y, z)
    for got, put in zip(angles_from_rotation(rotation), (x, y, z), strict=True):
        # Near the pole of theta_y the others are determined by numbers of size cos(theta_y).
        np.testing.assert_allclose(got, put, atol=1e-11)
    about_x = cv2.Rodrigues(np.array([x[0], 0, 0]))[0]
    about_y = cv2.Rodrigues(np.array([0, y[0], 0]))[0]
    about_z = cv2.Rodrigues(np.array([0, 0, z[0]]))[0]
    np.testing.assert_allclose(rotation[0], about_x @ about_y @ about_z, atol=1e-14)


def test_the_nearest_rotation_beats_its_neighbours():
    rng = np.random.default_rng(4)
    matrix = rng.normal(size=(30, 3, 3))
    nearest = nearest_rotation(matrix)
    np.testing.assert_allclose(np.linalg.det(nearest), 1, atol=1e-13)
    distance = np.linalg.norm(nearest - matrix, axis=(-1, -2))
    for size in (1e-3, 0.1, 2.0):
        other = rotation_from_vector(size * rng.normal(size=(30, 3))) @ nearest
        assert (np.linalg.norm(other - matrix, axis=(-1, -2)) >= distance - 1e-12).all()
    rotation = rotation_from_vector(directions())
    np.testing.assert_allclose(nearest_rotation(1.7 * rotation), rotation, atol=1e-14)
