"""The covariance of the cameras where the noise of each camera's pictures is its own."""

import numpy as np

from quadrig.rig.adjustment.normal_equations import normal_equations
from quadrig.rig.adjustment.schur import block_matrix
from quadrig.rig.joint.stages import Joint
from quadrig.single.arrays import Floats


def widened_covariance(joint: Joint, widening: Floats) -> Floats:
    """Covariance (C M, C M) of the least-squares solution where the variance of camera c's pixels is widening[c] (C,)
    times what the fit took it for: C V C, with C the fit's covariance and V that of its reduced gradient.

    Wherever the rig frame stands, relative poses are as sure. What priors hold stays as sure as they are.
    """
    if np.ptp(widening) == 0 and widening[0] == 1:
        return joint.covariance
    adjustment, observations = joint.adjustment, joint.observations
    tables, columns = adjustment.layout, len(adjustment.columns)
    gram = adjustment.linearised.gram if adjustment.eliminated is None else adjustment.eliminated.gram
    noisy = normal_equations(
        observations, tables, adjustment.state, gram * widening[observations.camera][:, None, None]
    )
    through = adjustment.normal.pairs @ joint.reduced.node_inverse[tables.pair_node]
    left, right = tables.meeting_left, tables.meeting_right
    back = np.swapaxes(through[right], -1, -2)
    met = through[left] @ (noisy.nodes[tables.pair_node[left]] @ back - np.swapaxes(noisy.pairs[right], -1, -2))
    blocks = tables.meeting_by_block(met - noisy.pairs[left] @ back)
    own = noisy.cameras
    own[:, :columns, :columns] += joint.free.information[:, adjustment.columns[:, None], adjustment.columns]
    blocks[tables.diagonal] += own[tables.block_left[tables.diagonal]]
    spread = block_matrix(blocks, tables.block_left, tables.block_right, observations.cameras)
    result = joint.covariance @ (spread @ joint.covariance)
    return (result + result.T) / 2


def with_weak_focals(joint: Joint, covariance: Floats) -> Floats:
    """The covariance (C M, C M) with the focals as unsure as the real tilts of their Views leave them, all that hangs
    on them following."""
    cameras, share = joint.observations.cameras, joint.priors.focal_share
    covariance = covariance.copy()
    for camera in np.flatnonzero(share < 1):
        focal = camera * (len(covariance) // cameras)
        if covariance[focal, focal] > 0:
            along = covariance[:, focal] / np.sqrt(covariance[focal, focal])
            covariance += (1 / share[camera] - 1) * np.outer(along, along)
    return covariance
