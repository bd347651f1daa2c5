"""Systematic errors as a border of the reduced system, against all unknowns in one dense system."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quadrig.rig.adjustment.bordered import expand, solve_bordered
from quadrig.rig.adjustment.levenberg_marquardt import adjust
from quadrig.rig.adjustment.motion import CLOCK_INFORMATION
from quadrig.rig.adjustment.normal_equations import residuals
from quadrig.rig.adjustment.schur import reduced_inverse
from quadrig.rig.adjustment.systematic_errors import systematic_errors

NOISE = 0.3
LENS = 5


def weighed_residuals(observations, state):
    """Of all points, over their sigma."""
    parts = []
    for group, missed in zip(observations.groups, residuals(observations, state), strict=True):
        weighted = np.sqrt(group.weights)[..., None] / NOISE * missed
        parts.append(np.where(group.weights[..., None] > 0, weighted, 0.0).ravel())
    return np.concatenate(parts)


def dense_system(errors, observations, state, free):
    """Normal matrix and gradient over lenses and poses of cameras, rectangle poses and errors, by differences."""
    cameras, nodes, count = len(state.lens), observations.nodes, len(errors.held)
    # Steps that move pixels by some thousandths.
    clocks = [] if state.clocks is None else [1e-4, 1e-7]
    size = np.array([1e-2, 1e-2, 1e-2, 1e-5, 1e-5, *[1e-5] * 6, *clocks])
    sizes = np.concatenate([np.tile(size, cameras), np.full(6 * nodes, 1e-5), np.full(count, 1e-4)])
    first, last = cameras * len(size), cameras * len(size) + 6 * nodes

    def at(step):
        by_camera = step[:first].reshape(cameras, len(size))
        lens = np.pad(by_camera[:, :LENS], ((0, 0), (0, 9 - LENS)))
        moved = state.moved(lens, by_camera[:, LENS : LENS + 6], step[first:last].reshape(nodes, 6))
        if state.clocks is not None:
            moved = replace(moved, clocks=state.clocks + by_camera[:, LENS + 6 :])
        return weighed_residuals(errors.corrected(observations, step[last:]), moved)

    jacobian = np.stack(
        [(at(row) - at(-row)) / (2 * s) for row, s in zip(np.diag(sizes), sizes, strict=True)], axis=1
    )
    matrix, gradient = jacobian.T @ jacobian, -jacobian.T @ at(np.zeros(len(sizes)))
    for camera in range(cameras):
        own = slice(camera * len(size), camera * len(size) + LENS)
        prior = free.prior_information[camera, :LENS, :LENS]
        matrix[own, own] += prior
        gradient[own] -= prior @ (state.lens[camera] - free.prior_mean[camera])[:LENS]
        if state.clocks is not None:
            own = camera * len(size) + LENS + 6 + np.arange(2)
            matrix[own, own] += CLOCK_INFORMATION
            gradient[own] -= CLOCK_INFORMATION * state.clocks[camera]
    matrix[last:, last:] += errors.information
    return matrix, gradient, first, last


@pytest.fixture(scope="module", params=["still", "moving"])
def both(request, small, states, simulated):
    observations, truth = small
    if request.param == "moving":
        if observations.groups[0].model == "fisheye":
            pytest.skip("the lens makes no difference to what moves")
        # Slowly, so that nothing turns far between the instants of two clocks.
        truth = states.with_clocks(observations, truth, np.random.default_rng(2), 0.01)
    scene = simulated.Scene(
        cameras=3, framesets=12, tags=1, model=observations.groups[0].model,
        focals=(800, 1000) if observations.groups[0].model == "pinhole" else (400, 500),
    )  # fmt: skip
    problem = states.problem_of(simulated.simulate(3, scene))
    free, errors = states.open_freedom(observations, truth), systematic_errors(problem, observations)
    found = adjust(observations, truth, free, NOISE, most_steps=60)
    there = expand(errors, observations, found.state, free, NOISE, found.tables)
    found, reduced, border = there.adjustment, there.reduced, there.border
    alone = reduced_inverse(reduced)
    values = np.zeros(len(errors.held))
    bordered = solve_bordered(border, errors, values, found, reduced, alone)
    matrix, gradient, first, last = dense_system(errors, observations, found.state, free)
    kept = np.flatnonzero(np.concatenate([reduced.free.ravel(), np.ones(len(matrix) - first, bool)]))
    inverse, step = np.zeros_like(matrix), np.zeros_like(gradient)
    inverse[np.ix_(kept, kept)] = np.linalg.inv(matrix[np.ix_(kept, kept)])
    step[kept] = inverse[np.ix_(kept, kept)] @ gradient[kept]
    return SimpleNamespace(
        found=found, reduced=reduced, alone=alone, bordered=bordered, matrix=matrix, kept=kept, inverse=inverse,
        step=step, first=first, last=last,
    )  # fmt: skip


def close(found, expected, share=3e-3):
    """To a share of what the two numbers' own sizes allow; what turns meanwhile carries its motion along."""
    scale = np.sqrt(np.diagonal(expected))
    np.testing.assert_array_less(np.abs(found - expected), share * np.outer(scale, scale) + 1e-300)


