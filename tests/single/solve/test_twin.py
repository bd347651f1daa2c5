"""Mirror twins of planar poses: both are found, and the first is as sure as it claims to be."""

import numpy as np
import pytest

from quadrig.single.markings.boards import board_points
from quadrig.single.pose import Pose
from quadrig.single.rectangle import rectangle_corners
from quadrig.single.rotation import rotation_from_angles
from quadrig.single.solve.maximum_likelihood import solve_rectangles
from quadrig.single.solve.twin import mirrored, twin_poses

CENTRE, NOISE = np.array([959.5, 539.5]), 0.3


def far_views(rng, count):
    """Small sheets far away: hardly any perspective, so that both tilts show nearly the same."""
    zero = np.zeros(count)
    tilt, way, spin = np.radians(rng.uniform(15, 50, count)), *rng.uniform(0, 2 * np.pi, (2, count))
    rotation = rotation_from_angles(zero, zero, way) @ rotation_from_angles(tilt, zero, spin - way)
    return Pose(rotation, np.stack([rng.uniform(-1, 1, count), rng.uniform(-0.5, 0.5, count), zero + 5.0], axis=-1))


def test_both_tilts_are_found_and_preferred_as_often_as_claimed():
    rng = np.random.default_rng(19)
    truth = far_views(rng, 1500)
    located = truth[:, None].transform(rectangle_corners(0.297, 0.21))
    corners = 3000.0 * located[..., :2] / located[..., 2:] + CENTRE + rng.normal(0, NOISE, (1500, 4, 2))
    start = solve_rectangles(corners, 0.297, 0.21, CENTRE, focal=3000.0, sigma=NOISE).camera_from_rect
    twins = twin_poses(rectangle_corners(0.297, 0.21), corners, 3000.0, CENTRE, start, NOISE)
    assert twins.exists.mean() > 0.95
    assert (twins.log_likelihood_ratio >= 0).all()
    from_truth = [np.linalg.norm(truth.step_to(twins.camera_from_rect[:, k])[:, :3], axis=-1) for k in (0, 1)]
    from_mirror = [
        np.linalg.norm(mirrored(truth).step_to(twins.camera_from_rect[:, k])[:, :3], axis=-1) for k in (0, 1)
    ]
    exists = twins.exists
    first = from_truth[0] < from_truth[1]
    # The pair is the truth and its mirror image, to within what noise and the little perspective do (8 degrees).
    near = np.where(first, np.maximum(from_truth[0], from_mirror[1]), np.maximum(from_truth[1], from_mirror[0]))
    assert np.median(near[exists]) < np.radians(8)
    # Claimed certainty against how often it was right: 1500 draws know a share to 1.3 %; four of those.
    assert first[exists].mean() == pytest.approx(twins.certainty[exists].mean(), abs=0.05)


def test_mirroring_twice_is_the_pose_itself():
    pose = far_views(np.random.default_rng(20), 100)
    again = mirrored(mirrored(pose))
    assert np.abs(again.rotation - pose.rotation).max() < 1e-12
    assert np.abs(np.linalg.det(mirrored(pose).rotation) - 1).max() < 1e-12


def near_boards(rng, count=200):
    """Boards near a camera of 1400 px, tilted by 30 to 60 degrees: poses and their noisy pixels (N, 48, 2)."""
    tilt, way = np.radians(rng.uniform(30, 60, count)), rng.uniform(0, 2 * np.pi, count)
    zero = np.zeros(count)
    rotation = rotation_from_angles(zero, zero, way) @ rotation_from_angles(tilt, zero, -way)
    pose = Pose(rotation, np.column_stack([rng.uniform(-0.1, 0.1, (count, 2)), rng.uniform(0.5, 0.8, count)]))
    located = pose[:, None].transform(board_points(9, 7, 0.03))
    pixels = 1400 * located[..., :2] / located[..., 2:] + CENTRE
    return pose, pixels + rng.normal(0, NOISE, pixels.shape)


def test_strong_perspective_has_no_twin_or_excludes_it():
    pose, pixels = near_boards(np.random.default_rng(21))
    # From the wrong tilt too, the right one is found and preferred.
    for start in (pose, mirrored(pose)):
        twins = twin_poses(board_points(9, 7, 0.03), pixels, 1400.0, CENTRE, start, NOISE)
        angle = np.linalg.norm(pose.step_to(twins.camera_from_rect[:, 0])[:, :3], axis=-1)
        assert (angle < np.radians(2)).all()
        assert (twins.certainty > 0.999).all()


def test_each_twin_is_at_the_least_sum_of_squares_near_it():
    rng = np.random.default_rng(22)
    truth, points = far_views(rng, 50), rectangle_corners(0.297, 0.21)
    located = truth[:, None].transform(points)
    corners = 3000.0 * located[..., :2] / located[..., 2:] + CENTRE + rng.normal(0, NOISE, (50, 4, 2))
    twins = twin_poses(points, corners, 3000.0, CENTRE, truth, NOISE)

    def chi2(poses):
        at = poses[:, None].transform(points)
        return (((3000.0 * at[..., :2] / at[..., 2:] + CENTRE - corners) / NOISE) ** 2).sum(axis=(1, 2))

    for k in (0, 1):
        there = twins.exists & twins.converged[:, k]
        assert there.mean() > 0.9
        found = twins.camera_from_rect[:, k]
        np.testing.assert_allclose(chi2(found)[there], twins.chi2[there, k], rtol=1e-6, atol=1e-6)
        sigma = np.sqrt(np.diagonal(twins.covariance[:, k], axis1=1, axis2=2))
        for sign in (1, -1):
            step = 0.3 * sign * sigma * rng.normal(size=(50, 6))
            assert (chi2(found.retract(step)) > twins.chi2[:, k] - 1e-6)[there].all()
    np.testing.assert_allclose(
        twins.certainty, 1 / (1 + np.exp((twins.chi2[:, 0] - twins.chi2[:, 1]) / 2)), rtol=1e-12
    )


@pytest.mark.parametrize("shape", [(), (1,), (2, 3), (0,)])
def test_any_leading_shape(shape):
    quad = np.array([[300.0, 220.0], [100.0, 200.0], [110.0, 90.0], [290.0, 60.0]])
    corners, points = np.broadcast_to(quad, (*shape, 4, 2)), rectangle_corners(0.3, 0.2)
    centres = np.broadcast_to([160.0, 120.0], (*shape, 2))
    start = solve_rectangles(corners, 0.3, np.full(shape, 0.2), centres, focal=400.0).camera_from_rect
    twins = twin_poses(points, corners, 400.0, centres, start)
    assert twins.chi2.shape == (*shape, 2)
    assert twins.camera_from_rect.rotation.shape == (*shape, 2, 3, 3)
    assert twins.covariance.shape == (*shape, 2, 6, 6)
