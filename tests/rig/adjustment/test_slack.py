"""Views out of step: slack of moving rectangles leaves lenses and places true, and is eliminated exactly."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.adjustment.slack import SlackPrior, eliminate_slack, learned, slack_steps, strays
from quadrig.rig.calibration import calibrate
from quadrig.single.lens import project


def random_grams(rng, views=5, lens=3):
    rows = rng.normal(size=(views, 40, lens + 7))
    return np.swapaxes(rows, -1, -2) @ rows


def test_eliminated_slack_is_the_slack_of_the_whole_system():
    """One View by itself: lens, pose and slack solved together, or slack eliminated and found afterwards."""
    rng = np.random.default_rng(0)
    gram, slack = random_grams(rng, 1), 0.1 * rng.normal(size=(1, 6))
    information = np.full((1, 6), 30.0)
    held = np.diag(information[0])
    pose = slice(3, 9)
    # Both the chained pose and the slack move the same six columns; a little prior keeps the pose from drifting.
    prior = 5.0 * np.eye(9)
    whole = np.block([[gram[0, :9, :9] + prior, gram[0, :9, pose]], [gram[0, pose, :9], gram[0, pose, pose] + held]])
    right = np.concatenate([gram[0, :9, -1], gram[0, pose, -1] - held @ slack[0]])
    expected = np.linalg.solve(whole, right)
    eliminated = eliminate_slack(gram, slack, information)
    steps = np.linalg.solve(eliminated.gram[0, :9, :9] + prior, eliminated.gram[0, :9, -1])
    np.testing.assert_allclose(steps, expected[:9], atol=1e-10)
    np.testing.assert_allclose(slack_steps(eliminated, np.asarray(steps[None], float))[0], expected[9:], atol=1e-10)


def test_infinite_information_leaves_a_view_as_it_is():
    gram = random_grams(np.random.default_rng(1))
    information = np.full((5, 6), 10.0)
    information[2] = np.inf
    eliminated = eliminate_slack(gram, np.zeros((5, 6)), information)
    np.testing.assert_array_equal(eliminated.gram[2], gram[2])
    np.testing.assert_array_equal(slack_steps(eliminated, np.ones((5, 9)))[2], 0)
    loose = np.all(np.isfinite(information), axis=1)
    prior = learned(np.zeros((5, 6)), np.ones((5, 6)), SlackPrior.wide(loose, 0.3))
    assert np.isinf(prior.information[2]).all()
    assert np.isfinite(prior.information[loose]).all()
    assert not strays(np.zeros((5, 6)), prior).any()


def test_the_width_of_the_slack_is_learned():
    """Slack drawn from a width, known exactly: rounds of learning end at that width, wherever they begin."""
    rng = np.random.default_rng(2)
    slack = rng.normal(size=(4000, 6)) * [0.01, 0.01, 0.01, 0.03, 0.03, 0.03]
    ends = []
    for first in (0.1, 0.001):
        prior = SlackPrior.wide(np.ones(4000, bool), first)
        for _ in range(60):
            prior = learned(slack, np.zeros((4000, 6)), prior)
        ends.append(1 / np.sqrt(prior.precision))
    np.testing.assert_allclose(ends[0], ends[1], rtol=0.02)
    # Student's t lets the bulk have a little less than its Gaussian width.
    assert (ends[0][:3] > 0.006).all()
    assert (ends[0][:3] < 0.012).all()
    np.testing.assert_allclose(ends[0][3:] / ends[0][:3], 3, rtol=0.1)


def test_a_view_far_beyond_the_others_is_a_stray():
    rng = np.random.default_rng(3)
    slack = 0.01 * rng.normal(size=(50, 6))
    slack[7] = 0.5
    assert np.flatnonzero(strays(slack, SlackPrior.wide(np.ones(50, bool), 0.01))).tolist() == [7]


@pytest.fixture(scope="module", params=[51, 53])
def out_of_step(request, simulated):
    """Each camera sees the moving sheet where it was a moment before or after: by millimetres and milliradians."""
    made = simulated.simulate(request.param, simulated.Scene(cameras=3, framesets=40, tags=2, noise=0.2))
    rng = np.random.default_rng(4)
    views = []
    for view in made.views:
        place = made.world_from_rect[view.rectangle]
        if view.rectangle == "sheet":
            step = np.concatenate([0.004 * rng.normal(size=3), 0.006 * rng.normal(size=3)])
            place = place[view.frameset].retract(step)
        index = made.index(view.camera)
        located = (made.world_from_camera[index].inverse() @ place).transform(view.points)
        seen = project(made.lenses[index], located) + made.noise * rng.normal(size=(len(located), 2))
        views.append(replace(view, pixels=seen))
    return replace(made, views=tuple(views))


def test_views_out_of_step_leave_the_lenses_true(out_of_step):
    rig = calibrate(out_of_step.inputs, out_of_step.rectangles, out_of_step.views)
    assert len(rig.cameras) == 3
    # The noise is that of the corners, not of the wandering sheet.
    assert rig.noise == pytest.approx(out_of_step.noise, rel=0.2)
    for camera in rig.cameras:
        error = camera.intrinsics.focal - out_of_step.lenses[out_of_step.index(camera.name), 0]
        assert abs(error) < 4.5 * rig.focal_sigma(camera.name)
        assert abs(error) < 0.01 * camera.intrinsics.focal
    assert sum(bool(fit.rejected) for fit in rig.fits) < 0.05 * len(rig.fits)


def test_the_places_of_cameras_are_as_sure_as_the_views_allow(out_of_step):
    rig = calibrate(out_of_step.inputs, out_of_step.rectangles, out_of_step.views)
    for camera in rig.cameras:
        if camera.name != rig.reference:
            step = camera.rig_from_camera.step_to(out_of_step.rig_from_camera(rig.reference, camera.name))
            covariance = rig.pose_covariance(camera.name)
            assert np.sqrt(step @ np.linalg.solve(covariance, step) / 6) < 2.5
    # What the rig says of a picture misses by how far the sheet strayed: told, not hidden.
    assert rig.rms > 3 * rig.noise


def test_views_in_step_get_no_slack(board_rig):
    made, rig = board_rig
    assert rig.rms < 1.6 * rig.noise
    sheet = next(r for r in rig.rectangles if r.name == "sheet")
    assert len(sheet.framesets) == len({v.frameset for v in made.views if v.rectangle == "sheet"})
