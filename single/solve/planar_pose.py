"""The pose of a plane for a known lens: both candidates, the true one and its mirror twin, in batches.

Closed form of Collins and Bartoli, "Infinitesimal plane-based pose estimation" (IJCV 2014): the homography's first
derivatives at the middle of the rectangle fix the rotation but for the sign of its slope.
"""

from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose
from quadrig.single.rotation import cross_matrix
from quadrig.single.solve.homography import homographies


@dataclass(frozen=True, eq=False)
class PlanarPoses:
    """Two candidates for each plane: camera_from_rect, a batch (..., 2), the likelier first.

    errors (..., 2): root mean square of the reprojection in the plane z = 1 of a camera that looks at the middle of
    the points (multiply by the focal for pixels, as they would be there).
    """

    camera_from_rect: Pose
    errors: Floats


# The sine of how far short of the plane through the lens a ray ends that still has a place in the plane z = 1.
_GRAZING = 0.05


def planar_poses(points: Floats, rays: Floats, weights: Floats | None = None) -> PlanarPoses:
    """Both poses of planes whose points were seen by a lens that is known.

    points (..., P, 3) metres with z = 0, rays (..., P, 3) of unit length in the camera frame along which they were
    seen, also past 90 degrees from its axis; nan for points that have none. weights (..., P): zero leaves a point
    out. Infinite errors where the points determine no pose.
    """
    given = np.ones(rays.shape[:-1]) if weights is None else np.asarray(weights, float)
    given = np.where(np.isfinite(rays).all(axis=-1), given, 0.0)
    rays = np.where(given[..., None] > 0, rays, 0.0)
    # A camera turned towards the middle of the points has all of them in front, wherever the lens saw them.
    towards = rotation_to((rays * given[..., None]).sum(axis=-2))
    turned = rays @ towards
    weights = np.where(turned[..., 2] > _GRAZING, given, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = np.where(weights[..., None] > 0, turned[..., :2] / turned[..., 2:], 0.0)
        homography = homographies(points[..., :2], plane, weights)
    known = np.asarray(np.isfinite(homography).all(axis=(-1, -2)))
    safe = known[..., None]
    # What determines no pose is solved as if it were seen straight on: nothing is singular, and its errors say so.
    plane = np.where(safe[..., None], plane, points[..., :2])
    found = _in_plane(np.where(safe[..., None], homography, np.eye(3)), points, plane, np.where(safe, weights, 1.0))
    return PlanarPoses(
        Pose(towards[..., None, :, :], np.zeros((*known.shape, 1, 3))) @ found.camera_from_rect,
        np.where(safe, found.errors, np.inf),
    )


def _in_plane(homography: Floats, points: Floats, plane: Floats, weights: Floats) -> PlanarPoses:
    """From the homography (..., 3, 3) of the points (..., P, 3) to where they were seen (..., P, 2) in z = 1."""
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
    towards = rotation_to(np.concatenate([middle, np.ones((*middle.shape[:-1], 1))], axis=-1))
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


def rotation_to(direction: Floats) -> Floats:
    """The smallest rotation (..., 3, 3) that takes the optical axis to a direction (..., 3) of any length."""
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    ray = np.where(length > 0, direction / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
    axis = np.stack([-ray[..., 1], ray[..., 0], np.zeros_like(ray[..., 0])], axis=-1)
    cross = cross_matrix(axis)
    # Straight behind, any half turn is as small as any other; no lens sees there.
    return np.eye(3) + cross + cross @ cross / np.maximum(1 + ray[..., 2], 1e-12)[..., None, None]


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
