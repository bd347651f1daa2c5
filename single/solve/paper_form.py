"""The closed form as the paper gives it (Eqs. 7-49), its misprints mended: for comparison; closed_form.py is ours.

"Four points: one-pass geometrical camera calibration algorithm". What differs from the print, each checked on exact
corners:
- Eq. 37: T_Z = [H1 f cos(tz) + (K7 - l1) tan(ty) - (K5 - l2) sin(tx)] / [-K6 tan(ty) + K4 sin(tx) - cos(tx)];
- Eq. 36 gives only the size of theta_x: its sign is that of K3 tan(theta_y);
- Eq. 49 leaves theta_z open by 180 degrees: all corners lie in front of the camera;
- theta_z = 0 and 90 degrees, and corners on the principal point's row, divide by zero: the image is rotated about
  the principal point, which changes theta_z by the same angle and nothing else, solved, and rotated back.
What stays singular is the paper's one constraint: where theta_x or theta_y is 0 its focal is 0/0.
"""

from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose
from quadrig.single.rectangle import rectangle_corners
from quadrig.single.rotation import rotation_from_angles
from quadrig.single.solve.corners import check_shape

# The theta_z that images are rotated to, radians: near 45 degrees, where tan and cot are both about one; the others
# serve where one of them puts a corner on the principal point's row.
_TARGETS = np.radians([45.0, 38.0, 52.0, 33.0, 57.0])


@dataclass(frozen=True, eq=False)
class PaperForm:
    """focal (...) px, the paper's angles (...) radians, rect_from_camera, its [R T]; nan where it has no answer."""

    focal: Floats
    theta_x: Floats
    theta_y: Floats
    theta_z: Floats
    rect_from_camera: Pose


def paper_form(
    corners: Floats,
    width: Floats | float,
    height: Floats | float,
    principal_point: Floats,
    photographed: bool = True,
) -> PaperForm:
    """Focal and pose by Eqs. 7-49.

    corners (..., 4, 2) pixels in the order of Eq. 4; sides (...) metres; principal_point (..., 2) pixels;
    photographed: False accepts corners behind the camera, as a formal projection puts them in the image.
    Raises QuadrigError where the corners have another shape.
    """
    corners = check_shape(corners) - np.asarray(principal_point, float)[..., None, :]
    l1, l2 = np.asarray(width, float) / 2, np.asarray(height, float) / 2
    with np.errstate(all="ignore"):
        theta_z = _theta_z(corners)
        rotated, angle = _rotated(corners, theta_z)
        answers = [_solve(rotated, l1, l2, theta_z + angle + half) for half in (0.0, np.pi)]
        in_front = [(_depths(answer, l1, l2) > 0).sum(axis=-1) for answer in answers]
        second = in_front[1] > in_front[0]
        focal, tx, ty, tz, T = (
            np.where(second[(...,) + (None,) * (a.ndim - second.ndim)], b, a) for a, b in zip(*answers, strict=True)
        )
        if photographed:
            focal = np.where(np.maximum(*in_front) == 4, focal, np.nan)
    tz = np.remainder(tz - angle + np.pi, 2 * np.pi) - np.pi
    return PaperForm(focal, tx, ty, tz, Pose(rotation_from_angles(tx, ty, tz), T))


def _theta_z(corners: Floats) -> Floats:
    """Eqs. 45-49 with both sides multiplied by the B_j and y_j that the quotients share."""
    (x1, y1), (x2, y2), (x3, y3), (x4, y4) = (np.moveaxis(corners[..., k, :], -1, 0) for k in range(4))
    m1, m2 = x1 * y2 - x2 * y1, x3 * y4 - x4 * y3
    m3 = m1 * (y4 - y3) + m2 * (y1 - y2)
    m4 = m1 * (x3 - x4) + m2 * (x2 - x1)
    return np.arctan2(m3, m4)


