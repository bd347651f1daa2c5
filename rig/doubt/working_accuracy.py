"""How far a point triangulated by the rig may be off, from the calibration's doubt alone."""

from collections.abc import Sequence

import numpy as np

from quadrig.rig.doubt.information import triangulation_derivatives
from quadrig.rig.result import Camera, PlacedRectangle
from quadrig.single.arrays import Floats
from quadrig.single.rotation import cross_matrix

# Points that stand for the volume: more change the root mean square by less than its second digit.
_MOST_POINTS = 100


def covered_points(rectangles: Sequence[PlacedRectangle]) -> Floats:
    """Corners and middles (N, 3), rig frame, of the rectangles where they were seen: they span the covered volume."""
    parts = []
    for placed in rectangles:
        corners = placed.rectangle.corners
        every = np.concatenate([corners, corners.mean(axis=0, keepdims=True)])
        pose = placed.rig_from_rect
        batch = pose if pose.translation.ndim == 2 else pose[None]
        parts.append(batch[:, None].transform(every).reshape(-1, 3))
    points = np.concatenate(parts) if parts else np.zeros((0, 3))
    if len(points) <= _MOST_POINTS:
        return points
    return points[np.linspace(0, len(points) - 1, _MOST_POINTS).round().astype(int)]


def triangulation_shape(cameras: Sequence[Camera], points: Floats) -> tuple[Floats, Floats]:
    """Points (N', 3) that two cameras see, and how where the rig would triangulate them moves with the cameras'
    parameters (N', 3, 15 C), in the order of Rig.covariance.

    The part that is one rigid motion of all points is taken out: it is the frame that moves, not the rig's shape, so
    that no figure depends on where the rig frame stands.
    """
    derivatives = triangulation_derivatives(cameras, points)
    possible = np.isfinite(derivatives).all(axis=(1, 2))
    points, derivatives = points[possible], derivatives[possible]
    flat = derivatives.reshape(-1, derivatives.shape[-1])
    return points, derivatives - rigid_part(points, flat).reshape(derivatives.shape)


def rigid_part(points: Floats, motion: Floats) -> Floats:
    """What of a motion (3 N, K) of points is one rigid motion of all of them, by least squares."""
    arms = points - points.mean(axis=0) if len(points) else points
    orthogonal, _ = np.linalg.qr(rigid_basis(arms).reshape(-1, 6))
    return orthogonal @ (orthogonal.T @ motion)


def rigid_basis(arms: Floats) -> Floats:
    """Motion (N, 3, 6) of points at `arms` (N, 3) from a middle by a translation and a rotation about that."""
    return np.concatenate([np.broadcast_to(np.eye(3), (len(arms), 3, 3)), -cross_matrix(arms)], axis=-1)


def working_accuracy(cameras: Sequence[Camera], covariance: Floats, points: Floats) -> float:
    """Sigma (m) of a triangulated point along its worst axis, root mean square over the points; nan for none."""
    if len(cameras) < 2 or not len(points):
        return float("nan")
    seen, shape = triangulation_shape(cameras, points)
    if len(seen) < 3:
        return float("nan")
    blocks = shape @ covariance @ np.swapaxes(shape, -1, -2)
    return float(np.sqrt(np.maximum(np.linalg.eigvalsh(blocks)[:, -1], 0).mean()))
