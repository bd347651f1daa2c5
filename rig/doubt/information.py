"""What Views determine of a rig before they are taken: derivatives, information, and the doubt of points.

The cameras' parameters stand in the order of Rig.covariance: for each camera nine of the lens, then the step of
rig_from_camera (rotation, translation, in the rig frame).
"""

from collections.abc import Sequence

import numpy as np

from quadrig.rig.result import Camera
from quadrig.single.arrays import Floats, Mask
from quadrig.single.lens import LENS_PARAMETERS, LensModel, project_with_derivatives
from quadrig.single.pose import Pose
from quadrig.single.rotation import cross_matrix


def camera_derivatives(camera: Camera, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Pixels (..., 2) of points (..., 3) of the rig frame, by the camera (..., 2, 15) and by the point (..., 2, 3).

    Columns of lens parameters that are not free are zero. nan where the camera cannot see the point.
    """
    points = np.asarray(points, float)
    pixels, by_camera, by_point = derivatives_of_all([camera], points.reshape(-1, 3))
    shape = points.shape[:-1]
    return pixels.reshape(*shape, 2), by_camera.reshape(*shape, 2, -1), by_point.reshape(*shape, 2, 3)


def derivatives_of_all(cameras: Sequence[Camera], points: Floats) -> tuple[Floats, Floats, Floats]:
    """What `camera_derivatives` says of the points (N, 3) for all cameras: (C, N, 2), (C, N, 2, 15), (C, N, 2, 3)."""
    poses, parameters = _stacked(cameras)
    arm = points - poses.translation[:, None]
    in_camera = arm @ poses.rotation
    shape = arm.shape[:-1]
    pixels, by_lens, by_camera_point = np.empty((*shape, 2)), np.empty((*shape, 2, 9)), np.empty((*shape, 2, 3))
    for model, rows in _by_model(cameras).items():
        found = project_with_derivatives(parameters[rows][:, None], in_camera[rows], model)
        pixels[rows], by_lens[rows], by_camera_point[rows] = found
    by_point = by_camera_point @ np.swapaxes(poses.rotation, -1, -2)[:, None]
    free = np.stack([_free(camera) for camera in cameras])[:, None, None]
    by_camera = np.concatenate([by_lens * free, by_point @ cross_matrix(arm), -by_point], axis=-1)
    return pixels, by_camera, by_point


def _stacked(cameras: Sequence[Camera]) -> tuple[Pose, Floats]:
    """rig_from_camera, a batch (C,), and lens parameters (C, 9)."""
    poses = Pose(
        np.stack([camera.rig_from_camera.rotation for camera in cameras]),
        np.stack([camera.rig_from_camera.translation for camera in cameras]),
    )
    return poses, np.stack([camera.intrinsics.parameters for camera in cameras])


def _by_model(cameras: Sequence[Camera]) -> dict[LensModel, list[int]]:
    rows: dict[LensModel, list[int]] = {}
    for row, camera in enumerate(cameras):
        rows.setdefault(camera.intrinsics.model, []).append(row)
    return rows


def rectangle_derivatives(by_point: Floats, rig_from_rect: Pose, points: Floats) -> Floats:
    """By the step of rig_from_rect (..., P, 2, 6), of by_point (..., P, 2, 3) and the points (P, 3) it has."""
    arm = (rig_from_rect.rotation[..., None, :, :] @ points[..., None])[..., 0]
    return np.concatenate([-by_point @ cross_matrix(arm), by_point], axis=-1)


def covariance_of(
    cameras: Sequence[Camera], information: Floats, reference: str, prior: Floats | None = None
) -> Floats:
    """Covariance (15 C, 15 C) where the reference camera's pose is the rig frame; zero rows for what is not free.

    prior (9,): sigmas of the lens parameters before anything was seen (inf where nothing is known).
    """
    free = np.concatenate(
        [np.concatenate([_free(c) > 0, np.full(6, c.name != reference)]).astype(bool) for c in cameras]
    )
    information = information.copy()
    if prior is not None:
        information[np.diag_indices(len(free))] += np.tile(np.concatenate([1 / prior**2, np.zeros(6)]), len(cameras))
    covariance = np.zeros_like(information)
    covariance[np.ix_(free, free)] = scaled_inverse(information[np.ix_(free, free)])
    return covariance


def scaled_inverse(matrix: Floats) -> Floats:
    """Inverse of a symmetric matrix (N, N) whose rows have different units; what nothing determines stays zero."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 0))
    scale = np.where(scale > 0, scale, 1.0)
    # What nothing tells (where the rig frame stands) is zero but for rounding: a few hundred of its units a row, as
    # sums of thousands of corners that cancel leave it.
    rounding = 1e3 * len(matrix) * np.finfo(float).eps
    return np.linalg.pinv(matrix / np.outer(scale, scale), rcond=rounding, hermitian=True) / np.outer(scale, scale)


def triangulation_derivatives(cameras: Sequence[Camera], points: Floats, sees: Mask | None = None) -> Floats:
    """How triangulated points (N, 3) move with the cameras' parameters: (N, 3, 15 C).

    sees (C, N) bool: which camera takes part; where None, those into whose picture a point falls. nan for points that
    fewer than two cameras see.
    """
    by_camera, by_point = _of_seen(cameras, points, sees)
    transposed = np.swapaxes(by_point, -1, -2)
    normal = (transposed @ by_point).sum(axis=0)
    normal[(by_point != 0).any(axis=(-1, -2)).sum(axis=0) < 2] = np.nan
    moved = np.moveaxis(transposed @ by_camera, 0, 2).reshape(len(points), 3, -1)
    result = np.full_like(moved, np.nan)
    possible = np.isfinite(normal).all((1, 2))
    result[possible] = -np.linalg.inv(normal[possible]) @ moved[possible]
    return result


def triangulation_information(cameras: Sequence[Camera], points: Floats) -> Floats:
    """What one picture of each camera says of points (N, 3) for noise of 1 px: (N, 3, 3), 1/m^2."""
    _, by_point = _of_seen(cameras, points, None)
    return (np.swapaxes(by_point, -1, -2) @ by_point).sum(axis=0)


def _of_seen(cameras: Sequence[Camera], points: Floats, sees: Mask | None) -> tuple[Floats, Floats]:
    """Derivatives of pixels by the camera (C, N, 2, 15) and by the point (C, N, 2, 3), zero where it is not seen."""
    pixels, by_camera, by_point = derivatives_of_all(cameras, points)
    if sees is None:
        sees = np.stack([_in_picture(camera, own) for camera, own in zip(cameras, pixels, strict=True)])
    by_camera, by_point = (np.where(sees[..., None, None], each, 0.0) for each in (by_camera, by_point))
    return by_camera, by_point


def visible(camera: Camera, points: Floats, margin: float = 0.0) -> Mask:
    """Which points (..., 3) of the rig frame fall into the picture, `margin` px from its border. (...) bool."""
    pixels = camera.intrinsics.project(
        (points - camera.rig_from_camera.translation) @ camera.rig_from_camera.rotation
    )
    return _in_picture(camera, pixels, margin)


def _in_picture(camera: Camera, pixels: Floats, margin: float = 0.0) -> Mask:
    size = np.array([camera.intrinsics.width, camera.intrinsics.height])
    with np.errstate(invalid="ignore"):
        return np.all((pixels >= margin) & (pixels <= size - 1 - margin), axis=-1)


def _free(camera: Camera) -> Floats:
    return np.array([name in camera.free_lens for name in LENS_PARAMETERS], float)
