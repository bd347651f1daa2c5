"""One lens over several Views: the least sum of squares, from far too, and a covariance that is its curvature."""

import numpy as np
import pytest

from quadrig.single.lens import Intrinsics
from quadrig.single.markings.boards import board_points
from quadrig.single.pose import Pose
from quadrig.single.rotation import rotation_from_angles
from quadrig.single.solve.lens_fit import fit_lens

TRUTH = Intrinsics(1280, 720, 900.0, np.array([650.0, 350.0]), np.array([-0.15, 0.05, 0.0, 0.0, 0.0]))
FREE = ("focal", "cx", "cy", "k1", "k2")
COLUMNS = [0, 1, 2, 3, 4]
PRIOR = {"cx": 5.0, "cy": 5.0, "k1": 0.02}
SIGMAS = (0.2, 0.3, 0.5, 0.3)


@pytest.fixture(scope="module")
def views():
    """Four Views of two boards: points, noisy pixels, and the true poses, a batch (4)."""
    rng = np.random.default_rng(3)
    rotations = rotation_from_angles(rng.uniform(-0.6, 0.6, 4), rng.uniform(-0.6, 0.6, 4), rng.uniform(-3, 3, 4))
    poses = Pose(rotations, rng.uniform([-0.1, -0.1, 0.5], [0.1, 0.1, 0.8], (4, 3)))
    points = [board_points(9, 7, 0.03), board_points(6, 5, 0.04)] * 2
    exact = [
        TRUTH.project(pose.transform(own)) for pose, own in zip((poses[k] for k in range(4)), points, strict=True)
    ]
    noisy = [pixels + rng.normal(0, s, pixels.shape) for pixels, s in zip(exact, SIGMAS, strict=True)]
    # A point that was not seen.
    noisy[1][3] = np.nan
    return points, noisy, poses


def start_near(poses, rng, size):
    return poses.retract(size * rng.normal(size=(4, 6)) * [1, 1, 1, 0.3, 0.3, 0.3])


def least_squares(points, pixels, lens, poses, start):
    """The sum of squares over sigma^2, with the priors about the start."""
    total = sum(
        np.nansum(((seen - lens.project(poses[k].transform(own))) / SIGMAS[k]) ** 2)
        for k, (own, seen) in enumerate(zip(points, pixels, strict=True))
    )
    gap = lens.parameters - start.parameters
    return total + sum((gap[{"cx": 1, "cy": 2, "k1": 3}[name]] / sigma) ** 2 for name, sigma in PRIOR.items())


@pytest.fixture(scope="module")
def fitted(views):
    points, pixels, poses = views
    start = Intrinsics.centred(1280, 720, 900.0)
    return start, fit_lens(points, pixels, start, poses, FREE, SIGMAS, PRIOR)


def test_the_end_is_the_least_sum_of_squares_with_its_priors(views, fitted):
    points, pixels, _ = views
    start, found = fitted
    assert found.converged
    assert found.dof == 2 * (48 + 19 + 48 + 20) + 3 - 5 - 24
    assert found.chi2 == pytest.approx(
        least_squares(points, pixels, found.intrinsics, found.camera_from_rects, start)
    )
    rng = np.random.default_rng(4)
    sigma = np.sqrt(np.diag(found.lens_covariance))
    for _ in range(10):
        lens = found.intrinsics.with_parameters(found.intrinsics.parameters + 0.1 * sigma * rng.normal(size=9))
        poses = found.camera_from_rects.retract(1e-5 * rng.normal(size=(4, 6)))
        assert least_squares(points, pixels, lens, poses, start) > found.chi2


def test_the_residuals_are_those_of_the_pixels(views, fitted):
    points, pixels, _ = views
    _, found = fitted
    for k in range(4):
        seen = found.intrinsics.project(found.camera_from_rects[k].transform(points[k]))
        np.testing.assert_allclose(found.residuals[k], np.nan_to_num(pixels[k] - seen), atol=1e-9)


def test_the_covariance_is_the_inverse_of_the_curvature(views, fitted):
    """The Gauss-Newton matrix of all parameters by differences, inverted as a whole."""
    points, pixels, _ = views
    _, found = fitted
    parameters, size = found.intrinsics.parameters, 5 + 24

    def residuals(step):
        moved = parameters.copy()
        moved[COLUMNS] += step[:5]
        lens, poses = found.intrinsics.with_parameters(moved), found.camera_from_rects.retract(step[5:].reshape(4, 6))
        rows = [
            np.where(np.isfinite(pixels[k]), lens.project(poses[k].transform(points[k])), 0) / SIGMAS[k]
            for k in range(4)
        ]
        return np.concatenate([row.ravel() for row in rows])

    J = np.stack([(residuals(1e-5 * e) - residuals(-1e-5 * e)) / 2e-5 for e in np.eye(size)], axis=1)
    information = J.T @ J
    information[[1, 2, 3], [1, 2, 3]] += [1 / sigma**2 for sigma in PRIOR.values()]
    whole = np.linalg.inv(information)
    scale = np.sqrt(np.diag(whole))

    def assert_close(block, rows, columns):
        # Slopes of differences are good to 1e-6 of the largest.
        both = np.outer(scale[rows], scale[columns])
        np.testing.assert_allclose(block / both, whole[np.ix_(rows, columns)] / both, atol=1e-4)

    lens = np.arange(5)
    assert_close(found.lens_covariance[:5, :5], lens, lens)
    np.testing.assert_array_equal(found.lens_covariance[5:], 0)
    for k in range(4):
        pose = np.arange(5 + 6 * k, 11 + 6 * k)
        assert_close(found.pose_covariance[k], pose, pose)
        assert_close(found.lens_pose_covariance[k, :5], lens, pose)
        np.testing.assert_array_equal(found.lens_pose_covariance[k, 5:], 0)


@pytest.mark.parametrize("focal", [500.0, 1500.0])
def test_a_far_start_ends_at_the_same_minimum(views, fitted, focal):
    points, pixels, poses = views
    _, near = fitted
    far = Intrinsics.centred(1280, 720, focal)
    found = fit_lens(points, pixels, far, start_near(poses, np.random.default_rng(5), 0.2), FREE, SIGMAS, PRIOR)
    assert found.converged
    sigma = np.sqrt(np.diag(near.lens_covariance))[COLUMNS]
    gap = (found.intrinsics.parameters - near.intrinsics.parameters)[COLUMNS]
    assert (np.abs(gap) < 1e-3 * sigma).all()


def test_poses_alone_can_be_found(views):
    points, pixels, poses = views
    found = fit_lens(points, pixels, TRUTH, start_near(poses, np.random.default_rng(6), 0.1), (), SIGMAS)
    assert found.converged
    np.testing.assert_array_equal(found.intrinsics.parameters, TRUTH.parameters)
    np.testing.assert_array_equal(found.lens_covariance, 0)
    error = poses.step_to(found.camera_from_rects) / np.sqrt(np.diagonal(found.pose_covariance, axis1=1, axis2=2))
    # 24 unit normals: their root mean square lies in 0.55 to 1.45 but once in a thousand.
    assert 0.55 < np.sqrt(np.mean(error**2)) < 1.45
