"""Lenses over several Views: the largest posterior, from far too, and a likelihood that is its curvature."""

import numpy as np
import pytest

from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.boards import board_points
from quadrig.single.pose import Pose
from quadrig.single.posterior.lens_fit import fit_lenses, residuals_of, stacked_views
from quadrig.single.rotation import rotation_from_angles
from quadrig.single.view import View

TRUTH = Intrinsics(1280, 720, 900.0, np.array([650.0, 350.0]), np.array([-0.15, 0.05, 0.0, 0.0, 0.0]))
SIGMAS = (0.2, 0.3, 0.5, 0.3)
PRIOR = np.array([100, 20, 20, 0.1, 0.1, 1e-3, 1e-3, 0.05, 2e-3])
ALL = np.ones(9, bool)


@pytest.fixture(scope="module")
def views():
    """Four Views of two boards, one point of them unseen; and the true poses, a batch (4)."""
    rng = np.random.default_rng(3)
    rotations = rotation_from_angles(rng.uniform(-0.6, 0.6, 4), rng.uniform(-0.6, 0.6, 4), rng.uniform(-3, 3, 4))
    poses = Pose(rotations, rng.uniform([-0.1, -0.1, 0.5], [0.1, 0.1, 0.8], (4, 3)))
    points = [board_points(9, 7, 0.03), board_points(6, 5, 0.04)] * 2
    made = []
    for k, sigma in enumerate(SIGMAS):
        pixels = TRUTH.project(poses[k].transform(points[k])) + rng.normal(0, sigma, (len(points[k]), 2))
        common = np.full(pixels.shape, 0.3) if k == 2 else None
        made.append(View(("large", "small")[k % 2], points[k], pixels, sigma=sigma, common=common))
    made[1].pixels[3] = np.nan
    return stacked_views(made, (1280, 720)), poses


def fit(views, poses, focals=(900.0,), free=ALL, away=0.0):
    count = len(focals)
    lens = np.tile(Intrinsics.centred(1280, 720, 900.0).parameters, (count, 1))
    mean, information = lens.copy(), np.tile(np.diag(PRIOR**-2), (count, 1, 1))
    lens[:, 0] = focals
    start = poses.retract(away * np.random.default_rng(5).normal(size=(4, 6)) * [1, 1, 1, 0.3, 0.3, 0.3])
    start = Pose(np.tile(start.rotation, (count, 1, 1, 1)), np.tile(start.translation, (count, 1, 1)))
    return fit_lenses(views, lens, np.zeros((count, views.shapes)), start, free, mean, information), mean[0]


def whitened_residuals(views, lens, shape, poses):
    """All residuals over their sigma; the View with a common error freed of it by the inverse root of I + u u^T."""
    rows = residuals_of(views, lens, shape, poses) / views.sigma[:, None, None]
    values, axes = np.linalg.eigh(np.eye(views.common[2].size) + np.outer(views.common[2], views.common[2]))
    rows[2] = (axes @ ((axes.T @ rows[2].ravel()) / np.sqrt(values))).reshape(rows[2].shape)
    return rows.ravel()


@pytest.fixture(scope="module")
def fitted(views):
    return fit(*views)


def test_the_end_is_the_least_cost(views, fitted):
    stacked, _ = views
    found, mean = fitted
    assert found.converged.all()

    def cost(lens, shape, poses):
        square = (whitened_residuals(stacked, lens, shape, poses) ** 2).sum()
        return square + (((lens - mean) / PRIOR) ** 2).sum() + (shape**2).sum()

    least = cost(found.lens[0], found.shape[0], found.camera_from_rects[0])
    expected = found.chi2[0] + (((found.lens[0] - mean) / PRIOR) ** 2).sum() + (found.shape[0] ** 2).sum()
    assert least == pytest.approx(expected)
    rng = np.random.default_rng(4)
    for _ in range(10):
        lens = found.lens[0] + 0.01 * PRIOR * rng.normal(size=9)
        shape = found.shape[0] + 0.01 * rng.normal(size=stacked.shapes)
        poses = found.camera_from_rects[0].retract(1e-5 * rng.normal(size=(4, 6)))
        assert cost(lens, shape, poses) > least


def test_the_likelihood_is_the_curvature_with_poses_and_shapes_integrated(views, fitted):
    """The Gauss-Newton matrix of all numbers by differences, and what is left of it for the lens."""
    stacked, _ = views
    found, _ = fitted
    unit = np.concatenate([PRIOR, np.ones(stacked.shapes)])

    def residuals(step):
        lens, shape = found.lens[0] + step[:9] * unit[:9], found.shape[0] + step[9:-24]
        poses = found.camera_from_rects[0].retract(step[-24:].reshape(4, 6))
        return whitened_residuals(stacked, lens, shape, poses)

    slopes = [(residuals(1e-5 * e) - residuals(-1e-5 * e)) / 2e-5 for e in np.eye(9 + stacked.shapes + 24)]
    J = np.stack(slopes, axis=1)
    for scale in (1.0, 1.7):
        seen = found.likelihood(scale)
        whole = J.T @ J / scale**2
        shapes = np.arange(9, 9 + stacked.shapes)
        whole[shapes, shapes] += 1
        inner, outer = whole[9:, 9:], whole[:9, 9:]
        expected = whole[:9, :9] - outer @ np.linalg.solve(inner, outer.T)
        lens = seen.information[0] * np.outer(PRIOR, PRIOR)
        # Slopes of differences are good to 1e-6 of the largest.
        assert np.abs(lens - expected).max() < 1e-5 * np.abs(expected).max()
        poses = np.linalg.inv(inner)[-24:, -24:].reshape(4, 6, 4, 6)[range(4), :, range(4)]
        size = np.sqrt(np.diagonal(poses, axis1=1, axis2=2))
        both = size[:, :, None] * size[:, None, :]
        np.testing.assert_allclose(seen.pose_covariance[0] / both, poses / both, atol=1e-4)
        gain = (-np.linalg.solve(inner, outer.T)[-24:]).reshape(4, 6, 9)
        off = (seen.pose_gain[0] * PRIOR - gain) / size[..., None]
        assert np.abs(off).max() < 1e-4 * np.abs(gain / size[..., None]).max()


def test_far_starts_end_at_the_same_place(views, fitted):
    near, _ = fitted
    far, _ = fit(*views, focals=(500.0, 1500.0), away=0.2)
    assert far.converged.all()
    sigma = np.sqrt(np.diagonal(np.linalg.inv(near.likelihood().information[0] + np.diag(PRIOR**-2))))
    assert (np.abs(far.lens - near.lens) < 1e-3 * sigma).all()


def test_what_is_not_free_stays(views):
    found, _ = fit(*views, focals=(880.0, 950.0), free=np.arange(9) > 0)
    np.testing.assert_array_equal(found.lens[:, 0], [880.0, 950.0])


def test_a_pose_needs_four_points(views):
    stacked, poses = views
    few = np.arange(stacked.seen.shape[1]) < 3
    with pytest.raises(QuadrigError, match="four"):
        fit(
            type(stacked)(
                *(
                    getattr(stacked, n) & few if n == "seen" else getattr(stacked, n)
                    for n in stacked.__dataclass_fields__
                )
            ),
            poses,
        )
