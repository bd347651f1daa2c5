"""The pose of a plane: exact for exact points, the truth among its two candidates, twins that mirror each other."""

import numpy as np
import pytest

from quadrig.single.markings.boards import board_points
from quadrig.single.pose import Pose
from quadrig.single.rectangle import rectangle_corners
from quadrig.single.rotation import rotation_from_vector
from quadrig.single.solve.planar_pose import planar_poses


def in_front(count, seed=0, tilt=0.6):
    rng = np.random.default_rng(seed)
    place = rng.uniform([-0.4, -0.3, 1.0], [0.4, 0.3, 3.0], (count, 3))
    return Pose(rotation_from_vector(rng.normal(size=(count, 3)) * tilt * [1, 1, 0.5]), place)


def seen(poses, points):
    located = poses[:, None].transform(points)
    return located[..., :2] / located[..., 2:]


def rays(plane):
    ray = np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)
    return ray / np.linalg.norm(ray, axis=-1, keepdims=True)


def solved(points, plane, weights=None):
    return planar_poses(points, rays(plane), weights)


def facing(poses):
    """Whether the sheet's face is turned to the camera."""
    return np.einsum("vi,vi->v", poses.rotation[..., :, 2], poses.translation) > 0.05


def test_exact_points_give_the_pose_they_came_from():
    truth = in_front(300)
    truth = truth[facing(truth)]
    for points in (rectangle_corners(0.4, 0.3), board_points(9, 7, 0.05)):
        found = solved(points, seen(truth, points))
        np.testing.assert_allclose(found.camera_from_rect[:, 0].rotation, truth.rotation, atol=1e-6)
        np.testing.assert_allclose(found.camera_from_rect[:, 0].translation, truth.translation, atol=1e-6)
        np.testing.assert_allclose(found.errors[:, 0], 0, atol=1e-7)
        assert (found.errors[:, 1] >= found.errors[:, 0]).all()


def test_planes_beside_and_behind_the_lens_are_as_good_as_any():
    truth = in_front(100)
    truth = truth[facing(truth)]
    points = board_points(9, 7, 0.05)
    for angle in (1.5, 1.9, 2.8):
        turned = Pose(rotation_from_vector(np.array([0.6 * angle, -0.8 * angle, 0.0])), np.zeros(3)) @ truth
        located = turned[:, None].transform(points)
        found = planar_poses(points, located / np.linalg.norm(located, axis=-1, keepdims=True))
        np.testing.assert_allclose(found.camera_from_rect[:, 0].rotation, turned.rotation, atol=1e-6)
        np.testing.assert_allclose(found.camera_from_rect[:, 0].translation, turned.translation, atol=1e-6)


def test_both_candidates_are_rotations_before_the_camera():
    truth = in_front(100)
    truth = truth[facing(truth)]
    found = solved(rectangle_corners(0.4, 0.3), seen(truth, rectangle_corners(0.4, 0.3)))
    rotation = found.camera_from_rect.rotation
    np.testing.assert_allclose(
        rotation @ np.swapaxes(rotation, -1, -2), np.broadcast_to(np.eye(3), rotation.shape), atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-9)
    assert (found.camera_from_rect.translation[..., 2] > 0).all()


def test_where_the_view_is_weak_the_truth_is_one_of_the_two():
    rng = np.random.default_rng(5)
    far = Pose(
        rotation_from_vector(rng.normal(size=(200, 3)) * 0.4), rng.uniform([-1, -0.5, 6], [1, 0.5, 9], (200, 3))
    )
    points = rectangle_corners(0.2, 0.2)
    # 0.3 px of a focal of 1000 px: perspective within so small a sheet drowns in it.
    found = solved(points, seen(far, points) + 3e-4 * rng.normal(size=(200, 4, 2)))
    angle = [np.linalg.norm(far.step_to(found.camera_from_rect[:, candidate])[:, :3], axis=1) for candidate in (0, 1)]
    nearest = np.minimum(*angle)
    assert np.median(nearest) < np.median(angle[0])
    # The first alone is a coin's toss in such views; the better of both is near the truth.
    assert 0.2 < (angle[0] > angle[1]).mean() < 0.8
    assert np.percentile(nearest, 75) < 0.35


def test_a_point_of_weight_zero_has_no_say():
    truth = in_front(20, 3, 0.4)
    points = board_points(5, 4, 0.1)
    plane = seen(truth, points)
    plane[:, 2] += 0.3
    weights = np.ones(plane.shape[:2])
    weights[:, 2] = 0
    found = solved(points, plane, weights)
    np.testing.assert_allclose(found.camera_from_rect[:, 0].translation, truth.translation, atol=1e-6)


@pytest.mark.parametrize("shape", [(), (1,), (3, 2), (0,)])
def test_any_leading_shape(shape):
    truth = in_front(7, 4, 0.4)
    truth = truth[facing(truth)]
    points = rectangle_corners(0.4, 0.3)
    whole = solved(points, seen(truth, points))
    which = np.arange(int(np.prod(shape))).reshape(shape) % len(truth.translation)
    plane = seen(truth, points)[which]
    found = planar_poses(points, rays(plane))
    assert found.errors.shape == (*shape, 2)
    np.testing.assert_allclose(found.camera_from_rect.rotation, whole.camera_from_rect.rotation[which], atol=1e-9)
    np.testing.assert_allclose(
        found.camera_from_rect.translation, whole.camera_from_rect.translation[which], atol=1e-9
    )


def test_errors_are_those_of_the_reprojection():
    rng = np.random.default_rng(6)
    truth = in_front(40, 5, 0.5)
    points = board_points(5, 4, 0.08)
    weights = rng.choice([0.0, 1.0, 4.0], (40, 12), p=[0.1, 0.6, 0.3])
    plane = seen(truth, points) + 1e-3 * rng.normal(size=(40, 12, 2))
    found = solved(points, plane, weights)
    middle = (weights[..., None] * rays(plane)).sum(axis=1)[..., None]
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    for k in (0, 1):
        located = found.camera_from_rect[:, k][:, None].transform(points)
        before = (located @ middle > 0).all(axis=(1, 2))
        square = ((located / (located @ middle) - rays(plane) / (rays(plane) @ middle)) ** 2).sum(axis=-1)
        expected = np.sqrt((weights * square).sum(axis=1) / weights.sum(axis=1))
        np.testing.assert_allclose(found.errors[before, k], expected[before], rtol=1e-6)
        assert np.isinf(found.errors[~before, k]).all()


def test_a_view_without_rays_spoils_no_other():
    """All of its points may lie where a lens has no rays: its errors are infinite, those of the others as before."""
    points = np.array([[0.1, 0.1, 0], [-0.1, 0.1, 0], [-0.1, -0.1, 0], [0.1, -0.1, 0]])
    seen = points + np.array([0.05, 0.02, 1.0])
    rays = np.stack([seen / np.linalg.norm(seen, axis=1, keepdims=True), np.full((4, 3), np.nan)])
    found = planar_poses(np.stack([points, points]), rays)
    assert np.isinf(found.errors[1]).all()
    assert found.errors[0, 0] < 1e-9
    np.testing.assert_allclose(found.camera_from_rect.translation[0, 0], [0.05, 0.02, 1.0], atol=1e-9)
