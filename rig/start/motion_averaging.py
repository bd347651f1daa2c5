"""Camera poses from all relative poses at once (motion averaging), so that loops close."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quadrig.single.arrays import Floats, Ints
from quadrig.single.pose import Pose, step_by_inner_twist

if TYPE_CHECKING:
    import scipy.sparse


# Keeps the reference camera's own block invertible (1/rad^2, 1/m^2): far below what any relative pose contributes.
_HELD = 1e-9
# Relative poses that agree to a share of their sigmas leave nothing to average: the joint adjustment does the rest.
_AGREED = 1.0
# Where Cauchy's weight begins to fall, in sigmas of a relative pose, round by round.
_AVERAGE_ROUNDS = (1000.0, 100.0, 30.0, 10.0, 5.0, 5.0)


def average(camera_from_rig: Pose, relatives: "Sequence[RelativePose]", reference: int) -> Pose:
    """Poses that agree best with all relative poses at once, not with the paths alone: loops close.

    Gauss-Newton over twists in the rig frame with Cauchy's weights, tightened step by step (graduated
    non-convexity), so that the error that a long path piles up is shared out before single faults are cut off.
    """
    cameras = len(camera_from_rig.translation)
    if len(relatives) < cameras:
        return camera_from_rig
    from scipy.sparse import csc_array, diags_array, eye_array
    from scipy.sparse.linalg import splu

    left, right = np.array([r.left for r in relatives]), np.array([r.right for r in relatives])
    measured = Pose(
        np.stack([r.left_from_right.rotation for r in relatives]),
        np.stack([r.left_from_right.translation for r in relatives]),
    )
    scale = np.array([r.support / max(r.voters, 1) / r.sigma for r in relatives])
    size, rows = 6 * cameras, np.arange(len(relatives))
    held = diags_array(np.repeat(np.arange(cameras) != reference, 6).astype(float))
    for tightness in _AVERAGE_ROUNDS:
        rig_from_right = camera_from_rig[right].inverse()
        gap = (camera_from_rig[left] @ rig_from_right).step_to(measured)
        distance = np.linalg.norm(gap, axis=-1) * scale
        if distance.max() < _AGREED:
            break
        weight = scale / np.sqrt(1 + (distance / tightness) ** 2)
        block = step_by_inner_twist(camera_from_rig.rotation[left], rig_from_right.translation)
        block *= weight[:, None, None]
        pattern = np.concatenate([rows, rows]), np.concatenate([left, right])
        jacobian = _block_matrix(np.concatenate([block, -block]), pattern, (6 * len(relatives), size)) @ held
        normal = jacobian.T @ jacobian + _HELD * eye_array(size)
        step = splu(csc_array(normal)).solve(jacobian.T @ (gap * weight[:, None]).ravel())
        camera_from_rig = camera_from_rig @ Pose.from_twist(step.reshape(cameras, 6))
    return camera_from_rig


def _block_matrix(blocks: Floats, at: tuple[Ints, Ints], shape: tuple[int, int]) -> "scipy.sparse.csr_array":
    """Sparse matrix of 6x6 blocks (B, 6, 6) at block rows and columns (B,)."""
    from scipy.sparse import coo_array

    row, column = (6 * axis[:, None, None] for axis in at)
    row, column = np.broadcast_arrays(row + np.arange(6)[:, None], column + np.arange(6))
    return coo_array((blocks.ravel(), (row.ravel(), column.ravel())), shape=shape).tocsr()


@dataclass(frozen=True, eq=False)
class RelativePose:
    """left_from_right of two cameras, how many rectangle poses support it, and its sigma (rad and m, as one)."""

    left: int
    right: int
    left_from_right: Pose
    support: int
    voters: int
    sigma: float
