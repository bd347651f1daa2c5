"""Maximum likelihood at the Cramer-Rao bound, with sigmas that hold, both tilts, and reasons where there is none."""

from dataclasses import dataclass

import numpy as np
import pytest

from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose
from quadrig.single.rectangle import rectangle_corners
from quadrig.single.rotation import angles_from_rotation, rotation_from_angles
from quadrig.single.solve.corners import Reason
from quadrig.single.solve.cramer_rao import MEAN_ABSOLUTE, cramer_rao, paper_sigmas
from quadrig.single.solve.maximum_likelihood import Solution, solve_points, solve_rectangles

IMAGE = np.array([1920, 1080])
CENTRE = (IMAGE - 1) / 2
NOISE = 0.3


@dataclass
class Views:
    """Rectangles wholly in view: width, height, focal (N), centre (N, 2), pose and points (N, P, 3)."""

    width: np.ndarray
    height: np.ndarray
    focal: np.ndarray
    centre: np.ndarray
    pose: Pose
    points: np.ndarray

    @property
    def pixels(self):
        located = self.pose[:, None].transform(self.points)
        return self.focal[:, None, None] * located[..., :2] / located[..., 2:] + self.centre[:, None]

    def take(self, index):
        width, height, focal = self.width[index], self.height[index], self.focal[index]
        return Views(width, height, focal, self.centre[index], self.pose[index], self.points[index])


def inner_points(width, height, side=8):
    steps = np.linspace(-0.5, 0.5, side)
    y, x = np.meshgrid(steps, steps, indexing="ij")
    flat = np.stack([x.ravel(), y.ravel(), np.zeros(side * side)], axis=-1)
    return flat * np.stack([width, height, np.ones_like(width)], axis=-1)[:, None]


def views_in_sight(rng, count, least_tilt=0.0, centre_sigma=0.0, grid=False):
    width = rng.uniform(0.1, 1, count * 4)
    height = width * np.exp(rng.uniform(-1, 1, len(width)))
    many = len(width)
    focal = rng.uniform(700, 4000, many)
    zero = np.zeros(many)
    tilt, way, spin = np.radians(rng.uniform(least_tilt, 70, many)), *rng.uniform(0, 2 * np.pi, (2, many))
    rotation = rotation_from_angles(zero, zero, way) @ rotation_from_angles(tilt, zero, spin - way)
    depth = focal * np.hypot(width, height) / rng.uniform(150, 900, many)
    aside = rng.uniform(-0.45, 0.45, (many, 2)) * IMAGE / focal[:, None] * depth[:, None]
    pose = Pose(rotation, np.concatenate([aside, depth[:, None]], axis=-1))
    centre = CENTRE + rng.normal(0, 1, (many, 2)) * centre_sigma
    views = Views(width, height, focal, centre, pose, rectangle_corners(width, height))
    located, corners = pose[:, None].transform(views.points), views.pixels
    sight = pose.translation / np.linalg.norm(pose.translation, axis=-1, keepdims=True)
    facing = (rotation[..., 2] * sight).sum(axis=-1)
    good = (located[..., 2] > 0).all(axis=1) & ((corners > 0) & (corners < IMAGE - 1)).all(axis=(1, 2))
    good &= (facing > 0) & (facing <= np.cos(np.radians(least_tilt)))
    views = views.take(np.flatnonzero(good)[:count])
    assert len(views.focal) == count
    if grid:
        views.points = inner_points(views.width, views.height)
    return views


def solve(views: Views, rng, **options) -> Solution:
    noisy = views.pixels + rng.normal(0, NOISE, views.pixels.shape)
    if views.points.shape[1] == 4:
        return solve_rectangles(noisy, views.width, views.height, CENTRE, sigma=NOISE, **options)
    return solve_points(views.points, noisy, CENTRE, sigma=NOISE, **options)


