"""How large the noise of pixel coordinates is, where residuals are few and something is expected beforehand."""

import numpy as np

EXPECTED_WEIGHT = 6.0
"""Weight of the noise that is expected, in degrees of freedom: it matters where the data has few. A detector's claim,
or a person's, is good to a factor of one and a half or so."""


def noise_of(chi_square: float, freedom: float, expected: float) -> float:
    """Sigma (px) of a coordinate, from a sum of weighted squares (px^2) of so many degrees of freedom.

    expected: px, what it was expected to be; counts as EXPECTED_WEIGHT degrees of freedom."""
    total = chi_square + EXPECTED_WEIGHT * expected**2
    return float(np.sqrt(total / (max(freedom, 0.0) + EXPECTED_WEIGHT)))
