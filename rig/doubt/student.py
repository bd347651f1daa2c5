"""Intervals where the noise itself is known from few residuals: Student's, not Gauss's."""

# Of the 95 % interval of a Gaussian.
_GAUSS_95 = 1.959964


def student_widening(freedom: float) -> float:
    """What a variance is multiplied by so that 1.96 of its sigmas hold the truth in 95 % where noise rests on so many
    degrees of freedom: the square of Student's quantile over Gauss's (its expansion in 1/freedom; Abramowitz and
    Stegun 26.7.5, good to 1 % from three degrees on)."""
    z = _GAUSS_95
    quantile = z + (z**3 + z) / (4 * freedom) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)
    quantile += (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * freedom**3)
    return (quantile / z) ** 2
