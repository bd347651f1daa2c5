"""Rotations as arrays: rotation vectors, quaternions and the paper's three angles, all in batches."""

import numpy as np

from quadrig.single.arrays import Floats

# Below this angle (rad) the series of sin(x)/x and (1-cos x)/x^2 is exact to the last bit at two terms.
_SMALL_ANGLE = 1e-4


def cross_matrix(v: Floats) -> Floats:
    """Matrix [v]x with [v]x w = v x w. Shapes (..., 3) -> (..., 3, 3)."""
    v = np.asarray(v, float)
    result = np.zeros((*v.shape, 3))
    result[..., 0, 1], result[..., 0, 2] = -v[..., 2], v[..., 1]
    result[..., 1, 0], result[..., 1, 2] = v[..., 2], -v[..., 0]
    result[..., 2, 0], result[..., 2, 1] = -v[..., 1], v[..., 0]
    return result


def rotation_from_vector(vector: Floats) -> Floats:
    """Rotation matrix of a rotation vector in radians (Rodrigues). Shapes (..., 3) -> (..., 3, 3)."""
    vector = np.asarray(vector, float)
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    small = angle < _SMALL_ANGLE
    safe = np.where(small, 1.0, angle)
    square = angle * angle
    sine = np.where(small, 1 - square / 6, np.sin(safe) / safe)
    versine = np.where(small, 0.5 - square / 24, (1 - np.cos(safe)) / (safe * safe))
    cross = cross_matrix(vector)
    return np.eye(3) + sine * cross + versine * (cross @ cross)


def vector_from_rotation(rotation: Floats) -> Floats:
    """Rotation vector, of angle at most pi, of a rotation matrix. Shapes (..., 3, 3) -> (..., 3).

    Goes through the quaternion, which stays exact near 0 and near pi where the trace does not.
    """
    quaternion = quaternion_from_rotation(rotation)
    imaginary, real = quaternion[..., :3], quaternion[..., 3:]
    sine = np.linalg.norm(imaginary, axis=-1, keepdims=True)
    small = sine < _SMALL_ANGLE
    angle = 2 * np.arctan2(sine, real)
    scale = np.where(small, 2 + sine * sine / 3, angle / np.where(small, 1.0, sine))
    return imaginary * scale


def quaternion_from_rotation(rotation: Floats) -> Floats:
    """Unit quaternion in the order (x, y, z, w) with w >= 0. Shapes (..., 3, 3) -> (..., 4)."""
    r = np.asarray(rotation, float)
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    squares = np.stack([1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz, 1 + xx + yy + zz], axis=-1)
    yz, zx, xy = (
        r[..., 2, 1] + r[..., 1, 2],
        r[..., 0, 2] + r[..., 2, 0],
        r[..., 1, 0] + r[..., 0, 1],
    )
    wx, wy, wz = (
        r[..., 2, 1] - r[..., 1, 2],
        r[..., 0, 2] - r[..., 2, 0],
        r[..., 1, 0] - r[..., 0, 1],
    )
    # Row k is four times component k times the whole quaternion; the row of the largest component divides best.
    rows = np.stack(
        [
            np.stack([squares[..., 0], xy, zx, wx], axis=-1),
            np.stack([xy, squares[..., 1], yz, wy], axis=-1),
            np.stack([zx, yz, squares[..., 2], wz], axis=-1),
            np.stack([wx, wy, wz, squares[..., 3]], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(squares, axis=-1)[..., None, None]
    row = np.take_along_axis(rows, best, axis=-2)[..., 0, :]
    row = row / np.linalg.norm(row, axis=-1, keepdims=True)
    return np.where(row[..., 3:] < 0, -row, row)


def rotation_from_quaternion(quaternion: Floats) -> Floats:
    """Rotation matrix of a quaternion (x, y, z, w) of any length but zero. Shapes (..., 4) -> (..., 3, 3)."""
    q = np.asarray(quaternion, float)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    imaginary, real = q[..., :3], q[..., 3, None, None]
    cross = cross_matrix(imaginary)
    return np.eye(3) + 2 * real * cross + 2 * (cross @ cross)


def rotation_from_angles(theta_x: Floats | float, theta_y: Floats | float, theta_z: Floats | float) -> Floats:
    """R = Rx(theta_x) Ry(theta_y) Rz(theta_z), the paper's Eq. 2; radians. Shapes (...) -> (..., 3, 3)."""
    theta_x, theta_y, theta_z = np.broadcast_arrays(*(np.asarray(a, float) for a in (theta_x, theta_y, theta_z)))
    zero = np.zeros_like(theta_x)
    r_x = rotation_from_vector(np.stack([theta_x, zero, zero], axis=-1))
    r_y = rotation_from_vector(np.stack([zero, theta_y, zero], axis=-1))
    r_z = rotation_from_vector(np.stack([zero, zero, theta_z], axis=-1))
    return r_x @ r_y @ r_z


def angles_from_rotation(rotation: Floats) -> tuple[Floats, Floats, Floats]:
    """The paper's (theta_x, theta_y, theta_z), radians, theta_y in [-pi/2, pi/2]. Shapes (..., 3, 3) -> (...)."""
    r = np.asarray(rotation, float)
    theta_y = np.arctan2(r[..., 0, 2], np.hypot(r[..., 0, 0], r[..., 0, 1]))
    theta_x = np.arctan2(-r[..., 1, 2], r[..., 2, 2])
    theta_z = np.arctan2(-r[..., 0, 1], r[..., 0, 0])
    return theta_x, theta_y, theta_z


def nearest_rotation(matrix: Floats) -> Floats:
    """The rotation nearest to a 3x3 matrix in the Frobenius norm (orthogonal Procrustes). Batched."""
    u, _, vt = np.linalg.svd(matrix)
    sign = np.sign(np.linalg.det(u @ vt))
    u = u.copy()
    u[..., :, 2] *= sign[..., None]
    return u @ vt
