"""The joint adjustment in the frame that was asked for, of framesets that are grouped by the clocks it finds."""

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.joint.open_motions import judged
from quadrig.rig.joint.stages import Contradicted, Joint, solve_jointly
from quadrig.rig.problem.build import Problem, rebuilt
from quadrig.rig.problem.layouts import sheets_of
from quadrig.rig.start.clock_offsets import RegroupedViews, path_clocks, regroup
from quadrig.rig.start.lens_models import with_lens_models
from quadrig.rig.start.lenses_and_poses import FirstCameras, first_cameras
from quadrig.rig.start.motion_ties import MotionTie
from quadrig.rig.start.pose_graph import FirstRig, first_rig, loose_rectangles
from quadrig.single.arrays import Floats

# Framesets grouped by clocks that were off by more than this (s) are grouped again: a hand moves a quarter of a mm.
_SAME_CLOCK = 0.5e-3
_ROUNDS_OF_CLOCKS = 6
# Noise of the joint fit over that of the cameras by themselves, up to which nobody is out of step.
_AGREE = 1.1


@dataclass(frozen=True, eq=False)
class Solved:
    """A problem, its joint adjustment, and the first rig that this started from."""

    problem: Problem
    joint: Joint
    first: FirstRig


def solve_with_clocks(problem: Problem, reference: str) -> Solved | Contradicted:
    """The joint adjustment in the frame of that name; where clocks disagree, of framesets grouped anew by the clocks
    that each round finds. reference: a camera of the problem, or a rectangle that it has a frame of."""
    given, regrouped = problem, None
    rounds: list[Solved] = []
    for _ in range(_ROUNDS_OF_CLOCKS):
        problem, alone = with_lens_models(problem, first_cameras(problem))
        clocks = _given_clocks(problem) if regrouped is None else regrouped.clocks
        problem, first, joint = _one_round(problem, alone, reference, clocks)
        if isinstance(joint, Contradicted):
            if rounds:
                break
            if regrouped is not None:
                return joint
            found = None
        else:
            rounds.append(Solved(problem, joint, first))
            found = joint.adjustment.state.clocks
            if _settled(clocks, found, joint.noise, alone.noise):
                break
        found = path_clocks(problem, _positions(alone)) if found is None else found
        again: RegroupedViews | None = regroup(given, found, alone.noise) or regrouped
        if again is None:
            if isinstance(joint, Contradicted):
                return joint
            break
        regrouped = replace(again, clocks=found)
        problem = rebuilt(problem, views=regrouped.views)
    # The better Views are grouped, the less noise is left, and no slack.
    return min(rounds, key=lambda one: (one.joint.adjustment.state.slack is not None, one.joint.noise))


def _one_round(
    problem: Problem, alone: FirstCameras, reference: str, clocks: Floats | None
) -> tuple[Problem, FirstRig, Joint | Contradicted]:
    first = _first(problem, alone, reference)
    loose = loose_rectangles(problem, first.together)
    if loose:
        # What nothing ties to the rest of its body is a body by itself.
        sheet_of = sheets_of(problem.rectangles)
        rectangles = [
            replace(one, body=f"{one.body} ({loose[sheet_of[name]]})") if sheet_of[name] in loose else one
            for name, one in problem.rectangles.items()
        ]
        problem = rebuilt(problem, views=problem.views, rectangles=rectangles)
        first = _first(problem, alone, reference)
    if not first.connected.all():
        names = [camera.name for camera, tied in zip(problem.cameras, first.connected, strict=True) if not tied]
        return problem, first, Contradicted(tuple(names))
    joint = _joint(problem, alone, first, reference, clocks)
    if isinstance(joint, Joint) and first.by_motion:
        # First lenses tilt what they see: what the motion says of poses is known once all are solved together.
        by_motion = judged(problem, joint, first.by_motion)
        if _open(by_motion) == _open(first.by_motion):
            return problem, replace(first, by_motion=by_motion), joint
        first = _first(problem, alone, reference, {body for body, _ in _open(by_motion)})
        first = replace(first, by_motion=judged(problem, joint, first.by_motion))
        joint = _joint(problem, alone, first, reference, clocks)
    return problem, first, joint


def _open(ties: Sequence[MotionTie]) -> set[tuple[str, int]]:
    """Bodies whose motion leaves open how cameras stand, and in how many directions."""
    return {(one.body, one.open.shape[1]) for one in ties if one.open.size}


def _first(problem: Problem, alone: FirstCameras, reference: str, level: Container[str] = ()) -> FirstRig:
    """The first rig in the frame of that name."""
    anchor, node = _anchor(problem, reference)
    first = first_rig(problem, alone.candidates, anchor, level)
    return first if node is None else _in_node_frame(first, node)


def _joint(
    problem: Problem, alone: FirstCameras, first: FirstRig, reference: str, clocks: Floats | None
) -> Joint | Contradicted:
    anchor, node = _anchor(problem, reference)
    standing = np.arange(len(problem.cameras)) == (anchor if node is None else -1)
    return solve_jointly(problem, alone, first, standing, fixed_node=node, clocks=clocks)


def _given_clocks(problem: Problem) -> Floats | None:
    """The clocks (C, 2) before anything is solved; None where pictures are taken to be of one instant."""
    clocks = problem.first_clocks
    return clocks if clocks.any() else None


def _settled(before: Floats | None, after: Floats | None, noise: float, alone: float) -> bool:
    """Whether the clocks of the next round would be those of this one. noise, alone: px, of the joint fit and of each
    camera by itself."""
    if before is None or after is None:
        return before is None and after is None and noise < _AGREE * alone
    return float(np.ptp((after - before)[:, 0])) < _SAME_CLOCK


def _positions(alone: FirstCameras) -> Floats:
    """The position of each View's rectangle in its camera (V, 3), m, by its likeliest candidate."""
    candidates = alone.candidates
    return candidates.camera_from_rect.translation[np.unique(candidates.view, return_index=True)[1]]


def _anchor(problem: Problem, reference: str) -> tuple[int, int | None]:
    """The camera that the first rig starts from, and the node whose frame is the rig frame, if it is one's."""
    for index, camera in enumerate(problem.cameras):
        if camera.name == reference:
            return index, None
    index = problem.frame_node(reference)
    assert index is not None
    return int(problem.camera[problem.node == index][0]), index


def _in_node_frame(first: FirstRig, node: int) -> FirstRig:
    rig_from_body = first.rig_from_body[node]
    body_from_rig = rig_from_body.inverse()
    return replace(
        first,
        camera_from_rig=first.camera_from_rig @ rig_from_body,
        rig_from_body=body_from_rig @ first.rig_from_body,
        by_motion=tuple(replace(one, shown=one.shown.moved(body_from_rig)) for one in first.by_motion),
    )
