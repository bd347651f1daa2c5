"""Cameras and parts of bodies that nothing ties at one time, tied by their motion where that shows how they stand."""

from collections.abc import Container
from dataclasses import dataclass

import numpy as np

from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.layouts import body_of
from quadrig.rig.start.hand_eye import HandEye, Moving, hand_eye
from quadrig.rig.start.lenses_and_poses import Candidates
from quadrig.rig.start.motion_averaging import RelativePose
from quadrig.rig.start.seen_poses import SeenPoses, likeliest
from quadrig.rig.start.shown_by_motion import REAL, Shown
from quadrig.rig.start.together import Ties, Together, camera_from_cluster, seen_together
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.pose import Pose


@dataclass(frozen=True, eq=False)
class MotionTie:
    """Cameras (C,) bool with the rectangles (R,) bool that they see, which the motion of a body alone ties to the
    camera beside (an index) and those with it; shown: what it shows of how they stand to these, in the rig frame."""

    cameras: Mask
    rectangles: Mask
    beside: int
    body: str
    shown: Shown

    @property
    def open(self) -> Floats:
        """Twists (6, K) of the cameras of which the motion says no more than noise does."""
        return self.shown.open


def tied_together(
    problem: Problem, candidates: Candidates, reference: int, level: Container[str] = ()
) -> tuple[Together, tuple[MotionTie, ...]]:
    """All that is tied by what was seen at one time, and then by motion; and what is by motion alone. level: bodies
    that are known to turn about one axis alone."""
    ties, found = Ties(), []
    while True:
        together = seen_together(problem, candidates, reference, ties)
        if not problem.layouts.names or together.cameras.groups == 1:
            break
        best = _best(_motions(problem, candidates, together), problem, reference, level)
        if best is None:
            break
        (group, part), (other_group, other_part), tie = best
        cameras, tied = together.cameras.group == other_group, together.rectangles.group == other_part
        found.append((cameras, tied, group, tie.shown))
        rooted = together.rectangles.item_from_group
        part_from_other = rooted[part] @ tie.part_from_part.inverse() @ rooted[other_part].inverse()
        ties = Ties(
            (*ties.cameras, _relative(group, other_group, tie, tie.one_from_other)),
            (*ties.rectangles, _relative(part, other_part, tie, part_from_other)),
        )
    rig_from_camera = together.cameras.item_from_group.inverse()
    bodies = [body_of(rectangle) for rectangle in problem.rectangles.values()]
    by_motion = [
        MotionTie(cameras, tied, one, bodies[int(np.flatnonzero(tied)[0])], shown.moved(rig_from_camera[one]))
        for cameras, tied, one, shown in found
        if together.cameras.group[one] == reference
    ]
    return together, tuple(by_motion)


def _relative(left: int, right: int, tie: HandEye, left_from_right: Pose) -> RelativePose:
    return RelativePose(left, right, left_from_right, tie.support, tie.voters, tie.sigma)


def _best(
    motions: dict[tuple[int, int], tuple[Ints, Moving]], problem: Problem, reference: int, level: Container[str]
) -> tuple[tuple[int, int], tuple[int, int], HandEye] | None:
    """The tie that most framesets support, those whose positions are known all round first; and of what."""
    found = []
    bodies = [body_of(rectangle) for rectangle in problem.rectangles.values()]
    keys = sorted(motions, key=lambda key: (key[0] != reference, key))
    for place, one in enumerate(keys):
        for other in keys[place + 1 :]:
            if one[0] == other[0] or one[1] == other[1] or bodies[one[1]] != bodies[other[1]]:
                continue
            _, left, right = np.intersect1d(motions[one][0], motions[other][0], return_indices=True)
            moving = motions[one][1].part(left), motions[other][1].part(right)
            tie = hand_eye(*moving, is_level=bodies[one[1]] in level)
            if tie is not None:
                found.append(((tie.share > REAL, tie.support), one, other, tie))
    if not found:
        return None
    _, one, other, tie = max(found, key=lambda entry: entry[0])
    return one, other, tie


def _motions(
    problem: Problem, candidates: Candidates, together: Together
) -> dict[tuple[int, int], tuple[Ints, Moving]]:
    """The poses of each part of a moving body in each group of cameras, by the roots of both, with the framesets."""
    view = candidates.view
    camera, rectangle = problem.camera[view], problem.rectangle[view]
    pose, rotation, translation = camera_from_cluster(problem, candidates, together.rectangles)
    pose = together.cameras.item_from_group[camera].inverse() @ pose
    frameset = np.array([node.frameset for node in problem.nodes], int)[problem.node[view]]
    moving = frameset >= 0
    parts = np.stack([together.cameras.group[camera], together.rectangles.group[rectangle], frameset], axis=1)
    distinct, key = np.unique(parts, axis=0, return_inverse=True)
    key = key.ravel()
    best = likeliest(problem, candidates, SeenPoses(key, pose, rotation, translation, moving), len(distinct))
    found = {}
    for group, part in np.unique(distinct[:, :2], axis=0):
        rows = np.flatnonzero((distinct[:, 0] == group) & (distinct[:, 1] == part) & (distinct[:, 2] >= 0))
        if len(rows):
            chosen = best[rows]
            own = Moving(pose[chosen], rotation[chosen], translation[chosen])
            found[int(group), int(part)] = distinct[rows, 2], own
    return found
