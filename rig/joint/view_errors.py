"""Errors of whole Views: a rectangle that moved between two cameras' shutters, or while one picture was read out.

All corners of a View share such an error, so that they do not average out over its points as noise does. Its size is
learned from how far Views stray from where the rig predicts them, beyond what noise makes them stray (a variance
component by the method of moments), with no threshold: where there is none, none is found.
"""

import numpy as np

from quadrig.rig.adjustment.schur import node_inverses
from quadrig.rig.adjustment.state import chain_derivatives
from quadrig.rig.joint.residual_noise import shown_nodes
from quadrig.rig.joint.stages import Joint
from quadrig.rig.problem.build import Problem
from quadrig.single.arrays import Floats, Mask

# A camera's own figure counts for as much as that of all together once it has so many Views.
_TRUSTED_VIEWS = 10.0


def view_error_variances(problem: Problem, joint: Joint) -> Floats:
    """Variances (V, 6), rad^2 and m^2, of a step of each View's camera_from_rect beside the noise of its corners.

    Rectangles that stand still and those that move have figures of their own, and so has each camera.
    """
    variances = np.zeros((len(problem.views), 6))
    if joint.adjustment.eliminated is not None:
        # The slack of Views is in the fit already.
        return variances
    for kind in (problem.moving, ~problem.moving):
        chosen = kind & ~joint.inliers.rejected
        if chosen.any():
            variances[kind] = _of_kind(joint, chosen)[problem.camera[kind]]
    return variances


def _of_kind(joint: Joint, chosen: Mask) -> Floats:
    """Variances (C, 6) from the Views (V,) that are chosen."""
    seen, expected, slope = _moments(joint, chosen)
    camera, cameras = joint.observations.camera[chosen], joint.observations.cameras
    excess = np.zeros((cameras, 2))
    slopes = np.zeros((cameras, 2, 2))
    np.add.at(excess, camera, seen - expected)
    np.add.at(slopes, camera, slope)
    share = _TRUSTED_VIEWS / len(camera)
    variances = np.zeros((cameras, 2))
    for row in range(cameras):
        right = excess[row] + share * excess.sum(axis=0)
        variances[row] = _not_negative(slopes[row] + share * slopes.sum(axis=0), right)
    return np.repeat(variances, 3, axis=1)


def _moments(joint: Joint, chosen: Mask) -> tuple[Floats, Floats, Floats]:
    """Of each View by how much chi-square would fall if it were free to turn (V, 0) or to shift (V, 1): what is seen,
    what noise is expected to make it, and by how much more it is for each unit of either variance (V, 2, 2)."""
    adjustment, observations = joint.adjustment, joint.observations
    gram = adjustment.linearised.gram[chosen]
    own, gradient = gram[:, -7:-1, -7:-1], gram[:, -7:-1, -1]
    by_node = chain_derivatives(observations, adjustment.state).by_node
    inverse = node_inverses(adjustment.normal)[observations.node[chosen]]
    moved = by_node[chosen] @ inverse @ np.swapaxes(by_node[chosen], 1, 2)
    # What the fit of the rectangle poses leaves of a View's error; that of the cameras takes its share of all. One
    # camera or rectangle pose holds the frame: that is six fewer in all.
    left = own - own @ moved @ own
    shown, used = shown_nodes(observations), ~joint.inliers.rejected
    # A pose that one View alone tells takes all of its error: what rounding leaves is nothing to learn from.
    alone = np.bincount(observations.node[used], minlength=len(shown)) == 1
    left[(alone & joint.free.node)[observations.node[chosen]]] = 0.0
    unknowns = float(joint.reduced.free.sum()) - 6.0 * float((shown & ~joint.free.node).sum())
    free = 6.0 * float((~joint.inliers.rejected).sum()) - 6.0 * float(shown.sum())
    kept = max(0.0, 1 - unknowns / free) if free > 0 else 0.0
    seen, expected, slope = np.zeros((len(gram), 2)), np.zeros((len(gram), 2)), np.zeros((len(gram), 2, 2))
    for row, part in enumerate((slice(0, 3), slice(3, 6))):
        inverse = np.linalg.pinv(own[:, part, part], hermitian=True)
        pull = gradient[:, part, None]
        seen[:, row] = (np.swapaxes(pull, 1, 2) @ inverse @ pull)[:, 0, 0]
        expected[:, row] = kept * np.einsum("vij,vji->v", inverse, left[:, part, part])
        for column, other in enumerate((slice(0, 3), slice(3, 6))):
            passed = left[:, part, other] @ own[:, other, part]
            slope[:, row, column] = kept * np.einsum("vij,vji->v", inverse, passed)
    return seen, expected, slope


def _not_negative(matrix: Floats, right: Floats) -> Floats:
    """The least-squares solution (2,) of a system of two, no element below zero: the best of those that are free,
    where the others are zero."""
    diagonal = np.diagonal(matrix)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    scaled, aim = matrix / scale / scale[:, None], right / scale
    best, least = np.zeros(2), float(aim @ aim)
    for free in ([0], [1], [0, 1]):
        found = np.zeros(2)
        found[free] = np.linalg.lstsq(scaled[:, free], aim)[0]
        off = aim - scaled @ found
        if (found >= 0).all() and off @ off < least:
            best, least = found, float(off @ off)
    return best / scale
