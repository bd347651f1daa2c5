"""A matrix near its diagonal, once it is ordered: its solution, and its inverse where it has elements."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from quadrig.rig.adjustment.block_band import BlockBand


@pytest.fixture(scope="module")
def chain():
    """A chain of unknowns in a random order, one of which is tied to all; what part of it says; which are free."""
    rng, count = np.random.default_rng(0), 120
    matrix, part = np.diag(np.full(count, 0.1)), np.zeros((count, count))
    for first in range(0, count - 6, 3):
        rows = np.zeros((8, count))
        rows[:, first : first + 6], rows[:, -1] = rng.normal(size=(8, 6)), rng.normal(size=8)
        matrix += rows.T @ rows
        part += rows.T @ rows if first % 2 else 0.0
    order, free = rng.permutation(count), np.ones(count, bool)
    free[[3, 50]] = False
    return matrix[np.ix_(order, order)], part[np.ix_(order, order)], free


def _inverse(matrix, free):
    result = np.zeros_like(matrix)
    result[np.ix_(free, free)] = np.linalg.inv(matrix[np.ix_(free, free)])
    return result


def test_it_solves_as_the_dense_matrix_does(chain):
    matrix, _, free = chain
    band = BlockBand.of(csr_array(matrix), free, np.zeros(len(free), bool))
    # What is tied to all stands by itself, and the blocks are those of the chain.
    assert band.last.shape[1] == 1
    assert band.inverses.shape[2] < 8
    right = np.random.default_rng(1).normal(size=(len(free), 4))
    np.testing.assert_allclose(band.solve(right), _inverse(matrix, free) @ right, atol=1e-12)
    np.testing.assert_allclose(band.solve(right[:, 0]), _inverse(matrix, free) @ right[:, 0], atol=1e-12)


def test_its_inverse_changes_as_the_series_says(chain):
    matrix, part, free = chain
    band = BlockBand.of(csr_array(matrix), free, np.zeros(len(free), bool), csr_array(part), 3)
    row, column = np.nonzero(matrix)
    inverse = _inverse(matrix, free)
    terms = inverse, -inverse @ part @ inverse, inverse @ part @ inverse @ part @ inverse
    for number, expected in enumerate(terms):
        np.testing.assert_allclose(band.elements(row, column, number), expected[row, column], atol=1e-12)
        assert band.times(csr_array(part), number) == pytest.approx(np.trace(expected @ part), rel=1e-9)


def test_elements_far_from_the_diagonal_are_not_made_up(chain):
    matrix, _, free = chain
    band = BlockBand.of(csr_array(matrix), free, np.zeros(len(free), bool))
    with pytest.raises(ValueError, match="not worked out"):
        band.elements(np.arange(len(free))[:, None], np.arange(len(free)))


def test_a_matrix_that_is_not_positive_definite_is_refused(chain):
    matrix, part, free = chain
    with pytest.raises(np.linalg.LinAlgError):
        BlockBand.of(csr_array(matrix - 3 * part), free, np.zeros(len(free), bool))
