"""The covariance of the cameras where the noise of each camera's pictures, and of each View, is its own."""

from typing import TYPE_CHECKING

import numpy as np

from quadrig.rig.adjustment.levenberg_marquardt import Adjustment, FreeParameters, with_prior
from quadrig.rig.adjustment.normal_equations import normal_equations
from quadrig.rig.adjustment.schur import Reduced, block_matrix
from quadrig.rig.joint.stages import Joint
from quadrig.rig.problem.observations import Observations
from quadrig.single.arrays import Floats

if TYPE_CHECKING:
    import scipy.sparse


def widened_covariance(joint: Joint, widening: Floats, view_errors: Floats, taken: Floats | None = None) -> Floats:
    """Covariance (E M, E M) of the least-squares solution where the variance of camera c's pixels is widening[c] (C,)
    times what the fit took it for, and each View has an error of its own, of variances view_errors (V, 6): C V C,
    with C the fit's covariance and V that of its reduced gradient; and the doubt of the systematic errors, by which
    what is delivered is moved by taken (E M, U) too.

    Wherever the rig frame stands, relative poses are as sure. What priors hold stays as sure as they are.
    """
    if (widening == 1).all() and not view_errors.any():
        return joint.bordered.widened(None, taken)
    gradient = gradient_covariance(
        joint.observations, joint.adjustment, joint.free, joint.reduced, widening, view_errors
    )
    return joint.bordered.widened(gradient, taken)


def gradient_covariance(
    observations: Observations,
    found: Adjustment,
    free: FreeParameters,
    reduced: Reduced,
    widening: Floats,
    view_errors: Floats,
) -> "Floats | scipy.sparse.csr_array":
    """Covariance (E M, E M) of the reduced gradient at the end of an adjustment, for such noise and errors."""
    tables = found.tables
    gram = found.linearised.gram if found.eliminated is None else found.eliminated.gram
    step = gram[:, -7:-1]
    spread = gram * widening[observations.camera][:, None, None]
    spread = spread + np.swapaxes(step, 1, 2) @ (view_errors[:, :, None] * step)
    noisy = normal_equations(observations, tables, found.state, spread)
    through = found.normal.pairs @ reduced.node_inverse[tables.pair_node]
    left, right = tables.meeting_left, tables.meeting_right
    back = np.swapaxes(through[right], -1, -2)
    met = through[left] @ (noisy.nodes[tables.pair_node[left]] @ back - np.swapaxes(noisy.pairs[right], -1, -2))
    blocks = tables.meeting_by_block(met - noisy.pairs[left] @ back)
    own = with_prior(noisy, found.state, free, found.columns).units
    blocks[tables.diagonal] += own[tables.block_left[tables.diagonal]]
    blocks[tables.tie_block] += noisy.ties
    return block_matrix(blocks, tables.block_left, tables.block_right, tables.units)


def with_weak_focals(joint: Joint, covariance: Floats) -> Floats:
    """The covariance (E M, E M) with the focals as unsure as the real tilts of their Views leave them, all that hangs
    on them following."""
    share, size = joint.priors.focal_share, joint.reduced.free.shape[1]
    weak = np.flatnonzero((share < 1) & (covariance.diagonal()[: size * len(share) : size] > 0))
    if not len(weak):
        return covariance
    # Each widens what the next starts from: only the focals' own columns need to follow, one after another.
    focals, along = size * weak, covariance[:, size * weak]
    for number, camera in enumerate(weak):
        own = along[:, number] / np.sqrt(along[focals[number], number])
        along[:, number + 1 :] += (1 / share[camera] - 1) * np.outer(own, own[focals[number + 1 :]])
        along[:, number] = np.sqrt(1 / share[camera] - 1) * own
    return covariance + along @ along.T
