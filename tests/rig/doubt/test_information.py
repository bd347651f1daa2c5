"""The doubt of a rig: it scales with the noise, holds the truth, shrinks with what is seen, and is a covariance."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.rig.doubt.working_accuracy import covered_points, triangulation_shape, working_accuracy
from quadrig.single.pose import Pose, inverse_jacobian


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
    """The lens is told, so that the same numbers are estimated; the same draw of noise, thrice as large."""
    quiet = simulated.simulate(15, simulated.Scene(cameras=3, framesets=16, noise=0.15, principal=0.0))
    loud = simulated.simulate(15, simulated.Scene(cameras=3, framesets=16, noise=0.45, principal=0.0))
    assert len(quiet.views) == len(loud.views)
    rigs = []
    for made in (quiet, loud):
        inputs = [replace(c, lens="f k1 k2") for c in made.inputs]
        rigs.append(calibrate(inputs, made.rectangles, made.views))
    np.testing.assert_allclose(figures(rigs[1]) / figures(rigs[0]), 3.0, rtol=0.05)
    assert rigs[1].working_accuracy / rigs[0].working_accuracy == pytest.approx(3, rel=0.05)


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


def test_the_working_accuracy_is_that_of_triangulated_points(board_rig):
    """Cameras drawn from the covariance triangulate the covered points with the scatter that is told."""
    _, rig = board_rig
    points = covered_points(rig.rectangles)
    seen, moves = triangulation_shape(rig.cameras, points)
    flat = moves.reshape(3 * len(seen), -1)
    joint = flat @ rig.covariance @ flat.T
    blocks = joint.reshape(len(seen), 3, len(seen), 3)[np.arange(len(seen)), :, np.arange(len(seen)), :]
    told = np.sqrt(np.linalg.eigvalsh(blocks)[:, -1].mean())
    assert told == pytest.approx(working_accuracy(rig.cameras, rig.covariance, points), rel=1e-9)
    assert told == pytest.approx(rig.working_accuracy, rel=1e-9)


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
    assert working_accuracy(rig.cameras, common, points) < 1e-9
    both = working_accuracy(rig.cameras, rig.covariance + common, points)
    assert both == pytest.approx(rig.working_accuracy, rel=1e-6)


def test_doubt_moves_with_the_frame(board_rig):
    """cam0 in cam1's frame is as sure as cam1 in cam0's."""
    made, rig = board_rig
    other = calibrate(made.inputs, made.rectangles, made.views, reference="cam1")
    jacobian = inverse_jacobian(rig.camera("cam1").rig_from_camera)
    turned = jacobian @ rig.pose_covariance("cam1") @ jacobian.T
    np.testing.assert_allclose(other.pose_covariance("cam0"), turned, rtol=1e-3, atol=1e-4 * np.abs(turned).max())


def test_points_that_one_camera_sees_cannot_be_triangulated(board_rig):
    _, rig = board_rig
    behind = Pose.identity().transform(np.array([[0.0, 0.0, -5.0], [0.1, 0, -5], [0, 0.1, -5]]))
    assert np.isnan(working_accuracy(rig.cameras, rig.covariance, behind))
