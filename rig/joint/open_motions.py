"""How cameras stand to others that the motion of a body alone ties them to, where it shows that ill.

Noise looks like motion: it moves poses that were found, and the fit takes that for knowledge. So what the poses say
of each small motion of the cameras is held against their noise, as tilts of sheets are for focals.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quadrig.rig.joint.stages import Joint
from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.layouts import body_of
from quadrig.rig.start.hand_eye import NO_EVIDENCE
from quadrig.rig.start.motion_ties import MotionTie
from quadrig.rig.start.shown_by_motion import REAL, shown_by_motion
from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose, step_by_left_twist

# Sigmas of what nothing is known of: a turn that may be any (rad, a whole turn's), and a position (m): no rig is
# larger.
_UNKNOWN = np.repeat([np.pi / np.sqrt(3), 10.0], 3)
# Sigma of a turn (rad) from which its axis is one that it may turn about.
_TURNS = 0.3
# So many turns, evenly all round, stand for any.
_ROUND = 24
# Within 8 degrees of an axis a direction is called by its name.
_ALONG = 0.99


def judged(problem: Problem, joint: Joint, ties: Sequence[MotionTie]) -> tuple[MotionTie, ...]:
    """The same with what the poses at the end of an adjustment show."""
    if not ties:
        return ()
    camera_node = np.unique(np.stack([problem.node, problem.camera])[:, ~joint.inliers.rejected], axis=1)
    cameras = np.bincount(camera_node[0], minlength=len(problem.nodes))
    # What all share, lenses and layouts, is no noise of a motion, but for the tilts that it passes on.
    covariance = joint.reduced.node_inverse + np.diag(np.repeat([NO_EVIDENCE**2 / 2, 0.0], 3))
    result = []
    for one in ties:
        own = [node.body == one.body and node.frameset >= 0 for node in problem.nodes]
        rows = np.flatnonzero(np.array(own) & (cameras > 1))
        result.append(replace(one, shown=shown_by_motion(joint.predicted.rig_from_body[rows], covariance[rows])))
    return tuple(result)


def with_open_motions(problem: Problem, joint: Joint, ties: Sequence[MotionTie], covariance: Floats) -> Floats:
    """The covariance (E M, E M) with what the motion shows as unsure as that leaves it: by the share of what it says
    that is real, all that hangs on it following, and where that is nothing, unknown."""
    if not ties:
        return covariance
    covariance, size = covariance.copy(), joint.reduced.free.shape[1]
    twist = len(joint.adjustment.columns) + np.arange(6)
    for one in ties:
        camera = int(np.flatnonzero(one.cameras)[0])
        columns, beside = camera * size + twist, one.beside * size + twist
        between = covariance[:, columns] - covariance[:, beside]
        for dual, share in zip(one.shown.duals, one.shown.share, strict=True):
            if share > REAL:
                along = between @ dual
                variance = float(dual @ (along[columns] - along[beside]))
                covariance += (1 / share - 1) / variance * np.outer(along, along)
        moved = _moved(problem, joint, one)
        covariance += moved @ moved.T
    return covariance


def _unknown(tie: MotionTie) -> Floats:
    """A root (6, K) of the covariance of the twist of cameras of which nothing is known but that it is open."""
    basis = tie.open
    information = basis.T @ (basis / _UNKNOWN[:, None] ** 2)
    return basis @ np.linalg.cholesky(np.linalg.inv(information))


def _moved(problem: Problem, joint: Joint, tie: MotionTie) -> Floats:
    """A root (E M, S) of what all units may be off where the cameras move as the motion leaves them open, and with
    them what they see."""
    units, size = joint.reduced.free.shape
    motions, weights = _motions(tie)
    result = np.zeros((units, size, len(weights)))
    twist, state = len(joint.adjustment.columns) + np.arange(6), joint.adjustment.state
    rows = np.flatnonzero(tie.cameras)
    result[rows[:, None], twist] = -_apparent(motions, state.camera_from_rig[rows].inverse())
    node = next(i for i, node in enumerate(problem.nodes) if node.body == tie.body)
    rig_from_body = state.rig_from_body[node]
    bodies = np.array([body_of(rectangle) == tie.body for rectangle in problem.rectangles.values()])
    frame = bodies & (problem.layouts.number < 0)
    if (frame & tie.rectangles).any():
        # Where the body's frame is among what moves, it is the others that move back.
        moved, motions = bodies & ~tie.rectangles, motions.inverse()
    else:
        moved = bodies & tie.rectangles
    layouts = problem.layouts.number[moved]
    layouts = layouts[(layouts >= 0) & (layouts < problem.layouts.found)]
    on_body = rig_from_body.inverse() @ motions @ rig_from_body
    result[(len(tie.cameras) + layouts)[:, None], twist] = _apparent(on_body, state.body_from_rect[layouts])
    return (result * weights).reshape(units * size, len(weights))


def _motions(tie: MotionTie) -> tuple[Pose, Floats]:
    """Motions (S,) of the rig frame, and weights (S,), that stand for all that is open: turns all the way round."""
    twists, turns = _open_twists(tie)
    angles = np.pi * (2 * np.arange(_ROUND) + 1 - _ROUND) / _ROUND
    every, weights = [twists[:, turns:]], [np.ones(twists.shape[1] - turns)]
    for turn in twists.T[:turns]:
        every.append(np.asarray(np.outer(turn / np.linalg.norm(turn[:3]), angles), float))
        weights.append(np.full(_ROUND, 1 / np.sqrt(_ROUND)))
    return Pose.from_twist(np.concatenate(every, axis=1).T), np.concatenate(weights)


def _apparent(motions: Pose, poses: Pose) -> Floats:
    """Twists (P, 6, S) whose linear steps are those of poses (P,) by motions (S,) of any length: a turn takes what is
    off its axis along a circle, which no small twist does."""
    moved = motions[None] @ poses[:, None]
    steps = poses[:, None].step_to(moved)
    return np.asarray(np.linalg.solve(step_by_left_twist(poses), np.swapaxes(steps, -1, -2)), float)


def open_motions(problem: Problem, ties: Sequence[MotionTie]) -> list[str]:
    """A sentence for each camera, or several that are tied, of which the motion does not show how they stand."""
    sentences = []
    for one in ties:
        if one.open.size:
            names = " and ".join(problem.cameras[row].name for row in np.flatnonzero(one.cameras))
            sentences.append(
                f"{names}: {_what_is_open(one)} of the rig frame cannot be known, since everything turned about "
                f"{'one fixed' if _open_twists(one)[1] else 'that'} axis alone; turn the rig about a second axis"
            )
    return sentences


def _open_twists(tie: MotionTie) -> tuple[Floats, int]:
    """Twists (6, K) that are unknown, those that turn first, and how many of these there are."""
    root = _unknown(tie)
    _, sigmas, combined = np.linalg.svd(root[:3])
    return root @ combined.T, int((sigmas > _TURNS).sum())


def _what_is_open(tie: MotionTie) -> str:
    """The turns and positions that are unknown, in words."""
    twists, turns = _open_twists(tie)
    said = [f"the turn about {_direction(twist[:3])}" for twist in twists.T[:turns]]
    said += [f"the position along {_direction(twist[3:])}" for twist in twists.T[turns:]]
    return " and ".join(said)


def _direction(vector: Floats) -> str:
    """A direction in words: its numbers, or the name of the axis that it is nearly along."""
    axis = vector / np.linalg.norm(vector)
    largest = int(np.argmax(np.abs(axis)))
    if abs(axis[largest]) > _ALONG:
        return "xyz"[largest]
    return "(" + ", ".join(f"{value:.2f}" for value in axis * np.sign(axis[largest])) + ")"
