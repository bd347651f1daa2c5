"""The pose graph: cameras, bodies and the rectangles on them, joined by Views.

Relative poses of two cameras come from everything that both see, of two rectangles from every camera that sees both;
all readings and twins vote, the largest agreement wins, and the paths of least uncertainty chain Eq. 50 into the rig
frame (together.py, relative_poses.py).
"""

from collections.abc import Container
from dataclasses import dataclass

import numpy as np

from quadrig.rig.problem.build import Problem
from quadrig.rig.start.lenses_and_poses import Candidates
from quadrig.rig.start.motion_ties import MotionTie, tied_together
from quadrig.rig.start.relative_poses import AGREES
from quadrig.rig.start.seen_poses import SeenPoses, best_by_key, distance_rows, likeliest
from quadrig.rig.start.together import Together, camera_from_cluster, in_frame
from quadrig.single.arrays import Ints, Mask
from quadrig.single.pose import Pose


@dataclass(frozen=True, eq=False)
class FirstRig:
    """Poses to start the joint adjustment from.

    camera_from_rig (C,): identity for cameras that are not connected; connected (C,) bool. rig_from_body (N,).
    body_from_rect (L,) of the problem's layouts; together: what ties cameras and rectangles; by_motion: which only
    a motion ties, and what that shows of them.
    reading (V,): of each View; agrees (V,) bool: False where no candidate of the View fits the others.
    """

    camera_from_rig: Pose
    connected: Mask
    rig_from_body: Pose
    body_from_rect: Pose
    together: Together
    reading: Ints
    agrees: Mask
    by_motion: tuple[MotionTie, ...] = ()


def first_rig(problem: Problem, candidates: Candidates, reference: int, level: Container[str] = ()) -> FirstRig:
    """Poses of all that is connected to the reference camera, in its frame. level: bodies that are known to turn
    about one axis alone."""
    together, by_motion = tied_together(problem, candidates, reference, level)
    connected = together.cameras.group == reference
    camera_from_rig = together.cameras.item_from_group[np.where(connected, np.arange(len(connected)), reference)]
    names = {name: row for row, name in enumerate(problem.rectangles)}
    on_bodies = np.array([names[name] for name in problem.layouts.names], int)
    body_from_rect = together.rectangles.item_from_group[on_bodies].inverse()
    usable = connected[problem.camera] & in_frame(problem, together)[problem.rectangle]
    rig_from_body, choice, agrees = _place_nodes(
        problem, candidates, camera_from_rig, usable[candidates.view], together
    )
    reading = candidates.reading[choice]
    return FirstRig(camera_from_rig, connected, rig_from_body, body_from_rect, together, reading, agrees, by_motion)


def _place_nodes(
    problem: Problem, candidates: Candidates, camera_from_rig: Pose, usable: Mask, together: Together
) -> tuple[Pose, Ints, Mask]:
    """rig_from_body (N,), the candidate chosen of every View (V,), and whether it agrees with its node (V,)."""
    node, camera = problem.node[candidates.view], problem.camera[candidates.view]
    pose, rotation, translation = camera_from_cluster(problem, candidates, together.rectangles)
    seen = SeenPoses(node, camera_from_rig[camera].inverse() @ pose, rotation, translation, usable)
    best = likeliest(problem, candidates, seen, len(problem.nodes))
    gap = distance_rows(seen, np.arange(len(node)), best[node])
    choice = best_by_key(
        np.where(usable, -gap - 1e-6 * candidates.cost, -np.inf), candidates.view, len(problem.views)
    )
    return seen.pose[best], choice, gap[choice] < AGREES


def loose_rectangles(problem: Problem, together: Together) -> dict[str, str]:
    """The rectangles that were seen, but that nothing ties to the frame of their body, each with the first of those
    that it makes a body of its own with."""
    tied, names = in_frame(problem, together), list(problem.rectangles)
    root = together.rectangles.group
    return {names[row]: names[root[row]] for row in np.unique(problem.rectangle) if not tied[row]}