def errors_of(answer: Solution, views: Views):
    """Errors (N, 7) of the focal and of the step of camera_from_rect."""
    return np.concatenate(
        [(answer.focal - views.focal)[:, None], views.pose.step_to(answer.camera_from_rect)], axis=1
    )


def sigmas_of(covariance):
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))[..., [0, 3, 4, 5, 6, 7, 8]]


@pytest.mark.parametrize(("grid", "count"), [(False, 12_000), (True, 2_500)])
def test_errors_reach_the_bound(grid, count):
    rng = np.random.default_rng(11)
    views = views_in_sight(rng, count, grid=grid)
    bound = sigmas_of(cramer_rao(views.points, views.focal, views.pose, CENTRE, NOISE))
    observable = np.flatnonzero(bound[:, 0] < 0.05 * views.focal)
    assert len(observable) > 0.4 * count
    views, bound = views.take(observable), bound[observable]
    ratio = np.abs(errors_of(solve(views, rng), views)) / bound / MEAN_ABSOLUTE
    assert ratio.mean(axis=0).max() < 1.05
    # No estimator without bias does better: below this the bound itself would be wrong.
    assert ratio.mean(axis=0).min() > 0.95


@pytest.mark.parametrize("centre_sigma", [0.0, 20.0])
def test_intervals_hold_the_truth(centre_sigma):
    rng = np.random.default_rng(12)
    views = views_in_sight(rng, 20_000, least_tilt=10.0, centre_sigma=centre_sigma)
    answer = solve(views, rng, principal_point_sigma=centre_sigma)
    low, high = answer.focal_interval
    assert 0.93 < np.mean((low <= views.focal) & (views.focal <= high)) < 0.97
    inside = np.abs(errors_of(answer, views)) < 1.96 * sigmas_of(answer.covariance)
    assert ((inside.mean(axis=0) > 0.93) & (inside.mean(axis=0) < 0.97)).all()
    if centre_sigma:
        spread = np.sqrt(np.diagonal(answer.covariance, axis1=-2, axis2=-1))[:, 1:3]
        inside = np.abs(answer.principal_point - views.centre) < 1.96 * spread
        assert 0.93 < inside.mean() < 0.97


def test_covariance_in_both_frames_is_what_noise_does():
    rng = np.random.default_rng(13)
    one = views_in_sight(rng, 1, least_tilt=40.0)
    views = one.take(np.zeros(4000, int))
    answer = solve(views, rng)
    for step, covariance in (
        (views.pose.step_to(answer.camera_from_rect), answer.covariance[:, 3:, 3:]),
        (views.pose.inverse().step_to(answer.rect_from_camera), answer.rect_from_camera_covariance[:, 3:, 3:]),
    ):
        predicted = np.median(covariance, axis=0)
        scale = np.sqrt(np.diag(predicted))
        # 4000 draws know a correlation to 0.016 and a variance to 2.2 %; five of those.
        assert np.abs(np.cov(step.T) / np.outer(scale, scale) - predicted / np.outer(scale, scale)).max() < 0.12
    angles = np.stack(angles_from_rotation(answer.rect_from_camera.rotation), axis=-1)
    found = np.concatenate([answer.rect_from_camera.translation, angles, answer.focal[:, None]], axis=1)
    expected = np.median(paper_sigmas(answer.covariance, answer.camera_from_rect), axis=0)
    assert found.std(axis=0) == pytest.approx(expected, rel=0.12)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("centre_sigma", [0.0, 7.0])
