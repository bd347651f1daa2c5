"""The pose of a plane for a known lens: both candidates, the true one and its mirror twin, in batches.

Closed form of Collins and Bartoli, "Infinitesimal plane-based pose estimation" (IJCV 2014): the homography's first
derivatives at the middle of the rectangle fix the rotation but for the sign of its slope.
"""

from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose
from quadrig.single.rotation import cross_matrix


@dataclass(frozen=True, eq=False)
class PlanarPoses:
    """Two candidates for each plane: camera_from_rect, a batch (..., 2), the likelier first.

    errors (..., 2): root mean square of the reprojection in the plane z = 1 (multiply by the focal for pixels).
    """

    camera_from_rect: Pose
    errors: Floats


def planar_poses(homography: Floats, points: Floats, plane: Floats, weights: Floats | None = None) -> PlanarPoses:
    """Both poses of planes whose points were seen by a lens that is known.

    homography (..., 3, 3): from rectangle (x, y, 1) metres to the plane z = 1 of the camera. points (..., P, 3)
    metres with z = 0, plane (..., P, 2) where their rays meet z = 1. weights (..., P): zero leaves a point out.
    """
    weights = np.ones(plane.shape[:-1]) if weights is None else np.asarray(weights, float)
    rotations = _rotations(homography)
    points, plane, weights = points[..., None, :, :], plane[..., None, :, :], weights[..., None, :]
    rotated = points @ np.swapaxes(rotations, -1, -2)
    translations = _translations(rotated, plane, weights)
    located = rotated + translations[..., None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        residual = located[..., :2] / located[..., 2:] - plane
    behind = ((located[..., 2] <= 0) & (weights > 0)).any(axis=-1)
    square = np.where(weights > 0, (residual**2).sum(axis=-1) * weights, 0.0).sum(axis=-1)
    errors = np.where(behind, np.inf, np.sqrt(square / weights.sum(axis=-1)))
    order = np.argsort(errors, axis=-1, kind="stable")
    return PlanarPoses(
        Pose(
            np.take_along_axis(rotations, order[..., None, None], axis=-3),
            np.take_along_axis(translations, order[..., None], axis=-2),
        ),
        np.take_along_axis(errors, order, axis=-1),
    )


def _rotations(homography: Floats) -> Floats:
    """The two rotations (..., 2, 3, 3) that a homography allows."""
    h = homography / homography[..., 2:, 2:]
    middle = h[..., :2, 2]
    slope = h[..., :2, :2] - middle[..., :, None] * h[..., 2:, :2]
    towards = _rotation_to(middle)
    local = towards[..., :2, :2] - middle[..., :, None] * towards[..., 2:, :2]
    scaled = np.linalg.solve(local, slope)
    gram = scaled @ np.swapaxes(scaled, -1, -2)
    difference = gram[..., 0, 0] - gram[..., 1, 1]
    largest = (gram[..., 0, 0] + gram[..., 1, 1] + np.hypot(difference, 2 * gram[..., 0, 1])) / 2
    upper = scaled / np.sqrt(largest)[..., None, None]
    # What the two columns lack to unit length is their third component, known but for one common sign.
    lacking = np.eye(2) - np.swapaxes(upper, -1, -2) @ upper
    first = np.sqrt(np.maximum(lacking[..., 0, 0], 0))
    second = np.sqrt(np.maximum(lacking[..., 1, 1], 0)) * np.where(lacking[..., 0, 1] < 0, -1.0, 1.0)
    third = np.stack([first, second], axis=-1)
    candidates = []
    for sign in (1.0, -1.0):
        columns = np.concatenate([upper, sign * third[..., None, :]], axis=-2)
        normal = np.cross(columns[..., 0], columns[..., 1])
        candidates.append(towards @ np.concatenate([columns, normal[..., None]], axis=-1))
    return np.stack(candidates, axis=-3)


def _rotation_to(middle: Floats) -> Floats:
    """The smallest rotation that takes the optical axis to the ray through (middle, 1)."""
    ray = np.concatenate([middle, np.ones((*middle.shape[:-1], 1))], axis=-1)
    ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    axis = np.stack([-ray[..., 1], ray[..., 0], np.zeros_like(ray[..., 0])], axis=-1)
    cross = cross_matrix(axis)
    return np.eye(3) + cross + cross @ cross / (1 + ray[..., 2])[..., None, None]


def _translations(rotated: Floats, plane: Floats, weights: Floats) -> Floats:
    """Least-squares translations (..., 3): each point asks that x (Z + tz) = X + tx, and so for y."""
    u, v = plane[..., 0], plane[..., 1]
    x, y, z = rotated[..., 0], rotated[..., 1], rotated[..., 2]
    normal = np.zeros((*rotated.shape[:-2], 3, 3))
    normal[..., 0, 0] = normal[..., 1, 1] = weights.sum(axis=-1)
    normal[..., 0, 2] = normal[..., 2, 0] = -(weights * u).sum(axis=-1)
    normal[..., 1, 2] = normal[..., 2, 1] = -(weights * v).sum(axis=-1)
    normal[..., 2, 2] = (weights * (u * u + v * v)).sum(axis=-1)
    error_x, error_y = u * z - x, v * z - y
    right = np.stack(
        [
            (weights * error_x).sum(axis=-1),
            (weights * error_y).sum(axis=-1),
            -(weights * (u * error_x + v * error_y)).sum(axis=-1),
        ],
        axis=-1,
    )
    return np.asarray(np.linalg.solve(normal, right[..., None]), float)[..., 0]
