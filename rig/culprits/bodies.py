"""Rectangles that were not fixed to their body, or do not stand on it where they were given, as the others have
it."""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.joint.clock_rounds import Solved
from quadrig.rig.problem.build import Problem, with_sheet
from quadrig.rig.problem.layouts import body_of
from quadrig.rig.words import length
from quadrig.single.arrays import Floats, Ints
from quadrig.single.pose import Pose
from quadrig.single.rotation import vector_from_rotation

# Of the Views of a rectangle so many are rejected where it moved on its body, and so many at least: single Views are
# wrong in one of ten at most.
_REJECTED, _FEWEST = 0.15, 3
# A rectangle that by itself still has this share of those Views rejected was not the culprit.
_STILL_REJECTED = 0.5
# One that moves by itself strays by this share of its width, or turns by this (rad); where all of its Views were
# rejected and it strays less, it has a place on its body that the first rig missed.
_STRAYS = 0.1


@dataclass(frozen=True, eq=False)
class LooseRectangle:
    """A rectangle that is no part of its body. by, turned: how far, m and rad, it stands in the Views that were
    rejected from where it is in the others, or where it was given; framesets (K,): of those Views; of: how many
    framesets saw it; is_given: whether its pose on the body was."""

    name: str
    body: str
    by: float
    turned: float
    framesets: Ints
    of: int
    is_given: bool

    @property
    def sentence(self) -> str:
        """What is wrong, and what to do."""
        off = f"{length(self.by)} and {np.degrees(self.turned):.1f} degrees"
        if self.is_given:
            return (
                f"{self.name!r} does not stand on body {self.body!r} where it was given: the pictures have it {off} "
                "from there; it was taken for a body by itself: measure it again, or let its pose be found"
            )
        where = f"in {len(self.framesets)} of {self.of} framesets, the first of them {int(self.framesets.min())}"
        return (
            f"{self.name!r} moved on body {self.body!r}: by {off} {where}; it was taken for a body by itself: fasten "
            "it, or leave it out of the body"
        )


def suspects(solved: Solved) -> list[str]:
    """Rectangles of bodies of several, so many of whose Views were rejected that they may have moved on it; those of
    most first."""
    problem, rejected = solved.problem, solved.joint.inliers.rejected
    count = np.bincount(problem.rectangle, minlength=len(problem.rectangles))
    lost = np.bincount(problem.rectangle[rejected], minlength=len(problem.rectangles))
    bodies = [body_of(rectangle) for rectangle in problem.rectangles.values()]
    seen = [body for body, own in zip(bodies, count, strict=True) if own]
    rows = [
        row
        for row, name in enumerate(problem.rectangles)
        if lost[row] >= max(_FEWEST, _REJECTED * count[row])
        and problem.rectangles[name].body
        and seen.count(bodies[row]) > 1
    ]
    names = list(problem.rectangles)
    return [names[row] for row in sorted(rows, key=lambda row: -lost[row] / count[row])]


def apart(problem: Problem, name: str) -> Problem:
    """The problem with that rectangle a body by itself, wherever it stood in each frameset."""
    return with_sheet(problem, name, body="", body_from_rect=None, layout_sigma=(0.0, 0.0), moving=True)


def loose_rectangle(name: str, before: Solved, after: Solved) -> LooseRectangle | None:
    """How far that rectangle moved on its body, where it is solved `after` as a body by itself; None where it was not
    what was wrong."""
    rectangle = before.problem.rectangles[name]
    lost_before, lost_after = (_rejected(one, name) for one in (before, after))
    if len(lost_after) > _STILL_REJECTED * len(lost_before):
        return None
    framesets, on_body = _on_body(name, rectangle.body, after)
    moved = np.isin(framesets, lost_before)
    is_given = rectangle.body_from_rect is not None
    if not moved.any():
        return None
    # What stays nowhere is held against the middle of where it was.
    there = rectangle.body_from_rect if is_given else _middle(on_body if moved.all() else on_body[~moved])
    assert there is not None
    off = np.linalg.norm(on_body.translation - there.translation, axis=1)
    angles = np.linalg.norm(vector_from_rotation(there.rotation.T @ on_body.rotation), axis=1)
    by, turned = float(np.median(off[moved])), float(np.median(angles[moved]))
    if moved.all() and not is_given and by < _STRAYS * rectangle.width and turned < _STRAYS:
        return None
    return LooseRectangle(
        name,
        rectangle.body,
        by,
        turned,
        framesets[moved],
        len(framesets),
        is_given,
    )


def _rejected(solved: Solved, name: str) -> Ints:
    """The framesets (K,) of the Views of a rectangle that were rejected."""
    problem = solved.problem
    rows = solved.joint.inliers.rejected & (problem.rectangle == list(problem.rectangles).index(name))
    return np.unique([problem.views[row].frameset for row in np.flatnonzero(rows)])


def _on_body(name: str, body: str, solved: Solved) -> tuple[Ints, Pose]:
    """The pose (F,) of a rectangle that is a body by itself in the frame of another body, and the framesets."""
    nodes = {(node.body, node.frameset): row for row, node in enumerate(solved.problem.nodes)}
    state = solved.joint.predicted
    own = sorted(frameset for one, frameset in nodes if one == name)
    both = [f for f in own if (body, f) in nodes or (body, -1) in nodes]
    bodies = state.rig_from_body[[nodes.get((body, f), nodes.get((body, -1))) for f in both]]
    return np.array(both, int), bodies.inverse() @ state.rig_from_body[[nodes[name, f] for f in both]]


def _middle(poses: Pose) -> Pose:
    """The pose (of F) that is nearest to all in the middle of their positions."""
    off: Floats = np.linalg.norm(poses.translation - np.median(poses.translation, axis=0), axis=1)
    return poses[int(np.argmin(off))]
