"""Student's interval over Gauss's, held against scipy's own quantiles."""

import pytest
from scipy.stats import norm, t

from quadrig.rig.doubt.student import student_widening


@pytest.mark.parametrize("freedom", [6, 8, 15, 60, 1e5])
def test_the_widening_is_that_of_the_quantiles(freedom):
    exact = (t.ppf(0.975, freedom) / norm.ppf(0.975)) ** 2
    assert student_widening(freedom) == pytest.approx(exact, rel=0.01)
