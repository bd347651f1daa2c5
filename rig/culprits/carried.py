"""A rig that was carried past what is said to stand still: seen from it, the room is what moves."""

from dataclasses import replace

import numpy as np

from quadrig.rig.joint.clock_rounds import Solved
from quadrig.rig.problem.build import Problem, rebuilt
from quadrig.rig.result import ROOM
from quadrig.rig.words import listed

# Rigs that stand reject fewer of their Views than this, whatever else is wrong ...
_REJECTED = 0.5
# ... and one that is taken for carried and was rejects hardly any.
_STILL_REJECTED = 0.1


def may_be_carried(solved: Solved) -> bool:
    """Whether most Views contradict that both the rig and some rectangles stand still."""
    rejected = solved.joint.inliers.rejected
    still = not all(rectangle.moving for rectangle in solved.problem.rectangles.values())
    return still and bool(rejected.mean() > _REJECTED)


def through_a_room(problem: Problem) -> Problem:
    """The problem with all that stands still on bodies that move as one: those it stands on, else the room."""
    rectangles = [
        one if one.moving else replace(one, moving=True, body=one.body or ROOM) for one in problem.rectangles.values()
    ]
    return rebuilt(problem, views=problem.views, rectangles=rectangles)


def carried_sentence(before: Solved, after: Solved) -> str:
    """That the rig was carried, and how rig.toml says so; empty where its Views contradict that as well."""
    if np.mean(after.joint.inliers.rejected) > _STILL_REJECTED:
        return ""
    seen = {view.rectangle for view in before.problem.views}
    every = before.problem.rectangles.values()
    still = [repr(one.name) for one in every if one.name in seen and not one.moving]
    cameras = listed([camera.name for camera in before.problem.cameras])
    return (
        f"{cameras} moved past {listed(still)}, which rig.toml has standing still: taken for carried through a room; "
        f'say so, body = "{ROOM}" in each of them, and a [[body]] of that name with moving = true'
    )
