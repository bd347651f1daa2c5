"""What arrays hold: the names that stand in every signature."""

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
