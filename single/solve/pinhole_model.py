"""A rectangle under a pinhole without distortion, laid out for many members at once: batch last, one row a number.

Coordinates of the search, chosen because the picture depends on them almost linearly, down to a view without any
perspective (where focal and distance grow without bound and only their ratio shows):

    u = cx + (u0 + s a) / (1 + kappa c),    v = cy + (v0 + s b) / (1 + kappa c),    (a, b, c) = R (X, Y, 0)

(u0, v0) is the rectangle's middle seen from the principal point, s = f / t_z pixels to the metre, kappa = 1 / t_z.
A negative kappa is the same picture as the rectangle mirrored in depth. A state (12, B) holds u0, v0, s, kappa, cx,
cy and the first two columns of R.
"""

from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats, Ints
from quadrig.single.pose import Pose
from quadrig.single.solve import batched_cholesky as triangular

# Members at a time: the derivatives of four corners at this length fit in a core's second-level cache.
BLOCK = 1024


@dataclass(frozen=True, eq=False)
class PinholeViews:
    """plane and pixels (P, 2, 1 or B), prior centre (2, 1 or B), noise (1 or B), focal (1 or B) where known."""

    plane: Floats
    pixels: Floats
    centre: Floats
    noise: Floats
    centre_sigma: float
    focal: Floats | None
    photographed: bool

    def members(self, index: Ints) -> "PinholeViews":
        def some(rows: Floats) -> Floats:
            return rows if rows.shape[-1] == 1 else rows[..., index]

        focal = None if self.focal is None else some(self.focal)
        return PinholeViews(
            some(self.plane),
            some(self.pixels),
            some(self.centre),
            some(self.noise),
            self.centre_sigma,
            focal,
            self.photographed,
        )


@dataclass(frozen=True, eq=False)
class Projection:
    """What a state shows: points rotated to the camera's axes (3, P, B), residuals over sigma (2, P, B), pixels from
    the principal point (2, P, B), 1 / (1 + kappa c) (P, B) and chi2 (B)."""

    rotated: Floats
    residuals: Floats
    seen: Floats
    shrink: Floats
    chi2: Floats

    def members(self, index: Ints) -> "Projection":
        return Projection(*(getattr(self, name)[..., index] for name in self.__dataclass_fields__))


def rows(value: Floats | float, batch: tuple[int, ...], tail: tuple[int, ...]) -> Floats:
    """The value with its batch last: (*tail, members), or (*tail, 1) where every member shares it."""
    value = np.asarray(value, float)
    if value.ndim > len(tail):
        value = np.broadcast_to(value, (*batch, *tail))
    return np.ascontiguousarray(np.moveaxis(value.reshape(-1, *tail), 0, -1))


def state_of(focal: Floats, camera_from_rect: Pose, centre: Floats, batch: tuple[int, ...]) -> Floats:
    """u0, v0, s, kappa, cx, cy and the rotation's first two columns (12, members)."""
    state = np.empty((12, int(np.prod(batch))))
    translation = rows(camera_from_rect.translation, batch, (3,))
    state[3] = 1 / translation[2]
    state[2] = focal * state[3]
    state[0:2], state[4:6] = state[2] * translation[:2], centre
    state[6:9] = rows(camera_from_rect.rotation[..., 0], batch, (3,))
    state[9:12] = rows(camera_from_rect.rotation[..., 1], batch, (3,))
    return state


def projection_of(problem: PinholeViews, state: Floats) -> Projection:
    """Unseen points (nan) have no residual; the prior of the principal point counts in chi2."""
    x, y = problem.plane[:, 0], problem.plane[:, 1]
    u0, v0, s, kappa, cx, cy = state[:6]
    rotated = np.empty((3, len(x), state.shape[1]))
    for row in range(3):
        rotated[row] = state[6 + row] * x + state[9 + row] * y
    shrink = 1 / (1 + kappa * rotated[2])
    seen = np.empty((2, *shrink.shape))
    seen[0], seen[1] = (u0 + s * rotated[0]) * shrink, (v0 + s * rotated[1]) * shrink
    residuals = np.empty_like(seen)
    residuals[0] = problem.pixels[:, 0] - cx - seen[0]
    residuals[1] = problem.pixels[:, 1] - cy - seen[1]
    residuals /= problem.noise
    chi2 = (residuals * residuals).sum(axis=(0, 1))
    if np.isnan(chi2).any():
        residuals = np.where(np.isnan(problem.pixels).swapaxes(0, 1), 0.0, residuals)
        chi2 = (residuals * residuals).sum(axis=(0, 1))
    if problem.centre_sigma > 0:
        offset = (state[4:6] - problem.centre) / problem.centre_sigma
        chi2 = chi2 + (offset * offset).sum(axis=0)
    if problem.photographed:
        chi2 = np.where((shrink.min(axis=0) > 0) & (s > 0), chi2, np.inf)
    return Projection(rotated, residuals, seen, shrink, chi2)


