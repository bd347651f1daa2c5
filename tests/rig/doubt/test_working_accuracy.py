"""The working accuracy is what cameras, drawn from the covariance, do to the points that they triangulate."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.doubt.information import triangulation_derivatives, visible
from quadrig.rig.doubt.working_accuracy import accuracy_of, covered_points
from quadrig.single.pose import Pose


def camera_sets(rig):
    """The rig's cameras moved either way along each principal axis of their correlations, by one sigma.

    Over these sets any linear figure has the scatter that draws from the covariance give it, without their chance.
    """
    sigmas = np.sqrt(np.diagonal(rig.covariance))
    units = np.where(sigmas > 0, sigmas, 1)
    variances, axes = np.linalg.eigh(rig.covariance / np.outer(units, units))
    for variance, axis in zip(variances, axes.T, strict=True):
        # What is fixed has none, but for rounding.
        if variance > 1e-12:
            steps = (np.sqrt(variance) * units * axis).reshape(-1, 15)
            for sign in (1, -1):
                yield [moved(camera, sign * step) for camera, step in zip(rig.cameras, steps, strict=True)]


def moved(camera, step):
    lens = camera.intrinsics.with_parameters(camera.intrinsics.parameters + step[:9])
    return replace(camera, intrinsics=lens, rig_from_camera=camera.rig_from_camera.retract(step[9:]))


def pixels_of(cameras, points):
    return np.stack([c.intrinsics.project(c.rig_from_camera.inverse().transform(points)) for c in cameras])


def triangulated(cameras, pixels, sees, start):
    """Points (N, 3) whose pixels come nearest to those (C, N, 2) of the cameras that see (C, N) them: Gauss-Newton
    with slopes from differences."""
    points = start
    for _ in range(4):
        gap = np.where(sees[..., None], pixels - pixels_of(cameras, points), 0)
        ends = [[pixels_of(cameras, points + sign * 1e-5 * axis) for sign in (1, -1)] for axis in np.eye(3)]
        slope = np.stack([(plus - minus) / 2e-5 for plus, minus in ends], axis=-1) * sees[..., None, None]
        normal = np.einsum("cnki,cnkj->nij", slope, slope)
        points = points + np.linalg.solve(normal, np.einsum("cnki,cnk->ni", slope, gap)[..., None])[..., 0]
    return points


def brought_back(points, truth):
    """Points moved, turned and scaled onto the truth as near as they come (Umeyama)."""
    middle = points.mean(0)
    u, values, vt = np.linalg.svd((points - middle).T @ (truth - truth.mean(0)))
    scale = values.sum() / ((points - middle) ** 2).sum()
    return scale * (points - middle) @ (u * [1, 1, np.linalg.det(u @ vt)]) @ vt + truth.mean(0)


@pytest.fixture(scope="module")
def scattered(board_rig):
    """The covered points that two cameras see, and where each set of cameras triangulates them."""
    _, rig = board_rig
    points = covered_points(rig.rectangles)
    sees = np.stack([visible(camera, points) for camera in rig.cameras])
    seen = sees.sum(0) >= 2
    points, sees = points[seen], sees[:, seen]
    pixels = pixels_of(rig.cameras, points)
    return points, [triangulated(cameras, pixels, sees, points) for cameras in camera_sets(rig)]


def covariances(errors):
    """(N, 3, 3) of errors (2 K, N, 3), two for each of K axes."""
    return np.einsum("kni,knj->nij", errors, errors) / 2


def test_points_scatter_as_foretold(board_rig, scattered):
    _, rig = board_rig
    points, found = scattered
    moves = triangulation_derivatives(rig.cameras, points)
    foretold = moves @ rig.covariance @ np.swapaxes(moves, -1, -2)
    real = covariances(np.array(found) - points)
    # What is not linear in a step of one sigma is a share of about sigma over distance.
    np.testing.assert_allclose(foretold, real, rtol=0.02, atol=0.02 * np.abs(real).max())


def test_the_working_accuracy_is_that_of_triangulated_points(board_rig, scattered):
    _, rig = board_rig
    points, found = scattered
    shape = covariances(np.array([brought_back(each, points) for each in found]) - points)
    worst = np.linalg.eigvalsh(shape)[:, -1]
    assert rig.working_accuracy == pytest.approx(np.sqrt(worst.mean()), rel=0.01)
    # And that is not the figure with the rigid motion left in.
    loose = np.linalg.eigvalsh(covariances(np.array(found) - points))[:, -1]
    assert np.sqrt(loose.mean()) > 1.2 * rig.working_accuracy


def test_a_rigid_motion_of_the_whole_rig_is_no_doubt_of_its_shape(board_rig):
    """Cameras known but for one common motion triangulate every shape right."""
    _, rig = board_rig
    motion = np.zeros((45, 6))
    for index, camera in enumerate(rig.cameras):
        start = 15 * index + 9
        place = camera.rig_from_camera.translation
        motion[start : start + 3, :3] = np.eye(3)
        # Turning about the rig's origin carries each camera along.
        for axis in range(3):
            motion[start + 3 : start + 6, axis] = np.cross(np.eye(3)[axis], place)
        motion[start + 3 : start + 6, 3:] = np.eye(3)
    common = motion @ np.diag([0.01, 0.02, 0.01, 0.1, 0.2, 0.1]) ** 2 @ motion.T
    points = covered_points(rig.rectangles)
    assert accuracy_of(rig.cameras, common, points, 0.0).working < 1e-9
    both = accuracy_of(rig.cameras, rig.covariance + common, points, 0.0).working
    assert both == pytest.approx(rig.working_accuracy, rel=1e-6)


def test_points_that_one_camera_sees_cannot_be_triangulated(board_rig):
    _, rig = board_rig
    behind = Pose.identity().transform(np.array([[0.0, 0.0, -5.0], [0.1, 0, -5], [0, 0.1, -5]]))
    assert np.isnan(accuracy_of(rig.cameras, rig.covariance, behind, 1.0).working)