def test_covariances_are_those_of_the_dense_system(both):
    rows = np.r_[: both.first, both.last : len(both.inverse)]
    close(both.bordered.joint_covariance, both.inverse[np.ix_(rows, rows)])
    close(both.bordered.widened(None, None), both.inverse[: both.first, : both.first])
    close(both.bordered.covariance, both.inverse[both.last :, both.last :])


def test_rectangle_poses_gain_what_the_errors_add(both):
    """The dense system with the errors, less that without."""
    without = both.kept[both.kept < both.last]
    inverse = np.zeros((both.last, both.last))
    inverse[np.ix_(without, without)] = np.linalg.inv(both.matrix[np.ix_(without, without)])
    roots = both.bordered.node_roots(both.reduced, slice(0, len(both.reduced.node_inverse)))
    added = roots @ np.swapaxes(roots, -1, -2)
    for node, found in enumerate(added):
        own = slice(both.first + 6 * node, both.first + 6 * node + 6)
        expected = both.inverse[own, own] - inverse[own, own]
        scale = np.sqrt(np.diagonal(both.inverse[own, own]))
        np.testing.assert_array_less(np.abs(found - expected), 1e-3 * np.outer(scale, scale))


def test_the_step_is_that_of_the_dense_system(both):
    sigma = np.sqrt(np.diagonal(both.inverse))
    expected = both.step
    away = (both.bordered.values - expected[both.last :]) / sigma[both.last :]
    assert np.abs(away).max() < 1e-2
    lens = both.bordered.unit_steps[:, :LENS]
    by_camera = expected[: both.first].reshape(len(lens), -1)
    spread = sigma[: both.first].reshape(len(lens), -1)
    assert np.abs((lens - by_camera[:, :LENS]) / spread[:, :LENS]).max() < 1e-2
    # Noise alone moves the errors: there is a step to be compared.
    assert np.abs(expected[both.last :] / sigma[both.last :]).max() > 0.1
    assert 0 < both.bordered.effective < len(both.bordered.values)


def test_a_step_that_is_not_taken_is_in_the_doubt(both):
    """Of cameras, errors and bodies alike, and together: the covariance grows by the step's own square."""
    ended = both.bordered.with_step_in_doubt()
    step = np.concatenate([ended.unit_steps.ravel(), ended.step])
    grown = ended.joint_covariance - both.bordered.joint_covariance
    np.testing.assert_allclose(grown, np.outer(step, step), rtol=1e-6, atol=1e-9)
    every = slice(0, len(both.reduced.node_inverse))
    of_nodes, before = (each.node_roots(both.reduced, every) for each in (ended, both.bordered))
    # The gradient of the bodies themselves is nothing where the adjustment ended: they follow cameras and errors.
    np.testing.assert_allclose(np.abs(of_nodes[..., -1]), np.abs(ended.node_steps), atol=1e-6)
    np.testing.assert_array_equal(of_nodes[..., :-1], before)
    twice = both.bordered.with_step_in_doubt().lens_covariances(both.found)
    own = np.square(both.found.lens_steps(ended.unit_steps))
    grown = np.diagonal(twice - both.bordered.lens_covariances(both.found), axis1=1, axis2=2)
    np.testing.assert_allclose(grown, own, rtol=1e-6, atol=1e-12)
