"""What a printed sheet is beside its rectangle: shapes, their prior, and how far a sheet stands off its plane."""

import numpy as np
import pytest

from quadrig.single.posterior.sheet_shape import SHAPE_PARAMETERS, SheetShape, shape_basis, shape_information
from quadrig.single.rectangle import Rectangle

SHEET = Rectangle("sheet", 0.4, 0.3)


def values(**given):
    return np.array([given.get(name, 0.0) for name in SHAPE_PARAMETERS])


def test_scale_and_stretch_keep_a_sheet_flat():
    shape = SheetShape(values(scale=0.01, stretch=0.01), np.zeros((7, 7)))
    height, sigma = shape.off_plane(SHEET)
    assert height == pytest.approx(0, abs=1e-15)
    assert sigma == pytest.approx(0, abs=1e-15)
    larger = SHEET.corners + np.einsum("pki,k->pi", shape_basis(SHEET, SHEET.corners), values(scale=0.01))
    np.testing.assert_allclose(larger, 1.01 * SHEET.corners, atol=1e-15)
    longer = SHEET.corners + np.einsum("pki,k->pi", shape_basis(SHEET, SHEET.corners), values(stretch=0.01))
    np.testing.assert_allclose(longer, SHEET.corners * [1.01, 0.99, 1], atol=1e-15)


def test_a_bent_sheet_stands_off_by_its_bend():
    """A share of its longer side, between its middle and its ends; known as well as the bend is."""
    covariance = np.zeros((7, 7))
    covariance[2, 2] = 0.001**2
    height, sigma = SheetShape(values(bend_x=0.005), covariance).off_plane(SHEET)
    assert height == pytest.approx(0.005 * SHEET.width)
    assert sigma == pytest.approx(0.001 * SHEET.width)


def test_a_sheet_turned_by_half_a_turn_has_the_same_shape():
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (20, 3)) * [1, 1, 0]
    half_turn = np.array([-1.0, -1.0, 1.0])
    np.testing.assert_allclose(shape_basis(SHEET, points * half_turn), shape_basis(SHEET, points) * half_turn)


def test_many_sheets_of_one_printer_do_not_average_its_scale_away():
    sheets = [Rectangle(f"sheet{n}", 0.2, 0.2, scale_sigma=0.001) for n in range(50)]
    own, common = shape_information(sheets)
    covariance = np.linalg.inv(np.diag(own) - np.outer(common, common))
    scales = covariance[::7, ::7]
    np.testing.assert_allclose(np.sqrt(np.diagonal(scales)), 0.001)
    # Half of the variance is common to all.
    assert np.sqrt(scales.mean()) == pytest.approx(0.001 / np.sqrt(2), rel=0.02)
    assert np.linalg.eigvalsh(covariance).min() > 0
