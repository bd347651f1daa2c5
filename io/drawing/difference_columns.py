"""How two rigs differ, camera by camera, as every table of it shows it."""

import numpy as np

from quadrig.rig.comparison import Comparison
from quadrig.rig.words import Column, figure, with_sigma


def difference_columns(found: Comparison) -> list[Column]:
    """The second rig minus the first: focal, shift and turn of each camera beside their sigmas, and all in sigmas."""
    every = found.cameras
    return [
        Column("camera", "", tuple(one.name for one in every), words=True),
        Column("focal", "px", tuple(with_sigma(one.focal, one.focal_sigma, signed=True) for one in every)),
        Column("position", "mm", tuple(with_sigma(1e3 * one.shift, 1e3 * one.shift_sigma) for one in every)),
        Column(
            "rotation",
            "deg",
            tuple(with_sigma(np.degrees(one.rotation), np.degrees(one.rotation_sigma)) for one in every),
        ),
        Column("difference", "sigmas", tuple(figure(one.sigmas, 1) for one in every)),
    ]
