"""The Cramer-Rao bound: how well any unbiased method could do from given points."""

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose, inverse_jacobian
from quadrig.single.rotation import angles_from_rotation, rotation_from_vector
from quadrig.single.solve.pinhole_model import PinholeViews, covariances, rows, state_of

# Mean absolute value of a normal error of unit sigma.
MEAN_ABSOLUTE = float(np.sqrt(2 / np.pi))
# Step (rad) of the central differences for the paper's angles: errors of its square and of 1e-16 over it both vanish.
_ANGLE_STEP = 1e-5


def cramer_rao(
    points: Floats,
    focal: Floats | float,
    camera_from_rect: Pose,
    principal_point: Floats,
    sigma: Floats | float = 1.0,
    principal_point_sigma: float = 0.0,
    focal_known: bool = False,
) -> Floats:
    """Least covariance (..., 9, 9) of (focal, cx, cy, step of camera_from_rect), px, radians, metres, at a true pose.

    points (..., P, 2 or 3) metres on the rectangle's plane, all seen; focal (...), camera_from_rect (...) and
    principal_point (..., 2) are the truth, and the batch is that of camera_from_rect; sigma: standard deviation of a
    pixel coordinate; principal_point_sigma: of the prior of each coordinate (0: known).
    Source: the inverse of the Fisher information of Gaussian noise (Kay, Estimation Theory, 3.9).
    """
    points = np.asarray(points, float)[..., :2]
    batch = camera_from_rect.translation.shape[:-1]
    start_focal, centre = rows(focal, batch, ()), rows(principal_point, batch, (2,))
    plane = rows(points, batch, points.shape[-2:])
    problem = PinholeViews(
        plane,
        np.zeros((len(plane), 2, 1)),
        centre,
        rows(sigma, batch, ()),
        principal_point_sigma,
        start_focal if focal_known else None,
        photographed=False,
    )
    with np.errstate(all="ignore"):
        covariance = covariances(problem, state_of(start_focal, camera_from_rect, centre, batch))
    return covariance.reshape(*batch, 9, 9)


def paper_sigmas(covariance: Floats, camera_from_rect: Pose) -> Floats:
    """Standard deviations (..., 7) of the paper's T_X, T_Y, T_Z (metres), theta_x, theta_y, theta_z (radians) and f
    (pixels), from a covariance (..., 9, 9) of (focal, cx, cy, step of camera_from_rect)."""
    jacobian = np.zeros((*camera_from_rect.translation.shape[:-1], 7, 9))
    to_paper = inverse_jacobian(camera_from_rect)
    jacobian[..., :3, 3:] = to_paper[..., 3:, :]
    rect_from_camera = camera_from_rect.inverse().rotation
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = _ANGLE_STEP
        ahead = angles_from_rotation(rotation_from_vector(step) @ rect_from_camera)
        behind = angles_from_rotation(rotation_from_vector(-step) @ rect_from_camera)
        for angle in range(3):
            slope = np.sin(ahead[angle] - behind[angle]) / (2 * _ANGLE_STEP)
            jacobian[..., 3 + angle, 3:] += slope[..., None] * to_paper[..., axis, :]
    jacobian[..., 6, 0] = 1
    spread = jacobian @ covariance @ np.swapaxes(jacobian, -1, -2)
    return np.sqrt(np.diagonal(spread, axis1=-2, axis2=-1))
