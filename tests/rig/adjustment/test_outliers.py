"""Noise that the data shows, and what does not belong to it."""

import numpy as np
import pytest

from quadrig.rig.adjustment.outliers import find_outliers, robust_noise
from quadrig.rig.problem.build import USUAL_NOISE
from quadrig.rig.problem.observations import Joins, pack

VIEWS, POINTS = 60, 20


@pytest.fixture(scope="module")
def seen():
    """Sixty Views of twenty points, twelve of them with sigmas twice the others' and shares of a half."""
    points, pixels = [np.zeros((POINTS, 3))] * VIEWS, [np.zeros((POINTS, 2))] * VIEWS
    sigma, share = np.ones(VIEWS), np.ones(VIEWS)
    sigma[::5], share[::5] = 2.0, 0.5
    return pack([*points], [*pixels], sigma, share, Joins.alone(np.zeros(VIEWS, int), 1), ["pinhole"]), sigma


def squares_of(sigma, noise, seed=1):
    """Squared lengths (V, P) of Gaussian residuals."""
    residuals = np.random.default_rng(seed).normal(size=(VIEWS, POINTS, 2)) * noise * sigma[:, None, None]
    return (residuals**2).sum(axis=-1)


@pytest.mark.parametrize("noise", [0.1, 0.5])
def test_the_median_tells_the_noise_through_gross_errors(seen, noise):
    observations, sigma = seen
    squares = squares_of(sigma, noise)
    # 1200 squared lengths know a sigma by their median to 2.1 %; three of those.
    assert robust_noise(observations, (squares,)) == pytest.approx(noise, rel=0.065)
    squares[:, 0] = 1e4
    squares[7] = np.nan
    # A twentieth of them far off moves the median by a tenth of a sigma's quartile.
    assert robust_noise(observations, (squares,)) == pytest.approx(noise, rel=0.12)


def test_what_was_fitted_took_its_share_of_the_residuals(seen):
    observations, sigma = seen
    squares = (squares_of(sigma, 0.3),)
    whole = robust_noise(observations, squares)
    coordinates = 2 * observations.count
    assert robust_noise(observations, squares, coordinates / 2) == pytest.approx(whole * np.sqrt(2))
    assert robust_noise(observations, squares, 2 * coordinates) == pytest.approx(whole * np.sqrt(10))
    nothing = observations.with_weights([np.zeros((VIEWS, POINTS))])
    assert robust_noise(nothing, squares) == USUAL_NOISE


def test_corners_beyond_five_sigmas_are_out_and_views_of_many_such(seen):
    observations, _ = seen
    squares = np.zeros((VIEWS, POINTS))
    # A corner of a View whose sigma is twice the others' may stray twice as far.
    squares[1, 4], squares[2, 4] = 4.9**2, 5.1**2
    squares[5, 4], squares[10, 4] = 9.8**2, 10.2**2
    squares[23, :9], squares[21, :10] = 36.0, 36.0
    squares[22, 3] = np.nan
    found = find_outliers(observations, (0.09 * squares,), 0.3)
    out = found.weights[0] == 0
    assert np.flatnonzero(found.rejected).tolist() == [21]
    assert {(int(v), int(p)) for v, p in np.argwhere(out) if v not in (21, 23)} == {(2, 4), (10, 4), (22, 3)}
    assert out[23].sum() == 9
    assert out[21].all()
    np.testing.assert_array_equal(found.weights[0][~out], observations.groups[0].weights[~out])


def test_views_rejected_besides_lose_their_weights(seen):
    observations, _ = seen
    clean = find_outliers(observations, (np.zeros((VIEWS, POINTS)),), 0.3)
    more = np.zeros(VIEWS, bool)
    more[[3, 5]] = True
    less = clean.without(observations, more)
    assert np.flatnonzero(less.rejected).tolist() == [3, 5]
    assert np.flatnonzero((less.weights[0] == 0).all(axis=1)).tolist() == [3, 5]
    assert not less.same_points(clean)
    assert less.same_points(less.without(observations, more))
