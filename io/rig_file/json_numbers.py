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


def read_numbers(held: Sequence, *shape: int) -> Floats:
    """The array of nested lists, of this shape where one is given; -1: as many as there are, none too.

    Raises ValueError where they have another.
    """
    values = np.array(held, float)
    if not values.size and (-1 in shape or 0 in shape):
        values = values.reshape([max(count, 0) for count in shape])
    wanted = tuple(values.shape[axis] if n == -1 and axis < values.ndim else n for axis, n in enumerate(shape))
    if shape and wanted != values.shape:
        raise ValueError(f"numbers of shape {values.shape} where {shape} are meant")
    return values
