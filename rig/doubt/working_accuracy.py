"""How far a point triangulated by the rig may be off, from the calibration's doubt alone."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.rig.doubt.information import triangulation_derivatives, triangulation_information
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

    The part that moves, turns or enlarges all points together is taken out: that is the frame and the unit of length,
    not the rig's shape, so that no figure depends on where the rig frame stands or on how large the sheets are.
    """
    points, derivatives = _triangulated(cameras, points)
    flat = derivatives.reshape(-1, derivatives.shape[-1])
    return points, derivatives - similarity_part(points, flat).reshape(derivatives.shape)


def _triangulated(cameras: Sequence[Camera], points: Floats) -> tuple[Floats, Floats]:
    derivatives = triangulation_derivatives(cameras, points)
    possible = np.isfinite(derivatives).all(axis=(1, 2))
    return points[possible], derivatives[possible]


def similarity_part(points: Floats, motion: Floats) -> Floats:
    """What of a motion (3 N, K) of points is one rigid motion and one enlargement of all, by least squares."""
    arms = points - points.mean(axis=0) if len(points) else points
    orthogonal, _ = np.linalg.qr(similarity_basis(arms).reshape(-1, 7))
    return orthogonal @ (orthogonal.T @ motion)


def similarity_basis(arms: Floats) -> Floats:
    """Motion (N, 3, 7) of points at `arms` (N, 3) from a middle by a translation, a rotation about that and by
    scale."""
    parts = [np.broadcast_to(np.eye(3), (len(arms), 3, 3)), -cross_matrix(arms), arms[..., None]]
    return np.concatenate(parts, axis=-1)


@dataclass(frozen=True)
class Accuracy:
    """What a rig is good for. working: sigma (m) of a triangulated point along its worst axis, from the calibration's
    doubt of the rig's shape alone; single: of one point, with the noise of its own pixels. Both root mean square over
    the points. scale: sigma of all lengths together, as a share of them: what no picture shows, the size of prints.
    """

    working: float = float("nan")
    single: float = float("nan")
    scale: float = float("nan")


def accuracy_of(cameras: Sequence[Camera], covariance: Floats, points: Floats, noise: float) -> Accuracy:
    """Of points (N, 3) of the rig frame; covariance (15 C, 15 C); noise: sigma (px) of a pixel coordinate of one
    point. nan where fewer than two cameras see three of the points."""
    if len(cameras) < 2 or not len(points):
        return Accuracy()
    seen, every = _triangulated(cameras, points)
    if len(seen) < 3:
        return Accuracy()
    shape = every - similarity_part(seen, every.reshape(3 * len(seen), -1)).reshape(every.shape)
    doubt = shape @ covariance @ np.swapaxes(shape, -1, -2)
    own = noise**2 * np.linalg.inv(triangulation_information(cameras, seen))
    arms = (seen - seen.mean(axis=0)).ravel()
    enlarged = np.linalg.lstsq(similarity_basis(arms.reshape(-1, 3)).reshape(-1, 7), every.reshape(len(arms), -1))[0][
        6
    ]
    scale = float(np.sqrt(max(enlarged @ covariance @ enlarged, 0.0)))
    return Accuracy(_worst(doubt), _worst(doubt + own), scale)


def _worst(blocks: Floats) -> float:
    """Root mean square of the sigma along the worst axis of covariances (N, 3, 3)."""
    return float(np.sqrt(np.maximum(np.linalg.eigvalsh(blocks)[:, -1], 0).mean()))
