"""The demo's result beside the truth of its scene."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.io.demo.scene import Scene, SceneCamera
from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose

# Squared distances in sigmas that hold 99.73 % of errors (what 3 sigma hold of one number), for 1 and 3 numbers.
_BOUND = {1: 9.0, 3: 14.16}


@dataclass(frozen=True)
class TruthCheck:
    """One camera of a Rig against the truth.

    focal, focal_sigma, focal_truth: px. position_error, position_sigma: m; rotation_error, rotation_sigma: rad; of
    rig_from_camera. within: whether focal, position and rotation each lie where 99.73 % of them should.
    """

    camera: str
    focal: float
    focal_sigma: float
    focal_truth: float
    position_error: float
    position_sigma: float
    rotation_error: float
    rotation_sigma: float
    within: tuple[bool, bool, bool]


def compare_with_truth(rig: Rig, scene: Scene) -> tuple[TruthCheck, ...]:
    """Each camera of the rig against the scene that it was calibrated from."""
    truth = {camera.name: camera for camera in scene.cameras}
    rig_from_world = truth[rig.reference].world_from_camera.inverse()
    return tuple(
        _compare(rig, camera.name, truth[camera.name], rig_from_world @ truth[camera.name].world_from_camera)
        for camera in rig.cameras
    )


def all_within(comparisons: Sequence[TruthCheck]) -> bool:
    """Whether the truth lies within the sigmas throughout."""
    return all(all(one.within) for one in comparisons)


def _compare(rig: Rig, name: str, truth: SceneCamera, rig_from_camera: Pose) -> TruthCheck:
    camera = rig.camera(name)
    step = camera.rig_from_camera.step_to(rig_from_camera)
    covariance = rig.pose_covariance(name)
    focal_sigma = rig.focal_sigma(name)
    focal_error = camera.intrinsics.focal - truth.intrinsics.focal
    return TruthCheck(
        name,
        camera.intrinsics.focal,
        focal_sigma,
        truth.intrinsics.focal,
        float(np.linalg.norm(step[3:])),
        rig.position_sigma(name),
        float(np.linalg.norm(step[:3])),
        rig.rotation_sigma(name),
        (
            _holds(np.array([focal_error]), np.array([[focal_sigma**2]])),
            name == rig.reference or _holds(step[3:], covariance[3:, 3:]),
            name == rig.reference or _holds(step[:3], covariance[:3, :3]),
        ),
    )


def _holds(error: Floats, covariance: Floats) -> bool:
    return bool(error @ np.linalg.solve(covariance, error) < _BOUND[len(error)])
