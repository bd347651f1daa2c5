"""Numbers in JSON, which has no nan and no infinity: null, and the strings "inf" and "-inf".

A float64 is written with as many digits as bring it back to the last bit.
"""

from collections.abc import Sequence

import numpy as np

from quadrig.single.arrays import Floats

Number = float | str | None


def number(value: float) -> Number:
    """One number as it is written."""
    value = float(value)
    if np.isfinite(value):
        return value
    return None if np.isnan(value) else str(value)


def read_number(held: Number) -> float:
    """One number as it was."""
    return float("nan") if held is None else float(held)


def numbers(values: Floats) -> list:
    """An array of any shape as nested lists."""
    values = np.asarray(values, float)
    if np.isfinite(values).all():
        return values.tolist()
    return np.array([number(value) for value in values.ravel()], object).reshape(values.shape).tolist()


def read_numbers(held: Sequence) -> Floats:
    """The array of nested lists."""
    return np.array(held, float)
