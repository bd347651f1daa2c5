"""The noise of pixels between what was expected and what residuals show."""

import numpy as np
import pytest

from quadrig.single.posterior.noise import EXPECTED_WEIGHT, noise_of


@pytest.mark.parametrize("usual", [0.1, 0.3, 2.0])
def test_noise_is_what_the_data_shows_and_the_usual_one_where_there_is_none(usual):
    assert noise_of(0.0, 0.0, usual) == pytest.approx(usual)
    assert noise_of(0.0, -3.0, usual) == pytest.approx(usual)
    # Data that show the usual noise change nothing, however many.
    assert noise_of(50 * usual**2, 50, usual) == pytest.approx(usual)
    assert noise_of(1e6 * 0.7**2, 1e6, usual) == pytest.approx(0.7, rel=1e-4)
    # Numbers of twice the noise, as many as what was known before counts for, weigh as much as that.
    assert noise_of(EXPECTED_WEIGHT * (2 * usual) ** 2, EXPECTED_WEIGHT, usual) == pytest.approx(usual * np.sqrt(2.5))
