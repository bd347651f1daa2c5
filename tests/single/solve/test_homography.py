"""Homographies: exact for exact points, in batches, with points left out, and nan where there is none."""

import numpy as np
import pytest

from quadrig.single.solve.homography import homographies


def some(count, seed=0):
    rng = np.random.default_rng(seed)
    h = np.tile(np.diag([900.0, 900.0, 1.0]), (count, 1, 1))
    h += rng.normal(size=(count, 3, 3)) * [[100, 100, 300], [100, 100, 300], [0.3, 0.3, 0]]
    return h / h[:, 2:, 2:]


def mapped(h, points):
    q = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1) @ np.swapaxes(h, -1, -2)
    return q[..., :2] / q[..., 2:]


def plane(count, size, seed=1):
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, size, 2))


def test_exact_points_give_the_homography_they_came_from():
    for size in (4, 5, 30):
        truth, points = some(50), plane(50, size)
        np.testing.assert_allclose(
            mapped(homographies(points, mapped(truth, points)), points), mapped(truth, points), atol=1e-5
        )
    np.testing.assert_allclose(homographies(points, mapped(truth, points)), truth, rtol=1e-6, atol=1e-6)


def test_a_point_of_weight_zero_has_no_say():
    truth, points = some(10), plane(10, 12)
    pixels = mapped(truth, points)
    pixels[:, 3] += 500
    weights = np.ones((10, 12))
    weights[:, 3] = 0
    np.testing.assert_allclose(homographies(points, pixels, weights), truth, rtol=1e-6, atol=1e-6)


def test_units_of_the_plane_do_not_matter():
    truth, points = some(5), plane(5, 9)
    pixels = mapped(truth, points) + np.random.default_rng(2).normal(size=(5, 9, 2))
    metres = mapped(homographies(points, pixels), points)
    millimetres = mapped(homographies(1000 * points + 70, pixels), 1000 * points + 70)
    np.testing.assert_allclose(metres, millimetres, atol=1e-6)


def test_the_order_of_the_points_does_not_matter():
    points = plane(5, 9)
    pixels = mapped(some(5), points) + np.random.default_rng(2).normal(size=(5, 9, 2))
    turned = homographies(points[:, ::-1], pixels[:, ::-1])
    np.testing.assert_allclose(turned, homographies(points, pixels), rtol=1e-7, atol=1e-9)


DEGENERATE = {
    "all at one place": lambda points: np.repeat(points[:, :1], 4, axis=1),
    "two at one place": lambda points: points[:, [0, 1, 2, 0]],
    "three on a line": lambda points: np.concatenate([points[:, :3], points[:, :2].mean(1, keepdims=True)], axis=1),
    "four on a line": lambda points: points[:, :1] * (1 - points[..., :1]) + points[:, 1:2] * points[..., :1],
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_points_that_determine_none_cost_only_their_own_answer(name):
    """In a hundred draws: some of their matrices are singular to the last bit, others by rounding only."""
    truth, points = some(100), plane(100, 4)
    pixels, nothing = mapped(truth, points), DEGENERATE[name](points)
    assert np.isnan(homographies(nothing, mapped(truth, nothing))).all()
    found = homographies(np.stack([points, nothing]), np.stack([pixels, mapped(truth, nothing)]))[0]
    np.testing.assert_allclose(mapped(found, points), pixels, atol=1e-5)


@pytest.mark.filterwarnings("error")
def test_neither_lost_nor_lined_up_points_cost_the_others_their_answer():
    square = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    lost = np.full((4, 2), np.nan)
    lined_up = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    found = homographies(np.stack([square, square, lined_up]), np.stack([square, lost, square]))
    np.testing.assert_allclose(found[0], np.eye(3), atol=1e-12)
    assert np.isnan(found[1:]).all()
