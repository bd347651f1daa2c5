"""Where cameras that were tied by motion alone stand along the axis that everything turned about.

The motion about a second axis says it, and noise looks like such a motion: it tilts poses that were found, and the
fit takes that for knowledge. So tilts are held against their own noise, as those of sheets are for focals.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quadrig.rig.adjustment.pose_priors import PositionPrior
from quadrig.rig.joint.placed import node_covariances
from quadrig.rig.joint.stages import Joint
from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.layouts import body_of
from quadrig.rig.start.hand_eye import turning
from quadrig.rig.start.motion_ties import WeakPosition
from quadrig.single.arrays import Floats

# Sigma (m) of a position of which nothing is known: no rig is larger.
_UNKNOWN = 10.0
# Within 8 degrees of an axis a direction is called by its name.
_ALONG = 0.99


def judged(problem: Problem, joint: Joint, weak: Sequence[WeakPosition]) -> tuple[WeakPosition, ...]:
    """The same with axis and share as the poses at the end of an adjustment show them."""
    if not weak:
        return ()
    camera_node = np.unique(np.stack([problem.node, problem.camera])[:, ~joint.inliers.rejected], axis=1)
    cameras = np.bincount(camera_node[0], minlength=len(problem.nodes))
    covariance = node_covariances(joint)
    sigma = np.sqrt(np.trace(covariance[:, :3, :3], axis1=1, axis2=2))
    result = []
    for one in weak:
        own = [node.body == one.body and node.frameset >= 0 for node in problem.nodes]
        rows = np.flatnonzero(np.array(own) & (cameras > 1))
        axis, share = turning(joint.predicted.rig_from_body.rotation[rows], sigma[rows])
        result.append(replace(one, axis=axis, share=share))
    return tuple(result)


def with_weak_positions(problem: Problem, joint: Joint, weak: Sequence[WeakPosition], covariance: Floats) -> Floats:
    """The covariance (E M, E M) with positions as unsure as the motion leaves them: by the share of what it says that
    is real, all that hangs on them following, and where that is nothing, unknown."""
    covariance, size = covariance.copy(), joint.reduced.free.shape[1]
    twist = len(joint.adjustment.columns) + np.arange(6)
    for one in weak:
        if not one.is_known:
            row = _shift(problem, joint, one)
            covariance += _UNKNOWN**2 * np.outer(row, row)
            continue
        camera = int(np.flatnonzero(one.cameras)[0])
        own = PositionPrior(camera, one.axis, np.zeros(3), 0.0).by_twist(joint.adjustment.state)
        along = covariance[:, camera * size + twist] @ own
        variance = float(along[camera * size + twist] @ own)
        covariance += (1 / one.share - 1) / variance * np.outer(along, along)
    return covariance


def _shift(problem: Problem, joint: Joint, weak: WeakPosition) -> Floats:
    """Steps (E M,) of all units when the cameras stand a metre farther along the axis, and with them what they
    see."""
    units, size = joint.reduced.free.shape
    result = np.zeros((units, size))
    twist = len(joint.adjustment.columns) + 3 + np.arange(3)
    rows = np.flatnonzero(weak.cameras)
    result[rows[:, None], twist] = -weak.axis
    node = next(i for i, node in enumerate(problem.nodes) if node.body == weak.body)
    on_body = joint.adjustment.state.rig_from_body.rotation[node].T @ weak.axis
    bodies = np.array([body_of(rectangle) == weak.body for rectangle in problem.rectangles.values()])
    frame = bodies & (problem.layouts.number < 0)
    # Where the body's frame is among what moves, it is the others that stand farther back.
    moved, way = (bodies & ~weak.rectangles, -1) if (frame & weak.rectangles).any() else (weak.rectangles, 1)
    layouts = problem.layouts.number[moved]
    layouts = layouts[(layouts >= 0) & (layouts < problem.layouts.found)]
    result[(len(weak.cameras) + layouts)[:, None], twist] = way * on_body
    return result.ravel()


def open_positions(problem: Problem, weak: Sequence[WeakPosition]) -> list[str]:
    """A sentence for each camera, or several that are tied, of which the motion does not show where they stand along
    an axis."""
    sentences = []
    for one in weak:
        if not one.is_known:
            names = " and ".join(problem.cameras[row].name for row in np.flatnonzero(one.cameras))
            sentences.append(
                f"{names}: the position along {_direction(one.axis)} of the rig frame cannot be known, since "
                "everything turned about that axis alone; turn the rig about a second axis"
            )
    return sentences


def _direction(axis: Floats) -> str:
    """An axis in words: its numbers, or the name of the one that it is nearly."""
    largest = int(np.argmax(np.abs(axis)))
    if abs(axis[largest]) > _ALONG:
        return "xyz"[largest]
    return "(" + ", ".join(f"{value:.2f}" for value in axis * np.sign(axis[largest])) + ")"