def derivatives(problem: PinholeViews, state: Floats, projection: Projection) -> Floats:
    """J (n, 2P, B) over sigma of the pixels by u0, v0, s and kappa (or kappa alone along s = f kappa), the rotation
    step, and cx, cy where they are free."""
    a, b, c = projection.rotated
    s, kappa = state[2], state[3]
    (u, v), w = projection.seen, projection.shrink
    inverse_noise = 1 / problem.noise
    w = w * inverse_noise
    free_centre = problem.centre_sigma > 0
    known = problem.focal is not None
    size = 7 - known + 2 * free_centre
    J = np.zeros((size, 2, *c.shape))
    J[0, 0], J[1, 1] = w, w
    column = 2
    cw = c * w
    by_scale_u, by_scale_v = a * w, b * w
    if problem.focal is None:
        J[2, 0], J[2, 1] = by_scale_u, by_scale_v
        J[3, 0], J[3, 1] = -u * cw, -v * cw
        column = 4
    else:
        J[2, 0], J[2, 1] = problem.focal * by_scale_u - u * cw, problem.focal * by_scale_v - v * cw
        column = 3
    ku, kv = kappa * u, kappa * v
    J[column, 0] = -ku * by_scale_v
    J[column, 1] = -s * cw - kv * by_scale_v
    J[column + 1, 0] = s * cw + ku * by_scale_u
    J[column + 1, 1] = kv * by_scale_u
    J[column + 2, 0], J[column + 2, 1] = -s * by_scale_v, s * by_scale_u
    if free_centre:
        J[column + 3, 0] = inverse_noise
        J[column + 4, 1] = inverse_noise
    unseen = np.isnan(problem.pixels)
    if unseen.any():
        J[:, unseen.swapaxes(0, 1)] = 0
    return J.reshape(size, -1, c.shape[-1])


def normal_matrix(problem: PinholeViews, J: Floats) -> Floats:
    """J^T J (n, n, B), the prior of the principal point added."""
    size = len(J)
    normal = np.empty((size, size, J.shape[-1]))
    for i in range(size):
        normal[i, : i + 1] = (J[i] * J[: i + 1]).sum(axis=1)
        normal[: i + 1, i] = normal[i, : i + 1]
    if problem.centre_sigma > 0:
        for axis in (-2, -1):
            normal[axis, axis] += problem.centre_sigma**-2
    return normal


def gradient_of(problem: PinholeViews, state: Floats, J: Floats, residuals: Floats) -> Floats:
    gradient = (J * residuals.reshape(-1, residuals.shape[-1])).sum(axis=1)
    if problem.centre_sigma > 0:
        gradient[-2:] += (problem.centre - state[4:6]) / problem.centre_sigma**2
    return gradient


def moved(problem: PinholeViews, state: Floats, step: Floats) -> Floats:
    """The state after a step (n, B)."""
    new = state.copy()
    new[0:2] += step[0:2]
    rotation_row = 4
    if problem.focal is None:
        new[2:4] += step[2:4]
    else:
        new[3] += step[2]
        new[2] = problem.focal * new[3]
        rotation_row = 3
    if problem.centre_sigma > 0:
        new[4:6] += step[-2:]
    rotation_x, rotation_y, rotation_z = step[rotation_row : rotation_row + 3]
    square = rotation_x * rotation_x + rotation_y * rotation_y + rotation_z * rotation_z
    # The rotation by the quaternion (w/2, 1), made of unit length: it agrees with exp(w) up to the third power of the
    # step, stays orthonormal, and needs no sine. v + b (w x v + w x (w x v) / 2) with b = 1 / (1 + |w|^2 / 4).
    factor = 1 / (1 + 0.25 * square)
    for column in (6, 9):
        x, y, z = state[column : column + 3]
        p, q, r = rotation_y * z - rotation_z * y, rotation_z * x - rotation_x * z, rotation_x * y - rotation_y * x
        new[column] += factor * (p + 0.5 * (rotation_y * r - rotation_z * q))
        new[column + 1] += factor * (q + 0.5 * (rotation_z * p - rotation_x * r))
        new[column + 2] += factor * (r + 0.5 * (rotation_x * q - rotation_y * p))
    return new


def mirror_to_front(state: Floats) -> None:
    """Where kappa < 0, the same picture with kappa > 0: the rectangle mirrored in depth."""
    behind = np.flatnonzero(state[3] < 0)
    for row in (3, 8, 11):
        state[row, behind] *= -1


def covariances(problem: PinholeViews, state: Floats) -> Floats:
    members = state.shape[1]
    covariance = np.empty((members, 9, 9))
    for first in range(0, members, BLOCK):
        part = np.arange(first, min(first + BLOCK, members))
        covariance[part] = _covariance(problem.members(part), state[:, part])
    return covariance


def _covariance(problem: PinholeViews, state: Floats) -> Floats:
    """Covariance (B, 9, 9) of (focal, cx, cy, rotation step, translation step)."""
    J = derivatives(problem, state, projection_of(problem, state))
    inner = triangular.inverse(triangular.cholesky(normal_matrix(problem, J)))
    size = len(inner)
    u0, v0, s, kappa = state[:4]
    outer = np.zeros((9, size, len(u0)))
    rotation_row = 4 if problem.focal is None else 3
    # t = (u0 / s, v0 / s, 1 / kappa) and f = s / kappa, with s = f kappa where the focal is known.
    outer[6, 0] = outer[7, 1] = 1 / s
    outer[8, rotation_row - 1] = -1 / kappa**2
    if problem.focal is None:
        outer[0, 2], outer[0, 3] = 1 / kappa, -s / kappa**2
        outer[6, 2], outer[7, 2] = -u0 / s**2, -v0 / s**2
    else:
        outer[6, 2], outer[7, 2] = -u0 / (s * kappa), -v0 / (s * kappa)
    outer[3, rotation_row] = outer[4, rotation_row + 1] = outer[5, rotation_row + 2] = 1
    if problem.centre_sigma > 0:
        outer[1, rotation_row + 3] = outer[2, rotation_row + 4] = 1
    outer, inner = np.moveaxis(outer, -1, 0), np.moveaxis(inner, -1, 0)
    return outer @ inner @ np.swapaxes(outer, -1, -2)
