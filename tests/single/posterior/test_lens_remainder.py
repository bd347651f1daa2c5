"""The field that a lens leaves beside its model: its functions, its prior, and the size that Views make likely."""

import numpy as np
import pytest

from quadrig.single.posterior.lens_remainder import (
    degrees_of,
    field_basis,
    learned_variance,
    shares_of,
    usual_variance,
)

WIDTH, HEIGHT = 640, 480


def whole_picture():
    return np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1).reshape(-1, 2).astype(float)


def test_functions_share_nothing_over_the_picture_and_nothing_with_a_shift_or_a_scale():
    pixels, degrees = whole_picture(), degrees_of(1)
    basis = field_basis(degrees, pixels, np.array([WIDTH, HEIGHT])).T
    # Sums over pixels stand for integrals: to a share of the square of a pixel's width.
    np.testing.assert_allclose(basis.T @ basis / len(basis), np.eye(len(degrees)), atol=5e-3)
    affine = np.column_stack([np.ones(len(pixels)), pixels / WIDTH - 0.5])
    assert np.abs(affine.T @ basis / len(basis)).max() < 5e-3


def test_a_corner_outside_of_the_picture_moves_as_its_rim_does():
    far = np.array([[-500.0, 3 * HEIGHT]])
    size, degrees = np.array([WIDTH, HEIGHT]), degrees_of(1)
    rim = np.array([[-0.5, HEIGHT - 0.5]])
    np.testing.assert_allclose(field_basis(degrees, far, size), field_basis(degrees, rim, size))


@pytest.mark.parametrize("cameras", [1, 4, 30, 100, 5000])
def test_more_cameras_have_coarser_fields(cameras):
    degrees = degrees_of(cameras)
    assert 2 * len(degrees) * cameras <= 1200
    assert len(degrees) <= len(degrees_of(max(cameras // 2, 1)))
    assert shares_of(degrees).sum() == pytest.approx(1 if len(degrees) else 0)


def test_the_size_of_a_field_is_learned_where_views_show_it_and_is_the_usual_one_where_not():
    rng, share, count = np.random.default_rng(2), np.tile(shares_of(degrees_of(1)), 2), 30
    true, widths = 0.1, np.full(count, 1280.0)
    field = true * np.sqrt(share) * rng.normal(size=(count, len(share)))
    information = np.tile(np.eye(len(share)) / 0.001**2, (count, 1, 1))
    pull = (field + 0.001 * rng.normal(size=field.shape)) / 0.001**2
    learned = learned_variance(information, pull, share, widths)
    # Of 50 numbers a variance is known to a fifth.
    assert np.median(learned) == pytest.approx(true**2, rel=0.2)
    blind = learned_variance(np.zeros_like(information), np.zeros_like(pull), share, widths)
    np.testing.assert_allclose(blind, usual_variance(widths))
