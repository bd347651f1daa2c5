"""Factors of many small matrices at once: those that LAPACK gives one by one."""

import numpy as np
import pytest

from quadrig.single.solve.batched_cholesky import cholesky, inverse, solve


@pytest.mark.parametrize("size", [1, 2, 7, 9])
def test_factor_solution_and_inverse_are_those_of_each_matrix(size):
    rng = np.random.default_rng(size)
    rows = rng.normal(size=(20, 2 * size, size))
    matrices, right = np.swapaxes(rows, 1, 2) @ rows, rng.normal(size=(20, size))
    factor = cholesky(np.moveaxis(matrices, 0, -1))
    np.testing.assert_allclose(np.moveaxis(factor, -1, 0), np.linalg.cholesky(matrices), atol=1e-9)
    expected = np.linalg.solve(matrices, right[..., None])[..., 0]
    np.testing.assert_allclose(solve(factor, right.T).T, expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(np.moveaxis(inverse(factor), -1, 0), np.linalg.inv(matrices), rtol=1e-6, atol=1e-9)


def test_a_matrix_that_is_not_positive_is_nan_and_costs_the_others_nothing():
    good, bad = np.diag([4.0, 9.0]), np.array([[1.0, 2.0], [2.0, 1.0]])
    with np.errstate(invalid="ignore"):
        factor = cholesky(np.stack([good, bad, good], axis=-1))
    assert np.isnan(factor[1, 1, 1])
    np.testing.assert_array_equal(factor[..., 0], np.diag([2.0, 3.0]))
    np.testing.assert_array_equal(factor[..., 2], np.diag([2.0, 3.0]))
