"""Each camera by itself: its lens and noise are nearly right, and every View's candidates show its own picture."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.rig.problem.build import build_problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.start.lenses_and_poses import first_cameras
from quadrig.rig.start.together import camera_from_cluster, seen_together
from quadrig.single.lens import Intrinsics, project
from quadrig.single.markings.boards import board_points
from quadrig.single.pose import Pose
from quadrig.single.rectangle import WORLD, Rectangle, rectangle_corners
from quadrig.single.view import View


def problem_of(made, **changes):
    return build_problem([replace(c, **changes) for c in made.inputs], made.rectangles, made.views)


def test_a_camera_by_itself_knows_its_lens_nearly(simulated):
    """Focal, first distortion and noise over twelve rigs whose lenses bend and whose axes stray."""
    focals, bends, noises = [], [], []
    for seed in range(1, 13):
        made = simulated.simulate(seed, simulated.Scene(cameras=3, framesets=20))
        found = first_cameras(problem_of(made))
        focals.append(found.lens[:, 0] / made.lenses[:, 0] - 1)
        bends.append(found.lens[:, 3] - made.lenses[:, 3])
        noises.append(found.noise / made.noise)
    # The pose graph counts on about a per cent; the closed form alone leaves two, and a k1 of 0.05 where it is zero.
    assert np.median(np.abs(focals)) < 0.015
    assert np.median(np.abs(bends)) < 0.035
    assert np.mean(noises) == pytest.approx(1, abs=0.1)


@pytest.fixture(scope="module")
def told(simulated):
    """A rig whose lenses are told and fixed, with hardly any noise; its start and its truth."""
    made = simulated.simulate(3, simulated.Scene(cameras=3, framesets=12, noise=1e-3, tags=3))
    inputs = [
        CameraInput(
            c.name, c.width, c.height, Intrinsics.centred(c.width, c.height, 1.0).with_parameters(lens), fixed=True
        )
        for c, lens in zip(made.inputs, made.lenses, strict=True)
    ]
    return replace(made, inputs=tuple(inputs))


def true_pose(made, view):
    """camera_from_rect."""
    place = made.world_from_rect[view.rectangle]
    place = place if place.translation.ndim == 1 else place[view.frameset]
    return made.world_from_camera[made.index(view.camera)].inverse() @ place


def test_with_lenses_told_the_likeliest_candidates_are_the_poses(told):
    problem = problem_of(told)
    found = first_cameras(problem)
    np.testing.assert_array_equal(found.lens, told.lenses)
    candidates = found.candidates
    first = np.searchsorted(candidates.view, np.arange(len(problem.views)))
    np.testing.assert_array_equal(candidates.view[first], np.arange(len(problem.views)))
    np.testing.assert_array_equal(candidates.cost[first], 0)
    for index, view in enumerate(problem.views):
        step = candidates.camera_from_rect[first[index]].step_to(true_pose(told, view))
        # A thousandth of a pixel at a metre or so.
        assert np.abs(step).max() < 2e-3
    assert (candidates.cost >= 0).all()


def test_doubts_of_candidates_are_what_noise_does(told):
    """Errors of poses by their own covariance, where lenses are told: chi-squares of six numbers."""
    rng, squares = np.random.default_rng(1), []
    for _ in range(3):
        views = [replace(v, pixels=v.pixels + rng.normal(0, 0.3, v.pixels.shape)) for v in told.views]
        problem = build_problem(told.inputs, told.rectangles, views)
        found = first_cameras(problem)
        # Sixteen points a View leave much to its pose: what is left of the noise is told by a median.
        assert found.noise == pytest.approx(0.3, rel=0.2)
        for index, view in enumerate(problem.views):
            rows = np.flatnonzero(found.candidates.view == index)
            step = found.candidates.camera_from_rect[rows].step_to(true_pose(told, view))
            own = np.linalg.inv(found.candidates.covariance[rows])
            # The truth is one of the candidates.
            squares.append(np.einsum("ki,kij,kj->k", step, own, step).min() / 6)
    # Some hundred means of six squares: the median of such a mean is 0.89, give or take a tenth. Boards lose the
    # points beyond sixteen to the thinning, so that their doubts are told larger than they would have to be.
    assert 0.7 < np.median(squares) < 1.2
    assert np.mean(np.array(squares) < 3) > 0.95


def test_each_reading_of_a_board_has_its_candidates(told):
    """Boards that look the same upside down: the pose that goes with each reading shows the same picture."""
    views = [replace(v, alternatives=(v.points * [-1, -1, 1],)) if v.rectangle == "sheet" else v for v in told.views]
    problem = build_problem(told.inputs, told.rectangles, views)
    candidates = first_cameras(problem).candidates
    for index, view in enumerate(problem.views):
        rows = np.flatnonzero((candidates.view == index) & (candidates.cost < 1))
        assert sorted(candidates.reading[rows]) == ([0, 1] if view.rectangle == "sheet" else [0])
        lens = told.lenses[told.index(view.camera)]
        for row in rows:
            points = candidates.camera_from_rect[row].transform(view.readings[candidates.reading[row]])
            np.testing.assert_allclose(project(lens, points), view.pixels, atol=0.05)


def test_what_is_seen_of_a_rectangle_says_where_its_body_is(told):
    surveyed = [
        r if r.moving else replace(r, body=WORLD, body_from_rect=told.world_from_rect[r.name])
        for r in told.rectangles
    ]
    problem = build_problem(told.inputs, surveyed, told.views)
    candidates = first_cameras(problem).candidates
    together = seen_together(problem, candidates, 0)
    pose, rotation, translation = camera_from_cluster(problem, candidates, together.rectangles)
    tags = [index for index, view in enumerate(problem.views) if view.rectangle != "sheet"]
    assert tags
    for index in tags:
        row = np.searchsorted(candidates.view, index)
        camera_from_world = told.world_from_camera[told.index(problem.views[index].camera)].inverse()
        assert np.abs(pose[row].step_to(camera_from_world)).max() < 5e-3
        # The doubt is that of the tag's pose, carried to the world's origin.
        far = candidates.camera_from_rect.translation[row] - pose.translation[row]
        own = candidates.covariance[row]
        assert rotation[row] == pytest.approx(np.sqrt(np.trace(own[:3, :3])), rel=1e-3)
        back = step_by_shift(far)
        moved = np.linalg.inv(back) @ own @ np.linalg.inv(back).T
        assert translation[row] == pytest.approx(np.sqrt(np.trace(moved[3:, 3:])), rel=1e-3)


def step_by_shift(arm):
    """Derivative of the step of a pose by that of one whose frame's origin lies at -arm from its own."""
    result = np.eye(6)
    result[3:, :3] = -np.cross(np.eye(3), arm)
    return result


