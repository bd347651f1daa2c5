"""The Schur complement and its bands: the same steps and covariances as the whole system solved at once."""

import numpy as np
import pytest

from quadrig.rig.adjustment.normal_equations import linearise, normal_equations
from quadrig.rig.adjustment.schur import (
    band_order,
    block_matrix,
    dense_matrix,
    eliminate,
    node_steps,
    reduced_inverse,
    solve_for,
    solve_units,
)
from quadrig.rig.adjustment.tables import tables_of


def test_the_schur_complement_solves_the_whole_system(states, small):
    observations, truth = small
    state = states.shaken(truth, np.random.default_rng(2))
    tables = tables_of(observations)
    columns = np.array([0, 1, 2, 3])
    normal = normal_equations(observations, tables, state, linearise(observations, state, columns, 0.3).gram)
    free = np.ones((len(state.lens), 10), bool)
    free[0, 4:] = False  # the first camera's pose holds the frame
    free[1, 3] = False
    free_nodes = np.ones(observations.nodes, bool)
    free_nodes[2] = False
    reduced = eliminate(normal, tables, free, free_nodes)
    steps = solve_units(reduced)
    poses = node_steps(normal, tables, reduced, steps)
    matrix, gradient = states.full_system(normal, tables)
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


def test_a_band_solves_as_the_dense_matrix_does(states, simulated):
    made = simulated.ring(40, 3)
    problem = states.problem_of(made)
    observations, state = problem.observations(), states.true_state(made, problem)
    tables, columns = tables_of(observations), np.array([0, 1, 2, 3, 4])
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


@pytest.mark.parametrize("cameras", [3, 80])
def test_a_matrix_of_blocks_is_the_same_dense_and_sparse(cameras):
    rng = np.random.default_rng(1)
    left = np.concatenate([np.arange(cameras), np.arange(cameras - 1)])
    right = np.concatenate([np.arange(cameras), np.arange(1, cameras)])
    blocks = rng.normal(size=(len(left), 6, 6))
    blocks[:cameras] += np.swapaxes(blocks[:cameras], 1, 2).copy()
    found = block_matrix(blocks, left, right, cameras)
    assert isinstance(found, np.ndarray) == (cameras == 3)
    matrix = found if isinstance(found, np.ndarray) else found.toarray()
    np.testing.assert_array_equal(matrix, matrix.T)
    for block, row, column in zip(blocks, left, right, strict=True):
        np.testing.assert_array_equal(matrix[6 * row : 6 * row + 6, 6 * column : 6 * column + 6], block)
    assert np.count_nonzero(matrix) == 36 * (2 * len(left) - cameras)


def test_a_pose_all_of_whose_corners_are_out_changes_nothing(states, small):
    """It stays where it is, and the others' steps and covariance are as if it had never been."""
    observations, truth = small
    state = states.shaken(truth, np.random.default_rng(3))
    tables, columns = tables_of(observations), np.array([0, 3])
    lost = observations.node == 4
    weights = [np.where(lost[g.view][:, None], 0.0, g.weights) for g in observations.groups]
    without = observations.with_weights(weights)
    normal = normal_equations(without, tables, state, linearise(without, state, columns, 0.3).gram)
    free = np.ones((len(state.lens), 8), bool)
    free[0, 2:] = False
    nodes = np.ones(observations.nodes, bool)
    both = [eliminate(normal, tables, free, nodes & (np.arange(len(nodes)) != out)) for out in (-1, 4)]
    steps = [solve_units(reduced) for reduced in both]
    np.testing.assert_allclose(steps[0], steps[1], rtol=1e-9, atol=1e-12)
    poses = node_steps(normal, tables, both[0], steps[0])
    np.testing.assert_array_equal(poses[4], 0)
    # And nothing is told of it.
    assert (np.diagonal(both[0].node_inverse[4]) > 1e6).all()
