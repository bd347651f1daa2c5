"""How far each View, by itself, disagrees with the rig: the pose it would rather have, in its own sigmas."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.rig.result import Camera, Rig, ViewFit, placed_pose
from quadrig.single.arrays import Floats
from quadrig.single.lens import project_with_derivatives
from quadrig.single.pose import Pose, stacked
from quadrig.single.rotation import cross_matrix

# What blur, print and the grid of pixels do to a corner does not average out: no View is held to less than this, px.
_LEAST_NOISE = 0.05


@dataclass(frozen=True, eq=False)
class Disagreement:
    """What one View says of camera and rectangle against the rig, with the rig's lens.

    rotation (rad) and translation (m): lengths of the step from the rig's camera_from_rect to the View's own.
    sigmas: root of the step's Mahalanobis distance over its six degrees of freedom; a View of a well-fitting rig is
    near or below 1. information: of the View about the translation, 1/m^2. All nan where there is no prediction.
    """

    camera: str
    rectangle: str
    frameset: int
    rotation: float
    translation: float
    sigmas: float
    information: float
    rejected: bool


def disagreements(rig: Rig) -> tuple[Disagreement, ...]:
    """One for each of rig.fits, in their order.

    To first order: the least-squares step of one pose that takes the View's residuals away (Gauss-Newton from the
    rig's prediction; residuals are small beside the picture).
    """
    steps, normals = np.full((len(rig.fits), 6), np.nan), np.full((len(rig.fits), 6, 6), np.nan)
    of_camera: dict[str, list[int]] = {camera.name: [] for camera in rig.cameras}
    poses = [placed_pose(rig, fit.view.rectangle, fit.view.frameset) for fit in rig.fits]
    for row, fit in enumerate(rig.fits):
        if fit.view.camera in of_camera and poses[row] is not None:
            of_camera[fit.view.camera].append(row)
    for camera in rig.cameras:
        if rows := of_camera[camera.name]:
            seen = camera.rig_from_camera.inverse() @ stacked([pose for row in rows if (pose := poses[row])])
            steps[rows], normals[rows] = _own_steps(camera, seen, [rig.fits[row] for row in rows])
    # The View's own sigma says how its noise compares with the others'; Rig.noise is that of a View of median sigma.
    noise = max(rig.noise, _LEAST_NOISE) if np.isfinite(rig.noise) else 1.0
    away = np.maximum((steps[:, None] @ normals @ steps[..., None])[:, 0, 0], 0.0)
    sigmas, about = np.sqrt(away / 6) / noise, np.trace(normals[:, 3:, 3:], axis1=1, axis2=2) / noise**2
    lengths = np.linalg.norm(steps.reshape(-1, 2, 3), axis=2)
    return tuple(
        Disagreement(
            fit.view.camera,
            fit.view.rectangle,
            fit.view.frameset,
            float(lengths[row, 0]),
            float(lengths[row, 1]),
            float(sigmas[row]),
            float(about[row]),
            bool(fit.rejected),
        )
        for row, fit in enumerate(rig.fits)
    )


def _own_steps(camera: Camera, camera_from_rect: Pose, fits: Sequence[ViewFit]) -> tuple[Floats, Floats]:
    """Of Views of one camera, with the poses (V,) that the rig has of them: the step of camera_from_rect (V, 6) and
    its normal matrix (V, 6, 6) in px^-2."""
    # A View rejected whole has no used points; then all of them say what it says.
    used = [fit.used if np.any(fit.used) else np.ones(len(fit.used), bool) for fit in fits]
    counts = np.array([int(np.sum(each)) for each in used])
    view, starts = np.repeat(np.arange(len(fits)), counts), np.cumsum(counts) - counts
    points = np.concatenate([fit.view.readings[fit.reading][own] for fit, own in zip(fits, used, strict=True)])
    residuals = np.concatenate([fit.residuals[own] for fit, own in zip(fits, used, strict=True)])
    arms = (camera_from_rect.rotation[view] @ points[..., None])[..., 0]
    lens = camera.intrinsics
    _, _, by_point = project_with_derivatives(lens.parameters, arms + camera_from_rect.translation[view], lens.model)
    by_step = np.concatenate([-by_point @ cross_matrix(arms), by_point], axis=-1)
    known = np.isfinite(residuals) & np.isfinite(by_step).all(axis=-1)
    by_step, residuals = np.where(known[..., None], by_step, 0.0), np.where(known, residuals, 0.0)
    across = np.swapaxes(by_step, 1, 2)
    normal = np.add.reduceat(across @ by_step, starts)
    pull = np.add.reduceat((across @ residuals[..., None])[..., 0], starts)
    step = (np.linalg.pinv(normal, hermitian=True) @ pull[..., None])[..., 0]
    few = np.add.reduceat(known.sum(axis=1), starts) < 6
    step[few], normal[few] = np.nan, np.nan
    return step, normal
