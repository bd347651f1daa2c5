"""From Views to a Rig: the one call that runs graph, chain and joint adjustment."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quadrig.rig.joint.assemble import (
    assemble_rig,
    camera_covariance,
)
from quadrig.rig.joint.stages import Contradicted, Joint, solve_jointly
from quadrig.rig.problem.build import Problem, build_problem, components
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.problem.connectivity import missing_cameras, refuse
from quadrig.rig.result import Rig
from quadrig.rig.start.clock_offsets import InStep, in_step, path_offsets
from quadrig.rig.start.lenses_and_poses import Start, start
from quadrig.rig.start.pose_graph import FirstRig, first_rig
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# Framesets grouped by clocks that were off by more than this (s) are grouped again: a hand moves a quarter of a mm.
_SAME_CLOCK = 0.5e-3
_ROUNDS_OF_CLOCKS = 6
# Noise of the joint fit over that of the cameras by themselves, up to which nobody is out of step.
_AGREE = 1.1


def calibrate(
    cameras: Sequence[CameraInput],
    rectangles: Sequence[Rectangle],
    views: Sequence[View],
    reference: str | None = None,
) -> Rig:
    """The rig that the Views of these cameras and rectangles show.

    reference: the camera, or the rectangle, whose frame is the rig frame (the world's, where the rectangle is
    surveyed); the first camera that can be placed where None. Cameras that share nothing with the largest rig are
    left out and named in Rig.missing. Raises QuadrigError where no two cameras can be brought into one frame.
    """
    whole = build_problem(cameras, rectangles, views)
    kept = _largest(whole, reference)
    try:
        return _solve(whole, kept, cameras, reference)
    except np.linalg.LinAlgError:
        raise QuadrigError(
            f"the {len(whole.views)} Views of {len(whole.cameras)} cameras do not determine a rig; "
            "show more rectangles, tilted, to more cameras at once"
        ) from None
    except Contradicted as found:
        agreeing = [camera for camera in cameras if camera.name not in found.names]
        if len(agreeing) < 2:
            raise QuadrigError(
                f"the Views of {' and '.join(found.names)} contradict the other cameras throughout; "
                "check that the cameras ran at the same time and the rectangles' sizes are right"
            ) from None
        seen = [view for view in views if view.camera not in found.names]
        rig = calibrate(agreeing, rectangles, seen, reference if reference not in found.names else None)
        said = (
            "what it shares with the other cameras contradicts them; check its clock, and that it looks at this rig"
        )
        return replace(rig, missing={**rig.missing, **{name: f"{name}: {said}" for name in found.names}})


def _solve(whole: Problem, kept: list[int], cameras: Sequence[CameraInput], reference: str | None) -> Rig:
    missing = missing_cameras(whole, kept)
    problem = _of_cameras(whole, kept)
    name = _reference(problem, cameras, reference)
    problem, joint, first = _jointly(problem, name)
    order = [c.name for c in cameras]
    return assemble_rig(problem, joint, first, camera_covariance(joint), name, missing, order)


def _jointly(problem: Problem, name: str) -> tuple[Problem, Joint, FirstRig]:
    """The joint adjustment in the frame of that name; where clocks disagree, of framesets grouped anew by the clocks
    that each round finds."""
    given, (anchor, node) = problem, _anchor(problem, name)
    rounds: list[tuple[Problem, Joint, FirstRig]] = []
    stepped: InStep | None = None
    for _ in range(_ROUNDS_OF_CLOCKS):
        begin = start(problem)
        first = first_rig(problem, begin.candidates, anchor)
        if node is not None:
            first = _in_node_frame(first, node)
        standing = np.arange(len(problem.cameras)) == (anchor if node is None else -1)
        offsets = None if stepped is None else stepped.offsets
        found: Floats | None = None
        try:
            joint = solve_jointly(problem, begin, first, standing, node, offsets)
        except Contradicted:
            if stepped is not None and rounds:
                break
            again = in_step(given, path_offsets(problem, _places(begin)), begin.noise)
            if stepped is not None or again is None:
                raise
        else:
            rounds.append((problem, joint, first))
            found = joint.adjustment.state.offsets
            if offsets is None and found is None and joint.noise < _AGREE * begin.noise:
                break
            if offsets is not None and found is not None and np.ptp(found - offsets) < _SAME_CLOCK:
                break
            found = path_offsets(problem, _places(begin)) if found is None else found
            again = in_step(given, found, begin.noise) or stepped
            if again is None:
                break
        stepped = again if found is None else replace(again, offsets=found)
        problem = build_problem(problem.cameras, list(problem.rectangles.values()), stepped.views)
        anchor, node = _anchor(problem, name)
    # The better Views are grouped, the less noise is left, and no slack.
    return min(rounds, key=lambda one: (one[1].adjustment.state.slack is not None, one[1].noise))


def _places(begin: Start) -> Floats:
    """Where each View's rectangle stands in its camera (V, 3), m, by its likeliest candidate."""
    candidates = begin.candidates
    return candidates.camera_from_node.translation[np.unique(candidates.view, return_index=True)[1]]


