"""What arrays hold: the names that stand in every signature."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""Coordinates, transforms, covariances."""

Ints = NDArray[np.integer]
"""Indices, counts, ids, stamps in nanoseconds."""

Mask = NDArray[np.bool_]
"""Which of them."""

Picture = NDArray[np.uint8]
"""Grey (H, W) or BGR (H, W, 3) values of an image."""