def test_views_of_a_nearly_flat_sheet_lead_to_no_focal_that_is_sure_and_wrong():
    """By themselves they have focals of five times the true one."""
    rng, points = np.random.default_rng(0), board_points(9, 6, 0.06)
    lens = Intrinsics(1280, 800, 660.0, np.array([640.0, 400.0]), np.array([-0.04, 0.01, 0, 0, 0]))
    turn = 0.026 * rng.normal(size=3)
    views = []
    for frameset in range(24):
        place = Pose.from_vectors(turn, [0.2, 0.15, 0.2] * rng.uniform(-1, 1, 3) + [0, 0, 1.1])
        pixels = lens.project(place.transform(points)) + 0.2 * rng.normal(size=(len(points), 2))
        views.append(View("board", points, pixels, camera="cam", frameset=frameset, sigma=0.2))
    rig = calibrate([CameraInput("cam", 1280, 800)], [Rectangle("board", 0.54, 0.36, moving=True)], views)
    sigma = rig.focal_sigma("cam") / rig.cameras[0].intrinsics.focal
    assert abs(np.log(rig.cameras[0].intrinsics.focal / 660)) < 3 * sigma


def test_views_that_scatter_are_heard_where_they_tell_more_than_what_lenses_have():
    """Five cards seen by a long lens, near their noise: the usual focal, half of it, fits none of them."""
    rng = np.random.default_rng(0)
    lens = Intrinsics(1280, 800, 1900.0, np.array([655.0, 390.0]), np.zeros(5))
    points, views, sheets = rectangle_corners(0.1, 0.07), [], []
    for number in range(5):
        place = Pose.from_vectors(0.7 * rng.uniform(-1, 1, 3), rng.uniform([-0.1, -0.1, 0.6], [0.1, 0.1, 1.0]))
        pixels = lens.project(place.transform(points)) + 0.5 * rng.normal(size=(4, 2))
        views.append(View(f"card{number}", points, pixels, camera="cam", sigma=0.5))
        sheets.append(Rectangle(f"card{number}", 0.1, 0.07))
    found = first_cameras(build_problem([CameraInput("cam", 1280, 800)], sheets, views))
    assert abs(np.log(found.lens[0, 0] / 1900)) < 0.15
