"""How Views are tilted, before any data: people hold a sheet to be seen well, or flat on, and one never knows which.

A rectangle seen flat on shows the same for every focal; what separates focal from distance goes with its tilt.
Left alone, the likeliest tilt of a flat View is a fit to its noise, of a focal far too short; an average over all
tilts, as likely each as the others, calls long focals likelier, under which a tilt would not have been noticed. So
tilts are of an unknown size that all Views of a camera share: where they are no more than noise they say nothing.
"""

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose

# Sizes of the tilts (rad), equally likely: from what no one can see to all directions.
_SIDEWAYS = np.array([1.0, 0.0, 0.0])
_SIZES = np.radians(np.geomspace(0.25, 64.0, 17))


def log_tilt_density(camera_from_rects: Pose, rotation_covariance: Floats) -> Floats:
    """Logarithm of the density (...) per solid angle of the tilts of V Views (..., V), seen with a Gaussian error.

    rotation_covariance (..., V, 3, 3): of the rotation part of the poses' steps.
    """
    normal = camera_from_rects.rotation[..., 2]
    # From the optical axis, not the line of sight: a sheet parallel to the image plane has no perspective anywhere.
    sine = np.hypot(normal[..., 0], normal[..., 1])
    tilt = np.arctan2(sine, normal[..., 2])
    # A View flat on leans no way: any direction across its normal is as good.
    axis = np.where(sine[..., None] > 1e-9, np.stack([-normal[..., 1], normal[..., 0], 0 * sine], axis=-1), _SIDEWAYS)
    axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    across = np.stack([axis, np.cross(normal, axis)], axis=-2)
    spread = across @ rotation_covariance @ np.swapaxes(across, -1, -2)
    spread = spread[..., None, :, :] + (_SIZES**2)[:, None, None] * np.eye(2)
    determinant = spread[..., 0, 0] * spread[..., 1, 1] - spread[..., 0, 1] ** 2
    log = -0.5 * tilt[..., None] ** 2 * spread[..., 1, 1] / determinant - 0.5 * np.log(determinant)
    log = log.sum(axis=-2)
    top = log.max(axis=-1, keepdims=True)
    return top[..., 0] + np.log(np.exp(log - top).sum(axis=-1))
