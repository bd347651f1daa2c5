"""The normal equations: derivatives through the whole chain, and the curvature of the cost."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.adjustment import normal_equations as module
from quadrig.rig.adjustment.levenberg_marquardt import adjust
from quadrig.rig.adjustment.normal_equations import linearise, normal_equations, residual_squares
from quadrig.rig.adjustment.tables import tables_of
from quadrig.single.pose import Pose


@pytest.mark.parametrize("robust", [False, True])
def test_gradients_are_those_of_differences(states, small, robust):
    observations, truth = small
    rng = np.random.default_rng(0)
    state = states.shaken(truth, rng)
    gram = linearise(observations, state, states.EVERY_LENS, 0.4, robust=robust).gram
    normal = normal_equations(observations, tables_of(observations), state, gram)

    def cost(lens, cameras, nodes):
        return linearise(observations, state.moved(lens, cameras, nodes), states.EVERY_LENS, 0.4, robust=robust).cost

    for _ in range(6):
        lens = rng.normal(size=state.lens.shape) * [1, 1, 1, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3]
        cameras, nodes = rng.normal(size=(len(lens), 6)), rng.normal(size=(observations.nodes, 6))
        size = 1e-6
        ahead, behind = [cost(sign * lens, sign * cameras, sign * nodes) for sign in (size, -size)]
        slope = (ahead - behind) / (2 * size)
        # Gradients point down, and are those of half the cost.
        step = np.concatenate([lens, cameras], axis=1)
        analytic = -2 * ((normal.unit_gradient * step).sum() + (normal.node_gradient * nodes).sum())
        scale = 2 * (np.abs(normal.unit_gradient * step).sum() + np.abs(normal.node_gradient * nodes).sum())
        assert slope == pytest.approx(analytic, abs=1e-6 * scale)


def test_the_quadratic_model_is_the_cost_nearby(states, small):
    """At the truth of exact pixels the residuals vanish: there the Gauss-Newton matrix is the whole curvature."""
    observations, truth = small
    rng = np.random.default_rng(1)
    gram = linearise(observations, truth, states.EVERY_LENS, 1.0).gram
    normal = normal_equations(observations, tables_of(observations), truth, gram)
    here = linearise(observations, truth, states.EVERY_LENS, 1.0).cost
    lens, cameras = 1e-5 * rng.normal(size=truth.lens.shape), 1e-5 * rng.normal(size=(len(truth.lens), 6))
    nodes = 1e-5 * rng.normal(size=(observations.nodes, 6))
    step = np.concatenate([lens, cameras], axis=1)
    matrix, gradient = states.full_system(normal, tables_of(observations))
    every = np.concatenate([step.ravel(), nodes.ravel()])
    expected = here - 2 * gradient @ every + every @ matrix @ every
    # What the model leaves out is residual times curvature: a per cent of the quadratic part, where noise is 0.3 px.
    found = linearise(observations, truth.moved(lens, cameras, nodes), states.EVERY_LENS, 1.0).cost
    assert found - here == pytest.approx(expected - here, abs=0.02 * float(every @ matrix @ every))


@pytest.mark.parametrize("clocks", [False, True])
def test_with_priors_and_clocks_too_gradients_are_those_of_the_cost(states, small, clocks):
    observations, truth = small
    rng = np.random.default_rng(3)
    state = states.shaken(truth, rng)
    if clocks:
        state = states.with_clocks(observations, state, rng, 0.1)
    free = replace(states.open_freedom(observations, truth), lens=np.ones(truth.lens.shape, bool))

    def at(lens, cameras, nodes, by):
        there = state.moved(lens, cameras, nodes)
        there = replace(there, clocks=state.clocks + by) if clocks else there
        return adjust(observations, there, free, 0.4, most_steps=0)

    here = at(0, np.zeros((len(truth.lens), 6)), np.zeros((observations.nodes, 6)), 0)
    gradient = here.normal.unit_gradient
    for poses in (0, 0, 0, 1, 1, 1):
        lens = rng.normal(size=state.lens.shape) * [1, 1, 1, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3]
        cameras, nodes = poses * rng.normal(size=(len(lens), 6)), poses * rng.normal(size=(observations.nodes, 6))
        by = states.CLOCK * rng.normal(size=(len(lens), 2))
        size = 1e-6
        ahead, behind = [at(k * lens, k * cameras, k * nodes, k * by).costs[0] for k in (size, -size)]
        step = np.concatenate([lens, cameras, *([by] if clocks else [])], axis=1)
        parts = np.concatenate([(gradient * step).ravel(), (here.normal.node_gradient * nodes).ravel()])
        # A rectangle that is turned is taken to carry its motion along: some mm at two metres.
        # Within a View points go straight on, at the speed of its mean row: 6 ms of some tenths of m/s^2.
        close = (3e-3 if poses else 3e-4) if clocks else 2e-6
        assert (ahead - behind) / (2 * size) == pytest.approx(-2 * parts.sum(), abs=close * np.abs(parts).sum())


def test_priors_of_lenses_and_clocks_have_the_curvature_of_their_cost(states, small):
    """Views of next to no weight leave the priors alone in the cost, which is then a parabola."""
    observations, truth = small
    rng = np.random.default_rng(4)
    state = states.with_clocks(observations, states.shaken(truth, rng), rng, 0.1)
    free = states.open_freedom(observations, truth)

    def at(step):
        there = replace(state, lens=state.lens + step[:, :9], clocks=state.clocks + step[:, 9:])
        return adjust(observations, there, free, 1e12, most_steps=0)

    clocks = np.tile([1, 1e-5], (len(truth.lens), 1))
    step = rng.normal(size=(len(truth.lens), 11)) * np.concatenate([free.lens, clocks], axis=1)
    here = at(0 * step)
    own = np.concatenate([step[:, here.columns], np.zeros((len(step), 6)), step[:, 9:]], axis=1)
    expected = np.einsum("ci,cij,cj->", own, here.normal.units, own)
    ahead, behind = at(step).costs[0], at(-step).costs[0]
    assert (ahead + behind) / 2 - here.costs[0] == pytest.approx(expected)
    assert (ahead - behind) / 4 == pytest.approx(-(here.normal.unit_gradient * own).sum())


@pytest.mark.parametrize("robust", [False, True])
def test_points_behind_a_camera_cost_a_fixed_sum_and_pull_at_nothing(states, small, robust):
    """A View whose rectangle stands behind its camera is as if it were not there, but for its cost."""
    observations, truth = small
    if observations.groups[0].model == "fisheye":
        pytest.skip("a fisheye sees behind itself")
    lost = (
        int(np.flatnonzero(np.bincount(observations.node) == 1)[0])
        if (np.bincount(observations.node) == 1).any()
        else 0
    )
    where = observations.node == lost
    behind = truth.rig_from_body.translation.copy()
    eye = truth.camera_from_rig.inverse()[observations.camera[where][0]]
    behind[lost] = eye.translation - 2 * eye.rotation[:, 2]
    state = replace(truth, rig_from_body=Pose(truth.rig_from_body.rotation, behind))
    found = linearise(observations, state, states.EVERY_LENS, 0.4, robust=robust)
    blind = np.array([not np.isfinite(square).any() for square in _by_view(observations, found.squares)])
    assert blind.any()
    np.testing.assert_array_equal(found.gram[blind], 0)
    kept = observations.with_weights([np.where(blind[g.view][:, None], 0.0, g.weights) for g in observations.groups])
    without = linearise(kept, state, states.EVERY_LENS, 0.4, robust=robust)
    np.testing.assert_allclose(found.gram[~blind], without.gram[~blind], rtol=1e-12)
    points = sum((group.weights[blind[group.view]] > 0).sum() for group in observations.groups)
    # More than any point before a camera can cost under Cauchy's loss, and the same for each.
    each = (found.cost - without.cost) / points
    assert each == pytest.approx(2.385**2 * np.log1p((300 / 2.385) ** 2), rel=0.01)


def _by_view(observations, squares):
    """The squared residuals of the points of each View that carry weight."""
    result = [np.zeros(0)] * len(observations.camera)
    for group, square in zip(observations.groups, squares, strict=True):
        for row, view in enumerate(group.view):
            result[view] = square[row][group.weights[row] > 0]
    return result


def test_parts_at_a_time_give_the_same_sums(states, small, monkeypatch):
    observations, truth = small
    state = states.shaken(truth, np.random.default_rng(5))
    whole = linearise(observations, state, states.EVERY_LENS, 0.4, robust=True)
    monkeypatch.setattr(module, "_AT_ONCE", 100)
    parts = linearise(observations, state, states.EVERY_LENS, 0.4, robust=True)
    np.testing.assert_allclose(parts.gram, whole.gram, rtol=1e-12)
    assert parts.cost == pytest.approx(whole.cost, rel=1e-12)
    for one, other, alone in zip(parts.squares, whole.squares, residual_squares(observations, state), strict=True):
        np.testing.assert_array_equal(one, other)
        np.testing.assert_allclose(alone, other, rtol=1e-6, atol=1e-12)


def test_weights_of_corners_count_as_often_as_they_say(states, small):
    """A corner of weight four is four corners; one of none is not there; the noise scales all alike."""
    observations, truth = small
    state = states.shaken(truth, np.random.default_rng(6))
    rng = np.random.default_rng(7)
    weights = [g.weights * rng.choice([0.0, 1.0, 4.0], g.weights.shape) for g in observations.groups]
    found = linearise(observations.with_weights(weights), state, states.EVERY_LENS, 0.5)
    ones, fours = (
        [np.where(w == k * g.weights, g.weights, 0.0) for w, g in zip(weights, observations.groups, strict=True)]
        for k in (1, 4)
    )
    parts = [linearise(observations.with_weights(w), state, states.EVERY_LENS, 1.0) for w in (ones, fours)]
    np.testing.assert_allclose(found.gram, 4 * (parts[0].gram + 4 * parts[1].gram), rtol=1e-9, atol=1e-6)
    assert found.cost == pytest.approx(4 * (parts[0].cost + 4 * parts[1].cost))
