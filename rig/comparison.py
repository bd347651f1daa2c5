"""Two calibrations of one rig, brought into one frame: what differs, and whether their sigmas allow it."""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.adjustment.twist_jacobians import step_by_left_twist
from quadrig.rig.result import CAMERA_PARAMETERS, Rig
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import LENS_PARAMETERS
from quadrig.single.pose import Pose

_LENS = len(LENS_PARAMETERS)
# Weights of cameras settle to a per cent in this many rounds; more would change no printed digit.
_ROUNDS = 10


@dataclass(frozen=True, eq=False)
class CameraDifference:
    """Second rig minus first for one camera, in the first's frame. Each sigma is of the difference in one direction,
    from both rigs.

    focal px; shift m; rotation rad. step (6,) of rig_from_camera. sigmas: root of the Mahalanobis distance of the
    step over its freedoms: near 1 where the rigs agree as well as they claim. chance: of so large a difference by
    chance. Sigmas and chances are nan where one of the rigs does not know its doubt.
    """

    name: str
    focal: float
    focal_sigma: float
    shift: float
    shift_sigma: float
    rotation: float
    rotation_sigma: float
    step: Floats
    sigmas: float
    chance: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """first_from_second: takes the second rig's frame to the first's. only_first, only_second: names without a
    partner. chance: of as much difference of all poses together."""

    cameras: tuple[CameraDifference, ...]
    first_from_second: Pose
    only_first: tuple[str, ...]
    only_second: tuple[str, ...]
    chance: float


def compare(first: Rig, second: Rig) -> Comparison:
    """Align two rigs on the cameras they share, and state their differences with sigmas.

    Cameras that disagree pull less (Huber's weights), so that one that moved does not smear over the others. The two
    calibrations are taken to rest on different Views. Raises QuadrigError where they share no two cameras.
    """
    names = [camera.name for camera in first.cameras if any(camera.name == other.name for other in second.cameras)]
    if len(names) < 2:
        raise QuadrigError("the two rigs share fewer than two cameras by name; compare calibrations of one rig")
    first_from_second, steps, gauge, pull = _aligned(first, second, names)
    kept = np.eye(len(gauge)) - gauge @ pull
    doubt = kept @ (_poses(first, names, Pose.identity()) + _poses(second, names, first_from_second)) @ kept.T
    distance, freedoms = _mahalanobis(steps.ravel(), doubt)
    return Comparison(
        tuple(_difference(first, second, name, steps[i], _block(doubt, i)) for i, name in enumerate(names)),
        first_from_second,
        tuple(camera.name for camera in first.cameras if camera.name not in names),
        tuple(camera.name for camera in second.cameras if camera.name not in names),
        _chance(distance, freedoms),
    )


def _aligned(first: Rig, second: Rig, names: list[str]) -> tuple[Pose, Floats, Floats, Floats]:
    """first_from_second, steps (C, 6) that are left, their derivative (6C, 6) by a step of the whole second rig, and
    the linear map (6, 6C) from steps to that step."""
    stored = [first.camera(name).rig_from_camera for name in names]
    other = [second.camera(name).rig_from_camera for name in names]
    first_from_second = stored[0] @ other[0].inverse()
    positions = np.array([pose.translation for pose in stored])
    # A radian counts as much as the size of the rig, so that the frame does not hang on its unit of length.
    size = max(float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max()), 1e-3)
    scale = np.array([size, size, size, 1.0, 1.0, 1.0])
    weight, gauge, pull = np.ones(len(names)), np.zeros((0, 6)), np.zeros((6, 0))
    for _ in range(_ROUNDS):
        placed = [first_from_second @ pose for pose in other]
        steps = np.array([a.step_to(b) for a, b in zip(stored, placed, strict=True)])
        rows = (np.sqrt(weight)[:, None] * scale).ravel()
        gauge = np.concatenate([step_by_left_twist(pose) for pose in placed])
        pull = np.asarray(np.linalg.pinv(gauge * rows[:, None]) * rows, float)
        first_from_second = Pose.from_twist(-(pull @ steps.ravel())) @ first_from_second
        miss = np.linalg.norm(steps * scale, axis=1)
        weight = 1 / np.maximum(miss / max(float(np.median(miss)), 1e-12), 1.0)
    placed = [first_from_second @ pose for pose in other]
    steps = np.array([a.step_to(b) for a, b in zip(stored, placed, strict=True)])
    return first_from_second, steps, gauge, pull


def _poses(rig: Rig, names: list[str], frame_from_rig: Pose) -> Floats:
    """Joint covariance (6C, 6C) of the cameras' steps, in another frame."""
    index = np.concatenate([rig.camera_index(name) * CAMERA_PARAMETERS + _LENS + np.arange(6) for name in names])
    rotation = np.kron(np.eye(2 * len(names)), frame_from_rig.rotation)
    return rotation @ rig.covariance[np.ix_(index, index)] @ rotation.T


def _difference(first: Rig, second: Rig, name: str, step: Floats, doubt: Floats) -> CameraDifference:
    distance, freedoms = _mahalanobis(step, doubt)
    return CameraDifference(
        name,
        second.camera(name).intrinsics.focal - first.camera(name).intrinsics.focal,
        float(np.hypot(first.focal_sigma(name), second.focal_sigma(name))),
        float(np.linalg.norm(step[3:])),
        float(np.sqrt(max(np.trace(doubt[3:, 3:]) / 3, 0))),
        float(np.linalg.norm(step[:3])),
        float(np.sqrt(max(np.trace(doubt[:3, :3]) / 3, 0))),
        step,
        float(np.sqrt(distance / max(freedoms, 1))),
        _chance(distance, freedoms),
    )


def _mahalanobis(step: Floats, doubt: Floats) -> tuple[float, int]:
    """Squared distance, and in how many directions there is any doubt; nan and none where the doubt is not known."""
    if not np.isfinite(doubt).all():
        return float("nan"), 0
    values, axes = np.linalg.eigh(doubt)
    # What alignment took away is zero up to rounding, twelve digits below the rest.
    known = values > 1e-10 * max(float(values.max()), 1e-300)
    return float(np.sum((axes.T @ step)[known] ** 2 / values[known])), int(known.sum())


def _chance(distance: float, freedoms: int) -> float:
    from scipy.stats import chi2

    return float(chi2.sf(distance, freedoms)) if freedoms else float("nan")


def _block(matrix: Floats, index: int) -> Floats:
    return matrix[6 * index : 6 * index + 6, 6 * index : 6 * index + 6]