def _rotated(corners: Floats, theta_z: Floats) -> tuple[Floats, Floats]:
    """The corners rotated about the principal point so that theta_z is near 45 degrees, and the angle added to it."""
    angles = _TARGETS - theta_z[..., None]
    cosine, sine = np.cos(angles)[..., None], np.sin(angles)[..., None]
    x, y = corners[..., None, :, 0], corners[..., None, :, 1]
    # P_cam = Rz^T ...: a larger theta_z rotates the image the other way.
    candidates = np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=-1)
    size = np.abs(candidates)
    clearance = np.minimum(size[..., 0], size[..., 1]).min(axis=-1)
    best = np.argmax(clearance, axis=-1)[..., None]
    picked = np.take_along_axis(candidates, best[..., None, None], axis=-3)[..., 0, :, :]
    return picked, np.take_along_axis(angles, best, axis=-1)[..., 0]


def _solve(corners: Floats, l1: Floats, l2: Floats, theta_z: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Steps 4 to 11 of the paper's section 3: f, theta_x, theta_y, theta_z, T (..., 3)."""
    g = np.moveaxis(corners[..., 0], -1, 0)
    B = g / np.moveaxis(corners[..., 1], -1, 0)  # Eq. 7
    tangent = np.tan(theta_z)
    D1, D2, D3, D4 = (B / tangent - 1) / (-1 - B * tangent)  # Eqs. 11-12: D_2j / D_1j
    Q1, Q2 = D1 - D2 - D3 + D4, D1 - D2 + D3 - D4  # Eqs. 17-18
    K1 = Q1 / Q2
    K2 = 4 * l1 / (l2 * (K1**2 - 1) * Q2)
    K3 = -K2 / 2 * (D3 + D2) - K1 * K2 / 2 * (D3 - D2)
    K5 = l2 * K1
    K7 = l2 / 2 * (K2 * (D1 - D3) - K1 * (2 * K3 + K2 * (D1 + D3)))
    upper, lower = l2 * (K2 + K3) * (1 - K1) - K7, l2 * (K2 + K3) * (-1 - K1) - K7
    H1, H2, H3 = (l1 + upper) / g[0], (-l1 + upper) / g[1], (-l1 + lower) / g[2]  # Eqs. 31, 32, 38
    cosine = np.cos(theta_z)
    focal = np.sqrt(-4 * l1 * l2 * K3 / ((H1 - H2) * (H2 - H3) * cosine**2))  # Eq. 41
    theta_y = np.arctan((H1 - H2) * focal * cosine / (2 * l1))  # Eq. 35
    size = np.arccos(np.clip(K2 * np.cos(theta_y) * cosine / np.sin(theta_z), -1, 1))  # Eq. 36
    theta_x = size * np.where(K3 * np.tan(theta_y) < 0, -1.0, 1.0)
    sine_x, tangent_y = np.sin(theta_x), np.tan(theta_y)
    K4 = -np.tan(theta_x)
    K6 = K3 * (1 / np.tan(theta_x) + np.tan(theta_x))
    numerator = H1 * focal * cosine + (K7 - l1) * tangent_y - (K5 - l2) * sine_x  # Eq. 37, mended
    T_Z = numerator / (-K6 * tangent_y + K4 * sine_x - np.cos(theta_x))
    T = np.stack([K6 * T_Z + K7, K4 * T_Z + K5, T_Z], axis=-1)  # Eqs. 26, 29
    return focal, theta_x, theta_y, theta_z, T


def _depths(answer: tuple[Floats, Floats, Floats, Floats, Floats], l1: Floats, l2: Floats) -> Floats:
    """Depths (..., 4) of the corners in the camera's frame, by Eq. 5."""
    _, theta_x, theta_y, theta_z, T = answer
    axis = rotation_from_angles(theta_x, theta_y, theta_z)[..., :, 2]
    offsets = rectangle_corners(2 * l1, 2 * l2) - T[..., None, :]
    return (offsets * axis[..., None, :]).sum(axis=-1)