def test_bound_is_the_numerical_fisher_information(known, centre_sigma):
    rng = np.random.default_rng(14)
    views = views_in_sight(rng, 5, least_tilt=20.0)
    bound = cramer_rao(
        views.points,
        views.focal,
        views.pose,
        CENTRE,
        NOISE,
        principal_point_sigma=centre_sigma,
        focal_known=known,
    )
    free = np.array([not known, centre_sigma > 0, centre_sigma > 0, *[True] * 6])
    for i in range(5):
        view = views.take([i])
        step, rows = 1e-6, []
        for k in range(9):
            seen = []
            for sign in (1, -1):
                moved = view.take([0])
                change = np.zeros(6)
                if k == 0:
                    moved.focal = view.focal + sign * step
                elif k < 3:
                    moved.centre = view.centre + sign * step * np.eye(2)[k - 1]
                else:
                    change[k - 3] = sign * step
                    moved.pose = view.pose.retract(change[None])
                seen.append(moved.pixels.ravel())
            rows.append((seen[0] - seen[1]) / (2 * step))
        J = np.array(rows).T / NOISE
        fisher = J.T @ J
        if centre_sigma:
            fisher[[1, 2], [1, 2]] += centre_sigma**-2
        own = bound[i][np.ix_(free, free)]
        np.testing.assert_array_equal(bound[i][~free], 0)
        scale = np.sqrt(np.diag(own))
        # Differences over 1e-6 of pixels near 1000 are good to 1e-7; the inverse multiplies that by its condition.
        inverse = np.linalg.inv(fisher[np.ix_(free, free)] * np.outer(scale, scale))
        assert np.abs(inverse - own / np.outer(scale, scale)).max() < 1e-3


def test_exact_points_come_back_and_the_start_does_not_matter():
    rng = np.random.default_rng(15)
    for grid in (False, True):
        views = views_in_sight(rng, 500, least_tilt=15.0, grid=grid)
        answer = solve_points(views.points, views.pixels, CENTRE, sigma=NOISE)
        assert np.abs(answer.focal / views.focal - 1).max() < 1e-9
        assert answer.chi2.max() < 1e-12


def test_points_that_are_unseen_leave_the_others_to_answer():
    rng = np.random.default_rng(16)
    views = views_in_sight(rng, 50, least_tilt=25.0, grid=True)
    pixels = views.pixels
    pixels[0, 8:] = np.nan  # the first row is left: on a line
    pixels[1, 3:] = np.nan
    pixels[2:, rng.permutation(64)[:40]] = np.nan
    answer = solve_points(views.points, pixels, CENTRE)
    assert answer.reason[0] == Reason.COLLINEAR
    assert answer.reason[1] == Reason.NOT_FINITE
    assert np.isnan(answer.focal[:2]).all()
    assert np.abs(answer.focal / views.focal - 1)[2:].max() < 1e-9
    assert (answer.dof[2:] == 2 * 24 - 7).all()


def test_a_known_focal_is_kept_and_helps():
    rng = np.random.default_rng(17)
    views = views_in_sight(rng, 500, least_tilt=5.0)
    noisy = views.pixels + rng.normal(0, NOISE, (500, 4, 2))
    given = solve_rectangles(noisy, views.width, views.height, CENTRE, focal=views.focal, sigma=NOISE)
    free = solve_rectangles(noisy, views.width, views.height, CENTRE, sigma=NOISE)
    assert (given.focal == views.focal).all()
    assert (given.focal_sigma == 0).all()
    assert (given.dof == free.dof + 1).all()
    # Conditioning never adds to a variance (taken at two estimates, hence the tolerance).
    observable = free.reason == Reason.OK
    assert np.median(sigmas_of(given.covariance)[observable, 6] / sigmas_of(free.covariance)[observable, 6]) < 0.5


def test_fronto_parallel_is_unknowable_with_an_interval_and_a_pose_for_a_given_focal():
    angles = np.radians([0.0, 90.0, 30.0])
    zero = np.zeros(3)
    pose = Pose(rotation_from_angles(zero, zero, angles), np.broadcast_to([0.02, -0.05, 1.2], (3, 3)))
    located = pose[:, None].transform(rectangle_corners(0.297, 0.21))
    corners = 1400 * located[..., :2] / located[..., 2:] + CENTRE
    blind = solve_rectangles(corners, 0.297, 0.21, CENTRE, sigma=NOISE)
    assert (blind.reason == Reason.FOCAL_UNKNOWABLE).all()
    low, high = blind.focal_interval
    # Without perspective, any lens shows the same from some distance.
    assert ((low >= 0) & (low < 1)).all()
    assert np.isposinf(high).all()
    given = solve_rectangles(corners, 0.297, 0.21, CENTRE, focal=1400.0, sigma=NOISE)
    assert (given.reason == Reason.OK).all()
    assert np.abs(pose.step_to(given.camera_from_rect)).max() < 1e-6


