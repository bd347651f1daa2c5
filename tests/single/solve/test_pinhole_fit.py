"""The search for the likeliest pinhole: far starts and slow members end where near ones do, whatever their batch."""

import numpy as np
import pytest

from quadrig.single.pose import Pose
from quadrig.single.rectangle import rectangle_corners
from quadrig.single.rotation import rotation_from_angles
from quadrig.single.solve.cramer_rao import cramer_rao
from quadrig.single.solve.pinhole_fit import Guess, fit_pinhole

CENTRE = np.array([639.5, 359.5])
CORNERS = rectangle_corners(0.297, 0.21)
NOISE = 0.3


@pytest.fixture(scope="module")
def views():
    """Sixty tilted sheets: poses, focals (60) and noisy pixels (60, 4, 2)."""
    rng = np.random.default_rng(1)
    tilt, other, spin = rng.uniform(0.4, 0.8, 60), rng.uniform(-0.5, 0.5, 60), rng.uniform(-3, 3, 60)
    place = rng.uniform([-0.15, -0.1, 0.5], [0.15, 0.1, 0.9], (60, 3))
    pose, focal = Pose(rotation_from_angles(tilt, other, spin), place), rng.uniform(700, 1500, 60)
    located = pose[:, None].transform(CORNERS)
    pixels = focal[:, None, None] * located[..., :2] / located[..., 2:] + CENTRE
    return pose, focal, pixels + rng.normal(0, NOISE, pixels.shape)


def far_from(pose, rng):
    """Starts a quarter of a radian and a tenth of the distance away."""
    step = np.concatenate(
        [0.25 * rng.normal(size=(60, 3)), 0.1 * pose.translation[:, 2:] * rng.normal(size=(60, 3))], 1
    )
    return pose.retract(step)


def test_far_starts_end_where_near_ones_do(views):
    pose, focal, pixels = views
    near = fit_pinhole(CORNERS, pixels, Guess(focal, pose), CENTRE, NOISE)
    rng = np.random.default_rng(2)
    far = fit_pinhole(CORNERS, pixels, Guess(focal * rng.uniform(0.6, 1.6, 60), far_from(pose, rng)), CENTRE, NOISE)
    assert near.converged.all()
    # Many go on together after the first few steps of their block; all arrive, but for those that fall into the
    # mirrored tilt, where the sum of squares is another.
    assert (far.steps > 6).sum() >= 10
    assert far.converged.all()
    same = np.abs(far.chi2 - near.chi2) < 1e-3
    assert same.mean() > 0.8
    sigma = np.sqrt(near.covariance[:, 0, 0])
    assert (np.abs(far.focal - near.focal) < 0.01 * sigma)[same].all()


def test_a_member_is_solved_the_same_alone_and_among_others(views):
    pose, focal, pixels = views
    start = far_from(pose, np.random.default_rng(3))
    together = fit_pinhole(CORNERS, pixels, Guess(focal, start), CENTRE, NOISE)
    for k in range(0, 60, 7):
        alone = fit_pinhole(CORNERS, pixels[k], Guess(focal[k], start[k]), CENTRE, NOISE)
        assert alone.focal == pytest.approx(together.focal[k], rel=1e-9)
        assert alone.chi2 == pytest.approx(together.chi2[k], rel=1e-9)
        assert alone.steps == together.steps[k]


@pytest.mark.parametrize("centre_sigma", [0.0, 10.0])
@pytest.mark.parametrize("known", [False, True])
def test_the_covariance_is_the_bound_there_and_zero_for_what_was_given(views, centre_sigma, known):
    pose, focal, pixels = views
    found = fit_pinhole(CORNERS, pixels, Guess(focal, pose), CENTRE, NOISE, centre_sigma, focal_known=known)
    bound = cramer_rao(
        CORNERS, found.focal, found.camera_from_rect, found.principal_point, NOISE, centre_sigma, focal_known=known
    )
    np.testing.assert_allclose(found.covariance, bound, rtol=1e-6, atol=1e-12)
    given = [0] * known + [1, 2] * (centre_sigma == 0)
    np.testing.assert_array_equal(found.covariance[:, given], 0)
    assert (np.delete(np.diagonal(found.covariance, axis1=1, axis2=2), given, axis=1) > 0).all()
    if known:
        np.testing.assert_array_equal(found.focal, focal)


def test_the_prior_of_the_principal_point_counts_in_the_sum_of_squares(views):
    pose, focal, pixels = views
    found = fit_pinhole(CORNERS, pixels, Guess(focal, pose), CENTRE, NOISE, 10.0)
    located = found.camera_from_rect[:, None].transform(CORNERS)
    seen = found.focal[:, None, None] * located[..., :2] / located[..., 2:] + found.principal_point[:, None]
    chi2 = (((pixels - seen) / NOISE) ** 2).sum((1, 2)) + (((found.principal_point - CENTRE) / 10) ** 2).sum(1)
    np.testing.assert_allclose(found.chi2, chi2, rtol=1e-6, atol=1e-9)