def _largest(problem: Problem, reference: str | None) -> list[int]:
    """Indices of the cameras of the largest rig; of equals the one with the reference, then the first by name."""
    groups = components(problem)
    groups = [g for g in groups if len(g) >= 2]
    if not groups:
        raise refuse(problem)
    named = [i for i, camera in enumerate(problem.cameras) if camera.name == reference]
    return max(groups, key=lambda g: (len(g), bool(set(named) & set(g)), [-i for i in g]))


def _of_cameras(problem: Problem, kept: list[int]) -> Problem:
    if len(kept) == len(problem.cameras):
        return problem
    names = {problem.cameras[i].name for i in kept}
    return build_problem(
        [problem.cameras[i] for i in kept],
        list(problem.rectangles.values()),
        [view for view in problem.views if view.camera in names],
    )


def _reference(problem: Problem, cameras: Sequence[CameraInput], reference: str | None) -> str:
    """The reference's name; the first camera of the rig where the one asked for took no part in it."""
    placed = [camera.name for camera in problem.cameras]
    if reference is None or (reference in {c.name for c in cameras} and reference not in placed):
        return next(camera.name for camera in cameras if camera.name in placed)
    if reference in placed:
        return reference
    if reference not in problem.rectangles:
        raise QuadrigError(
            f"reference {reference!r} is neither a camera nor a rectangle; "
            f"cameras are {', '.join(c.name for c in cameras)}, rectangles {', '.join(problem.rectangles)}"
        )
    if problem.rectangles[reference].moving:
        raise QuadrigError(f"reference {reference!r} moves; take a camera or a rectangle that stands still")
    return reference


def _anchor(problem: Problem, reference: str) -> tuple[int, int | None]:
    """The camera that the first rig starts from, and the node whose frame is the rig frame, if it is one's."""
    for index, camera in enumerate(problem.cameras):
        if camera.name == reference:
            return index, None
    rectangle = problem.rectangles[reference]
    key = ("", -1) if rectangle.world_from_rect is not None else (reference, -1)
    for index, node in enumerate(problem.nodes):
        if (node.rectangle, node.frameset) == key:
            return int(problem.camera[problem.node == index][0]), index
    raise QuadrigError(
        f"reference {reference!r} was seen by no camera of the rig; show it, or take another reference"
    )


def _in_node_frame(first: FirstRig, node: int) -> FirstRig:
    rig_from_node = first.rig_from_node[node]
    node_from_rig = rig_from_node.inverse()
    return replace(
        first,
        camera_from_rig=first.camera_from_rig @ rig_from_node,
        rig_from_node=node_from_rig @ first.rig_from_node,
    )
