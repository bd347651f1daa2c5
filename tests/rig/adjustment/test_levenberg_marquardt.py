"""The joint adjustment: derivatives through the whole chain, the Schur complement, bands, and a true minimum."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.adjustment.levenberg_marquardt import adjust, undamped, with_noise
from quadrig.rig.adjustment.normal_equations import State
from quadrig.rig.adjustment.schur import (
    reduced_inverse,
)
from quadrig.rig.adjustment.slack import SlackPrior
from quadrig.rig.problem.build import build_problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single.lens import Intrinsics, project, unproject
from quadrig.single.pose import Pose

EVERY_LENS = np.arange(9)


def problem_of(made):
    return build_problem(made.inputs, made.rectangles, made.views)


def true_state(made, problem):
    """The truth, the world being the rig frame."""
    order = [made.index(camera.name) for camera in problem.cameras]
    poses = [
        made.world_from_rect[node.rectangle]
        if node.frameset < 0
        else made.world_from_rect[node.rectangle][node.frameset]
        for node in problem.nodes
    ]
    nodes = Pose(np.stack([p.rotation for p in poses]), np.stack([p.translation for p in poses]))
    return State(made.lenses[order], made.world_from_camera.inverse()[np.array(order)], nodes)


def shaken(state, rng, size=1e-3):
    cameras, nodes = len(state.lens), len(state.rig_from_rect.translation)
    lens = rng.normal(size=(cameras, 9)) * [5, 2, 2, 0.01, 0.005, 1e-3, 1e-3, 0.002, 1e-3]
    return state.moved(lens, size * rng.normal(size=(cameras, 6)), size * rng.normal(size=(nodes, 6)))


@pytest.fixture(scope="module", params=["pinhole", "fisheye"])
def small(request, simulated):
    scene = simulated.Scene(
        cameras=3, framesets=12, tags=1, model=request.param,
        focals=(800, 1000) if request.param == "pinhole" else (400, 500),
    )  # fmt: skip
    made = simulated.simulate(3, scene)
    problem = problem_of(made)
    return problem.observations(), true_state(made, problem)


@pytest.mark.parametrize("robust", [False, True])
def test_gradients_are_those_of_differences(small, robust):
    observations, truth = small
    rng = np.random.default_rng(0)
    state = shaken(truth, rng)
    gram = linearise(observations, state, EVERY_LENS, 0.4, robust=robust).gram
    normal = normal_equations(observations, layout(observations), state, gram)

    def cost(lens, cameras, nodes):
        return linearise(observations, state.moved(lens, cameras, nodes), EVERY_LENS, 0.4, robust=robust).cost

    for _ in range(6):
        lens = rng.normal(size=state.lens.shape) * [1, 1, 1, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3]
        cameras, nodes = rng.normal(size=(len(lens), 6)), rng.normal(size=(observations.nodes, 6))
        size = 1e-6
        ahead, behind = [cost(sign * lens, sign * cameras, sign * nodes) for sign in (size, -size)]
        slope = (ahead - behind) / (2 * size)
        # Gradients point down, and are those of half the cost.
        step = np.concatenate([lens, cameras], axis=1)
        analytic = -2 * ((normal.camera_gradient * step).sum() + (normal.node_gradient * nodes).sum())
        scale = 2 * (np.abs(normal.camera_gradient * step).sum() + np.abs(normal.node_gradient * nodes).sum())
        assert slope == pytest.approx(analytic, abs=1e-6 * scale)


def test_the_quadratic_model_is_the_cost_nearby(small):
    """At the truth of exact pixels the residuals vanish: there the Gauss-Newton matrix is the whole curvature."""
    observations, truth = small
    rng = np.random.default_rng(1)
    gram = linearise(observations, truth, EVERY_LENS, 1.0).gram
    normal = normal_equations(observations, layout(observations), truth, gram)
    here = linearise(observations, truth, EVERY_LENS, 1.0).cost
    lens, cameras = 1e-5 * rng.normal(size=truth.lens.shape), 1e-5 * rng.normal(size=(len(truth.lens), 6))
    nodes = 1e-5 * rng.normal(size=(observations.nodes, 6))
    step = np.concatenate([lens, cameras], axis=1)
    matrix, gradient = full_system(normal, layout(observations))
    every = np.concatenate([step.ravel(), nodes.ravel()])
    expected = here - 2 * gradient @ every + every @ matrix @ every
    # What the model leaves out is residual times curvature: a per cent of the quadratic part, where noise is 0.3 px.
    found = linearise(observations, truth.moved(lens, cameras, nodes), EVERY_LENS, 1.0).cost
    assert found - here == pytest.approx(expected - here, abs=0.02 * float(every @ matrix @ every))


def full_system(normal, tables):
    """The normal equations before any elimination."""
    cameras, size = normal.camera_gradient.shape
    nodes = len(normal.node_gradient)
    total = cameras * size + 6 * nodes
    matrix = np.zeros((total, total))
    for c in range(cameras):
        matrix[c * size : (c + 1) * size, c * size : (c + 1) * size] = normal.cameras[c]
    for n in range(nodes):
        place = cameras * size + 6 * n
        matrix[place : place + 6, place : place + 6] = normal.nodes[n]
    for pair, (n, c) in enumerate(zip(tables.pair_node, tables.pair_camera, strict=True)):
        rows, columns = slice(c * size, (c + 1) * size), slice(cameras * size + 6 * n, cameras * size + 6 * n + 6)
        matrix[rows, columns] = normal.pairs[pair]
        matrix[columns, rows] = normal.pairs[pair].T
    return matrix, np.concatenate([normal.camera_gradient.ravel(), normal.node_gradient.ravel()])


def test_the_schur_complement_solves_the_whole_system(small):
    observations, truth = small
    state = shaken(truth, np.random.default_rng(2))
    tables = layout(observations)
    columns = np.array([0, 1, 2, 3])
    normal = normal_equations(observations, tables, state, linearise(observations, state, columns, 0.3).gram)
    free = np.ones((len(state.lens), 10), bool)
    free[0, 4:] = False  # the first camera's pose holds the frame
    free[1, 3] = False
    free_nodes = np.ones(observations.nodes, bool)
    free_nodes[2] = False
    reduced = eliminate(normal, tables, free, free_nodes)
    steps = solve_cameras(reduced)
    poses = node_steps(normal, tables, reduced, steps)
    matrix, gradient = full_system(normal, tables)
    every = np.concatenate([free.ravel(), np.repeat(free_nodes, 6)])
    inverse = np.linalg.inv(matrix[np.ix_(every, every)])
    expected = np.zeros(len(every))
    expected[every] = inverse @ gradient[every]
    found = np.concatenate([steps.ravel(), poses.ravel()])
    sigma = np.zeros(len(every))
    sigma[every] = np.sqrt(np.diagonal(inverse))
    # A step is right to a millionth of its own sigma; what is not free does not move at all.
    np.testing.assert_array_less(np.abs(found - expected)[every], 1e-6 * sigma[every])
    np.testing.assert_array_equal(found[~every], 0)
    covariance = np.zeros((len(every), len(every)))
    covariance[np.ix_(every, every)] = inverse
    count = free.size
    scale = np.where(sigma > 0, sigma, 1)[:count]
    difference = (reduced_inverse(reduced) - covariance[:count, :count]) / np.outer(scale, scale)
    np.testing.assert_allclose(difference, 0, atol=1e-6)


def test_a_band_solves_as_the_dense_matrix_does(simulated):
    made = simulated.ring(40, 3)
    problem = problem_of(made)
    observations, state = problem.observations(), true_state(made, problem)
    tables, columns = layout(observations), np.array([0, 1, 2, 3, 4])
    normal = normal_equations(observations, tables, state, linearise(observations, state, columns, 0.3).gram)
    free = np.ones((40, 11), bool)
    free[5, 5:] = False
    reduced = eliminate(normal, tables, free, np.ones(observations.nodes, bool), damping=1e-3)
    assert band_order(reduced) is not None
    matrix = dense_matrix(reduced)
    right = np.where(free, reduced.gradient, 0).ravel()
    dense = np.linalg.solve(matrix, right)
    sigma = np.sqrt(np.diagonal(np.linalg.inv(matrix)))
    np.testing.assert_array_less(np.abs(solve_for(reduced, right) - dense), 1e-6 * sigma)
    both = np.stack([right, -2 * right], axis=1)
    np.testing.assert_array_less(np.abs(solve_for(reduced, both)[:, 1] + 2 * dense), 2e-6 * sigma)


def open_freedom(observations, state, slack=None):
    cameras = len(state.lens)
    lens = np.zeros((cameras, 9), bool)
    lens[:, :5] = True
    # A principal point known to 20 px, and radial terms that belong together.
    information = np.zeros((cameras, 9, 9))
    information[:, [1, 2], [1, 2]] = 1 / 20.0**2
    information[:, 3:5, 3:5] = [[40.0, 30.0], [30.0, 50.0]]
    return FreeParameters(
        lens, np.arange(cameras) > 0, np.ones(observations.nodes, bool), state.lens.copy(), information,
        slack=slack,
    )  # fmt: skip


def whole_cost(observations, state, free, noise):
    cost = linearise(observations, state, EVERY_LENS, noise).cost
    away = (state.lens - free.prior_mean) * free.lens
    cost += np.einsum("ci,cij,cj->", away, free.prior_information, away)
    if state.slack is not None:
        held = np.where(free.slack.loose[:, None], free.slack.information, 0)
        cost += (held * state.slack**2).sum()
    return cost


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
                there = State(there.lens, there.camera_from_rig, there.rig_from_rect, state.slack + sign * stray)
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
    truth = State(np.stack([truth.lens[0], fisheye, truth.lens[2]]), truth.camera_from_rig, truth.rig_from_rect)
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


def test_another_noise_is_the_same_as_having_had_it_from_the_start(states, small):
    observations, truth = small
    free = states.open_freedom(observations, truth)
    found = adjust(observations, truth, free, 0.4)
    moved, anew = with_noise(found, observations, free, 0.4, 0.3), adjust(observations, truth, free, 0.3)
    sigma = np.sqrt(np.diagonal(reduced_inverse(undamped(anew, free)))).reshape(len(truth.lens), -1)
    before, after = (np.abs(f.state.lens - anew.state.lens)[:, :5] / sigma[:, :5] for f in (found, moved))
    # Priors weigh otherwise then: the minimum moves by tenths of a sigma, of which the second order is left.
    assert np.median(after) < 0.2 * np.median(before)
    assert after.max() < 0.05
    once = np.sqrt(np.diagonal(reduced_inverse(undamped(moved, free)))).reshape(len(truth.lens), -1)
    # A third less, as the noise is, and but for the second order.
    np.testing.assert_allclose(once, sigma, rtol=0.02)
    assert moved.linearised.cost == pytest.approx(anew.linearised.cost, rel=1e-4)