def test_bad_members_are_nan_with_a_reason_and_the_others_are_untouched():
    rng = np.random.default_rng(18)
    views = views_in_sight(rng, 6, least_tilt=20.0)
    noisy = views.pixels + rng.normal(0, NOISE, (6, 4, 2))
    alone = solve_rectangles(noisy, views.width, views.height, CENTRE, sigma=NOISE)
    spoilt, width = noisy.copy(), views.width.copy()
    spoilt[0, 2, 1] = np.nan
    spoilt[1] = spoilt[1, [0, 2, 1, 3]]
    spoilt[2, 1] = spoilt[2, 0] + 0.5 * (spoilt[2, 2] - spoilt[2, 0])
    spoilt[3] = spoilt[3, ::-1]
    width[4] = 0
    answer = solve_rectangles(spoilt, width, views.height, CENTRE, sigma=NOISE)
    expected = [Reason.NOT_FINITE, Reason.CROSSING, Reason.COLLINEAR, Reason.REVERSED, Reason.NO_SIZE, Reason.OK]
    assert answer.reason.tolist() == expected
    for values in (answer.focal, answer.chi2, answer.camera_from_rect.translation, answer.covariance):
        assert np.isnan(values[:5]).all()
    for values in answer.focal_interval:
        assert np.isnan(values[:5]).all()
    assert answer.focal[5] == pytest.approx(alone.focal[5], rel=1e-12)


@pytest.mark.parametrize("shape", [(3, 2), (4, 3), (0, 2)])
def test_wrong_shapes_are_named(shape):
    with pytest.raises(QuadrigError, match="shape"):
        solve_points(np.zeros((5, 3)), np.zeros(shape), CENTRE)
    with pytest.raises(QuadrigError, match="shape"):
        solve_rectangles(np.zeros(shape), 0.3, 0.2, CENTRE)


def test_a_size_that_does_not_fit_the_batch_is_named():
    with pytest.raises(QuadrigError, match="batch"):
        solve_rectangles(np.zeros((5, 4, 2)), np.ones(3), 0.2, CENTRE)


@pytest.mark.parametrize("shape", [(), (1,), (2, 3), (0,)])
@pytest.mark.parametrize("known", [None, 400.0])
def test_any_leading_shape(shape, known):
    quad = np.array([[300.0, 220.0], [100.0, 200.0], [110.0, 90.0], [290.0, 60.0]])
    corners, points = np.broadcast_to(quad, (*shape, 4, 2)), rectangle_corners(0.3, 0.2)
    centres = np.broadcast_to([160.0, 120.0], (*shape, 2))
    four = solve_rectangles(corners, 0.3, np.full(shape, 0.2), centres, focal=known, principal_point_sigma=3.0)
    any_points = solve_points(points, corners, centres, focal=known, principal_point_sigma=3.0)
    for answer in (four, any_points):
        assert answer.focal.shape == answer.chi2.shape == answer.reason.shape == answer.dof.shape == shape
        assert answer.covariance.shape == (*shape, 9, 9)
        assert answer.rect_from_camera_covariance.shape == (*shape, 9, 9)
        assert np.shape(answer.focal_interval[0]) == shape
    assert np.allclose(four.focal, any_points.focal, rtol=1e-6)
    bound = cramer_rao(points, four.focal, four.camera_from_rect, centres, 0.3)
    assert bound.shape == (*shape, 9, 9)
    assert np.allclose(bound.reshape(-1, 81), bound.reshape(-1, 81)[:1])
    assert paper_sigmas(bound, four.camera_from_rect).shape == (*shape, 7)
