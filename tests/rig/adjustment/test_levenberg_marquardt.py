"""The joint adjustment: derivatives through the whole chain, the Schur complement, bands, and a true minimum."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.adjustment.levenberg_marquardt import adjust, undamped
from quadrig.rig.adjustment.schur import (
    reduced_inverse,
)
from quadrig.rig.adjustment.slack import SlackPrior
from quadrig.rig.adjustment.state import State
from quadrig.rig.problem.build import build_problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single.lens import Intrinsics, project, unproject


@pytest.mark.parametrize("with_slack", [False, True])
def test_where_it_ends_every_direction_leads_up(states, small, with_slack):
    observations, truth = small
    rng = np.random.default_rng(4)
    views = len(observations.camera)
    # The first Views are held to the chain.
    slack = SlackPrior.wide(np.arange(views) >= 3, 0.003) if with_slack else None
    free = states.open_freedom(observations, truth, slack)
    found = adjust(observations, states.shaken(truth, rng), free, 0.3, most_steps=60)
    state = found.state
    assert found.costs[-1] == pytest.approx(states.whole_cost(observations, state, free, 0.3), rel=1e-9)
    assert all(later <= earlier * (1 + 1e-12) for earlier, later in zip(found.costs, found.costs[1:], strict=False))
    if slack is not None:
        assert state.slack is not None
        np.testing.assert_array_equal(state.slack[:3], 0)
        assert np.abs(state.slack[3:]).max() > 0
    here = found.costs[-1]
    for _ in range(8):
        lens = rng.normal(size=state.lens.shape) * free.lens * [0.05, 0.05, 0.05, 1e-4, 1e-4, 0, 0, 0, 0]
        cameras = 2e-5 * rng.normal(size=(len(lens), 6)) * free.pose[:, None]
        nodes = 2e-5 * rng.normal(size=(observations.nodes, 6))
        stray = np.zeros((views, 6))
        if with_slack:
            stray[3:] = 2e-5 * rng.normal(size=(views - 3, 6))

        def at(sign, lens=lens, cameras=cameras, nodes=nodes, stray=stray):
            there = state.moved(sign * lens, sign * cameras, sign * nodes)
            if with_slack:
                there = replace(there, slack=state.slack + sign * stray)
            return states.whole_cost(observations, there, free, 0.3) - here

        ahead, behind = at(1), at(-1)
        assert ahead > 0
        assert behind > 0
        # No slope is left: both sides rise alike but for the third order.
        assert abs(ahead - behind) < 0.05 * (ahead + behind)


def test_a_start_far_away_ends_at_the_same_minimum(states, small):
    observations, truth = small
    free = states.open_freedom(observations, truth)
    near = adjust(observations, truth, free, 0.3)
    held = np.concatenate([np.zeros((1, 6)), np.ones((len(truth.lens) - 1, 6))])
    rng = np.random.default_rng(6)
    start = truth.moved(
        np.array([0.03, 0, 0, 0, 0, 0, 0, 0, 0]) * truth.lens[:, :1],
        0.05 * rng.normal(size=held.shape) * held,
        0.05 * rng.normal(size=(observations.nodes, 6)),
    )
    far = adjust(observations, start, free, 0.3)
    assert far.costs[-1] == pytest.approx(near.costs[-1], rel=1e-9)
    sigma = np.sqrt(np.diagonal(reduced_inverse(undamped(near, free)))).reshape(len(truth.lens), -1)
    assert (np.abs(far.state.lens - near.state.lens)[:, :5] < 1e-2 * sigma[:, :5]).all()


def test_what_is_not_free_does_not_move(states, small):
    observations, truth = small
    free = states.open_freedom(observations, truth)
    state = states.shaken(truth, np.random.default_rng(7))
    found = adjust(observations, state, free, 0.3).state
    np.testing.assert_array_equal(found.lens[:, 5:], state.lens[:, 5:])
    np.testing.assert_array_equal(found.camera_from_rig[0].rotation, state.camera_from_rig[0].rotation)
    np.testing.assert_array_equal(found.camera_from_rig[0].translation, state.camera_from_rig[0].translation)


def test_pinhole_and_fisheye_cameras_are_adjusted_together(states, simulated):
    """One of each: the rig of both is as good as its parts."""
    made = simulated.simulate(8, simulated.Scene(cameras=3, framesets=12))
    # The middle camera becomes a fisheye: its pixels are those that a fisheye of its place would see.
    fisheye = np.array([450.0, 640, 360, 0.02, -0.004, 0, 0, 0, 1.0])

    def as_fisheye(view):
        return replace(view, pixels=project(fisheye, unproject(made.lenses[1], view.pixels), "fisheye"))

    views = [as_fisheye(view) if view.camera == "cam1" else view for view in made.views]
    inputs = list(made.inputs)
    inputs[1] = CameraInput("cam1", 1280, 720, Intrinsics.centred(1280, 720, 400, "fisheye"))
    problem = build_problem(inputs, made.rectangles, views)
    observations, truth = problem.observations(), states.true_state(made, problem)
    truth = State(np.stack([truth.lens[0], fisheye, truth.lens[2]]), truth.camera_from_rig, truth.rig_from_body)
    found = adjust(
        observations, states.shaken(truth, np.random.default_rng(0)), states.open_freedom(observations, truth), 0.3
    )
    assert found.costs[-1] < 2 * 2 * observations.count
    assert np.abs(found.state.lens[:, 0] / truth.lens[:, 0] - 1).max() < 0.01


def test_a_camera_that_nothing_determines_is_not_solved(states, small):
    """All its corners are left out and no prior is given: no damping helps, and there is no covariance."""
    observations, truth = small
    lost = observations.camera == 2
    weights = [np.where(lost[g.view][:, None], 0.0, g.weights) for g in observations.groups]
    without = observations.with_weights(weights)
    free = states.open_freedom(without, truth)
    free.prior_information[2] = 0
    start = states.shaken(truth, np.random.default_rng(8))
    found = adjust(without, start, free, 0.3, most_steps=60)
    assert len(found.costs) == 1
    np.testing.assert_array_equal(found.state.lens, start.lens)
    with pytest.raises(np.linalg.LinAlgError):
        reduced_inverse(undamped(found, free))


def test_costs_fall_to_what_a_looser_end_only_comes_near(states, small):
    observations, truth = small
    free, start = states.open_freedom(observations, truth), states.shaken(truth, np.random.default_rng(9), 0.02)
    rough, fine = (adjust(observations, start, free, 0.3, tolerance=t) for t in (10.0, 1e-6))
    assert len(rough.costs) < len(fine.costs)
    # What a further step was expected to bring is what was given up.
    assert fine.costs[-1] <= rough.costs[-1] < fine.costs[-1] + 20
    assert len(adjust(observations, start, free, 0.3, most_steps=2).costs) == 3
