"""The rows of the linear problem that a Rig's Views pose: derivatives by cameras and by each placed rectangle."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.rig.doubt.information import camera_derivatives, rectangle_derivatives
from quadrig.rig.result import CAMERA_PARAMETERS, Camera, Rig, ViewFit, placed_pose
from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose


def instances(rig: Rig) -> list[list[ViewFit]]:
    """The fits that took part, grouped by placed rectangle: a static one once, a moving one by frameset."""
    groups: dict[tuple[str, int], list[ViewFit]] = {}
    moving = {placed.name for placed in rig.rectangles if placed.framesets.size}
    for fit in rig.fits:
        if pose_of(rig, fit) is not None:
            frameset = fit.view.frameset if fit.view.rectangle in moving else -1
            groups.setdefault((fit.view.rectangle, frameset), []).append(fit)
    return list(groups.values())


def pose_of(rig: Rig, fit: ViewFit) -> Pose | None:
    """Where the rectangle of a fit stood, rig_from_rect; None where the View had no part in the rig."""
    if not np.isfinite(fit.residuals).any() or not any(c.name == fit.view.camera for c in rig.cameras):
        return None
    return placed_pose(rig, fit.view.rectangle, fit.view.frameset)


@dataclass(frozen=True, eq=False)
class Rows:
    """Of M pixel coordinates of one placed rectangle: derivatives by the cameras (M, 15 C), by what the tone of each
    camera moves them in one standard deviation (M, C), see View.common, by the logarithm of the rectangle's size
    (M,) and by its pose (M, 6); residuals (M,) px."""

    by_cameras: Floats
    by_tones: Floats
    by_size: Floats
    by_pose: Floats
    residuals: Floats


def rows_of(rig: Rig, cameras: Sequence[Camera], group: Sequence[ViewFit]) -> Rows:
    """Of all used pixels of one placed rectangle.

    cameras: those of the rig, in its order; their free_lens says which columns count.
    """
    parts = []
    for fit in group:
        index, pose = rig.camera_index(fit.view.camera), pose_of(rig, fit)
        assert pose is not None
        points = fit.view.readings[fit.reading]
        _, by_camera, by_point = camera_derivatives(cameras[index], pose.transform(points))
        good = np.isfinite(fit.residuals).all(-1) & fit.used & np.isfinite(by_point).all((1, 2))
        count = 2 * int(good.sum())
        by_cameras, by_tones = np.zeros((count, len(cameras), CAMERA_PARAMETERS)), np.zeros((count, len(cameras)))
        by_cameras[:, index] = by_camera[good].reshape(-1, CAMERA_PARAMETERS)
        if fit.view.common is not None:
            by_tones[:, index] = fit.view.common[good].ravel()
        arm = (points @ pose.rotation.T)[good]
        by_size = (by_point[good] @ arm[..., None]).reshape(-1)
        by_pose = rectangle_derivatives(by_point, pose, points)[good].reshape(-1, 6)
        parts.append(
            (
                by_cameras.reshape(count, len(cameras) * CAMERA_PARAMETERS),
                by_tones,
                by_size,
                by_pose,
                fit.residuals[good].reshape(-1),
            )
        )
    return Rows(*(np.concatenate(column) for column in zip(*parts, strict=True)))
