"""The doubt of a rig: it scales with the noise, holds the truth, shrinks with what is seen, and is a covariance."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.rig.doubt.information import camera_derivatives, rectangle_derivatives, scaled_inverse
from quadrig.rig.result import Camera
from quadrig.single.lens import LENS_PARAMETERS, Intrinsics
from quadrig.single.pose import Pose, inverse_jacobian
from quadrig.single.rectangle import rectangle_corners


def solved(made):
    return calibrate(made.inputs, made.rectangles, made.views)


def figures(rig):
    per_camera = [
        (rig.focal_sigma(c.name), rig.rotation_sigma(c.name), rig.position_sigma(c.name)) for c in rig.cameras
    ]
    return np.array(per_camera)[1:]


def test_it_is_a_covariance(board_rig):
    _, rig = board_rig
    covariance = rig.covariance
    assert covariance.shape == (45, 45)
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-18, rtol=1e-9)
    sigma = np.sqrt(np.diagonal(covariance))
    known = sigma > 0
    correlation = covariance[np.ix_(known, known)] / np.outer(sigma[known], sigma[known])
    assert np.linalg.eigvalsh(correlation).min() > 0
    np.testing.assert_array_equal(covariance[~known], 0)
    free = [
        name in c.free_lens
        for c in rig.cameras
        for name in ("focal", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "aspect")
    ]
    lens = np.concatenate([sigma[15 * i : 15 * i + 9] > 0 for i in range(3)])
    np.testing.assert_array_equal(lens, free)


def test_it_scales_with_the_noise(simulated):
    """The lens is told, so that the same numbers are estimated, and the sizes of the sheets, which no noise makes
    unsure; the same draw of noise, thrice as large, and well above what lenses leave over."""
    quiet = simulated.simulate(15, simulated.Scene(cameras=3, framesets=16, noise=0.3, principal=0.0))
    loud = simulated.simulate(15, simulated.Scene(cameras=3, framesets=16, noise=0.9, principal=0.0))
    assert len(quiet.views) == len(loud.views)
    rigs = []
    for made in (quiet, loud):
        inputs = [replace(c, lens="f k1 k2") for c in made.inputs]
        known = [replace(rectangle, scale_sigma=1e-9) for rectangle in made.rectangles]
        rigs.append(calibrate(inputs, known, made.views))
    grown = [*(figures(rigs[1]) / figures(rigs[0])).ravel(), rigs[1].working_accuracy / rigs[0].working_accuracy]
    # What priors hold and what sheets and lenses leave over is no noise: a little less than thrice, never more.
    assert min(grown) > 2.7
    assert max(grown) < 3.05


def test_told_sigmas_are_relative_only(board_rig):
    """How sure corners are is learned: all sigmas doubled change nothing."""
    made, rig = board_rig
    other = calibrate(made.inputs, made.rectangles, [replace(v, sigma=2 * v.sigma) for v in made.views])
    np.testing.assert_allclose(figures(other), figures(rig), rtol=1e-9)


def test_more_views_leave_less_doubt(simulated):
    made = simulated.simulate(16, simulated.Scene(cameras=3, framesets=32, tags=0))
    few = calibrate(made.inputs, made.rectangles, [v for v in made.views if v.frameset < 16])
    many = solved(made)
    ratio = figures(many) / figures(few)
    # Twice as many Views of like kind: a root of two, give or take where they stood.
    assert 0.5 < np.median(ratio) < 0.9
    assert many.working_accuracy < few.working_accuracy


def test_the_doubt_holds_the_truth(simulated):
    """Twelve rigs: 24 poses and 36 focals, in their own sigmas. benchmarks/coverage.py counts many more."""
    poses, focals = [], []
    for seed in range(100, 112):
        made = simulated.simulate(seed, simulated.Scene(cameras=3, framesets=14, noise=0.3))
        rig = solved(made)
        for camera in rig.cameras:
            error = camera.intrinsics.focal - made.lenses[made.index(camera.name), 0]
            focals.append((error / rig.focal_sigma(camera.name)) ** 2)
            if camera.name != rig.reference:
                step = camera.rig_from_camera.step_to(made.rig_from_camera(rig.reference, camera.name))
                poses.append(step @ np.linalg.solve(rig.pose_covariance(camera.name), step) / 6)
    # Means of chi-square over its degrees of freedom; poses of one rig are not independent: four sigma either way.
    assert 0.55 < np.mean(poses) < 1.6
    assert 0.35 < np.mean(focals) < 2.2


def test_doubt_moves_with_the_frame(board_rig):
    """cam0 in cam1's frame is as sure as cam1 in cam0's."""
    made, rig = board_rig
    other = calibrate(made.inputs, made.rectangles, made.views, reference="cam1")
    jacobian = inverse_jacobian(rig.camera("cam1").rig_from_camera)
    turned = jacobian @ rig.pose_covariance("cam1") @ jacobian.T
    np.testing.assert_allclose(other.pose_covariance("cam0"), turned, rtol=1e-3, atol=1e-4 * np.abs(turned).max())


def slopes(function, columns):
    """By central differences, whose error is of the size of step squared times the third derivative."""
    return np.stack([(function(1e-5 * a) - function(-1e-5 * a)) / 2e-5 for a in np.eye(columns)], axis=-1)


@pytest.fixture(params=["pinhole", "fisheye"])
def camera(request):
    """A camera of which everything is free, two metres before the origin, not straight."""
    lens = Intrinsics(1280, 720, 900.0, np.array([630.0, 355.0]), np.array([-0.1, 0.02, 1e-3, -5e-4, 1e-3]))
    pose = Pose.from_vectors(np.array([0.2, -0.3, 0.1]), np.array([0.4, 0.2, -2.0]))
    return Camera("cam", replace(lens, model=request.param), pose, LENS_PARAMETERS)


def test_camera_derivatives_are_those_of_the_projection(camera):
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (6, 3))

    def pixels(step, shift):
        lens = camera.intrinsics.with_parameters(camera.intrinsics.parameters + step[:9])
        return lens.project(camera.rig_from_camera.retract(step[9:]).inverse().transform(points + shift))

    found, by_camera, by_point = camera_derivatives(camera, points)
    np.testing.assert_allclose(found, pixels(np.zeros(15), 0), atol=1e-9)
    np.testing.assert_allclose(by_camera, slopes(lambda s: pixels(s, 0), 15), rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(by_point, slopes(lambda s: pixels(np.zeros(15), s), 3), rtol=1e-5, atol=1e-4)


def test_what_is_fixed_has_no_derivative(camera):
    every = camera_derivatives(camera, np.array([0.1, 0.2, 0.3]))[1]
    some = camera_derivatives(replace(camera, free_lens=("cx", "k1")), np.array([0.1, 0.2, 0.3]))[1]
    kept = [1, 3, *range(9, 15)]
    np.testing.assert_array_equal(some[:, kept], every[:, kept])
    np.testing.assert_array_equal(np.delete(some, kept, axis=1), 0)


def test_rectangle_derivatives_are_those_of_the_projection(camera):
    points = rectangle_corners(0.3, 0.2)
    pose = Pose.from_vectors(np.array([[0.3, 0.5, 0.2], [-0.2, 0.1, 1.0]]), np.array([[0.1, 0, 0.2], [0, 0.2, -0.1]]))

    def pixels(step):
        in_rig = pose.retract(step)[:, None].transform(points)
        return camera.intrinsics.project(camera.rig_from_camera.inverse().transform(in_rig))

    by_point = camera_derivatives(camera, pose[:, None].transform(points))[2]
    np.testing.assert_allclose(rectangle_derivatives(by_point, pose, points), slopes(pixels, 6), rtol=1e-5, atol=1e-4)


def test_what_nothing_tells_is_no_rounding_turned_over():
    """Rows of units that are far apart, a frame that nothing tells, and sums that were rounded: what is left of the
    information after more noise was put in is the exact one's, wherever the frame stands."""
    rng = np.random.default_rng(0)
    units = 10.0 ** rng.uniform(-3, 3, 30)
    told, noise = rng.normal(size=(24, 24)), rng.normal(size=(24, 24))
    frame = np.linalg.qr(rng.normal(size=(30, 30)))[0][:, :24]
    exact = told @ told.T
    spread = exact + noise @ noise.T
    rounding = rng.normal(size=(2, 30, 30)) * 3e-14 * np.abs(exact).max()
    seen, widened = (
        (frame @ each @ frame.T + rounded + rounded.T) * units * units[:, None]
        for each, rounded in zip((exact, spread), rounding, strict=True)
    )
    left = (seen @ scaled_inverse(widened) @ seen) / units / units[:, None]
    np.testing.assert_allclose(frame.T @ left @ frame, exact @ np.linalg.inv(spread) @ exact, atol=1e-9 * exact.max())
    np.testing.assert_allclose(left, left.T, atol=1e-9 * exact.max())
