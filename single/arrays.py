"""What arrays hold: the names that stand in every signature; and their median."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""Coordinates, transforms, covariances."""

Singles = NDArray[np.float32]
"""Light, rays and grey values of whole pictures: single precision is plenty there, and takes half the time."""

Reals = NDArray[np.floating]
"""Values of either precision."""

Ints = NDArray[np.integer]
"""Indices, counts, ids, stamps in nanoseconds."""

Mask = NDArray[np.bool_]
"""Which of them."""

Picture = NDArray[np.uint8]
"""Grey (H, W) or BGR (H, W, 3) values of an image."""


def median(values: "Floats | list[float]") -> float:
    """The median of at least one value; nan where one is nan. numpy's own loads all of numpy.ma when it is first
    called, which takes longer than what a quick command does besides."""
    ordered = np.sort(np.asarray(values, float), axis=None)
    middle = (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2
    return float(middle if ordered[-1] == ordered[-1] else np.nan)
