"""How far each View, by itself, disagrees with the rig: the pose it would rather have, in its own sigmas."""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.result import Rig, ViewFit, placed_pose
from quadrig.single.arrays import Floats
from quadrig.single.lens import project_with_derivatives
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
    return tuple(_disagreement(rig, fit) for fit in rig.fits)


def _disagreement(rig: Rig, fit: ViewFit) -> Disagreement:
    step, normal = _own_step(rig, fit)
    # The View's own sigma says how its noise compares with the others'; Rig.noise is that of a View of median sigma.
    noise = _noise(rig)
    sigmas = float(np.sqrt(max(step @ normal @ step, 0) / 6) / noise)
    return Disagreement(
        fit.view.camera,
        fit.view.rectangle,
        fit.view.frameset,
        float(np.linalg.norm(step[:3])),
        float(np.linalg.norm(step[3:])),
        sigmas,
        float(np.trace(normal[3:, 3:]) / noise**2),
        bool(fit.rejected),
    )


def _noise(rig: Rig) -> float:
    return max(rig.noise, _LEAST_NOISE) if np.isfinite(rig.noise) else 1.0


def _own_step(rig: Rig, fit: ViewFit) -> tuple[Floats, Floats]:
    """The step of camera_from_rect (6,) and its normal matrix (6, 6) in px^-2."""
    view = fit.view
    unknown = np.full(6, np.nan), np.full((6, 6), np.nan)
    pose = placed_pose(rig, view.rectangle, view.frameset)
    if pose is None or all(camera.name != view.camera for camera in rig.cameras):
        return unknown
    camera = rig.camera(view.camera)
    used = np.asarray(fit.used, bool)
    # A View rejected whole has no used points; then all of them say what it says.
    used = used if used.any() else np.ones(len(used), bool)
    points = (camera.rig_from_camera.inverse() @ pose).transform(view.readings[fit.reading][used])
    lens = camera.intrinsics
    _, _, by_point = project_with_derivatives(lens.parameters, points, lens.model)
    centre = (camera.rig_from_camera.inverse() @ pose).translation
    by_step = np.concatenate([-by_point @ cross_matrix(points - centre), by_point], axis=-1).reshape(-1, 6)
    residuals = fit.residuals[used].ravel()
    known = np.isfinite(residuals) & np.isfinite(by_step).all(axis=1)
    if known.sum() < 6:
        return unknown
    normal = by_step[known].T @ by_step[known]
    step = np.linalg.lstsq(by_step[known], residuals[known], rcond=None)[0]
    return np.asarray(step, float), normal
