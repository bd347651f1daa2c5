"""From Views to a Rig: the one call that runs pose graph, chain and joint adjustment."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quadrig.rig.joint.assemble import assemble_rig, camera_covariance
from quadrig.rig.joint.clock_rounds import solve_with_clocks
from quadrig.rig.joint.stages import Contradicted
from quadrig.rig.problem.build import Problem, build_problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.problem.connectivity import components, missing_cameras, refuse
from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View


def calibrate(
    cameras: Sequence[CameraInput],
    rectangles: Sequence[Rectangle],
    views: Sequence[View],
    reference: str | None = None,
) -> Rig:
    """The rig that the Views of these cameras and rectangles show.

    reference: the camera, or the rectangle, whose frame is the rig frame (the world's, where the rectangle is
    surveyed); the first camera that can be placed where None. Cameras that share nothing with the largest rig are
    not placed, and named in Rig.missing. Raises QuadrigError where no two cameras can be brought into one frame.
    """
    whole = build_problem(cameras, rectangles, views)
    kept = _largest(whole, reference)
    try:
        solved = _solve(whole, kept, cameras, reference)
    except np.linalg.LinAlgError:
        raise QuadrigError(
            f"the {len(whole.views)} Views of {len(whole.cameras)} cameras do not determine a rig; "
            "show more rectangles, tilted, to more cameras at once"
        ) from None
    if not isinstance(solved, Contradicted):
        return solved
    agreeing = [camera for camera in cameras if camera.name not in solved.names]
    if len(agreeing) < 2:
        raise QuadrigError(solved.sentence)
    seen = [view for view in views if view.camera not in solved.names]
    rig = calibrate(agreeing, rectangles, seen, reference if reference not in solved.names else None)
    said = "what it shares with the other cameras contradicts them; check its clock, and that it looks at this rig"
    return replace(rig, missing={**rig.missing, **{name: f"{name}: {said}" for name in solved.names}})


def _solve(
    whole: Problem, kept: list[int], cameras: Sequence[CameraInput], reference: str | None
) -> Rig | Contradicted:
    missing = missing_cameras(whole, kept)
    problem = _of_cameras(whole, kept)
    name = _reference(problem, cameras, reference)
    solved = solve_with_clocks(problem, name)
    if isinstance(solved, Contradicted):
        return solved
    order = [c.name for c in cameras]
    covariance = camera_covariance(solved.joint, solved.joint.covariance)
    return assemble_rig(solved.problem, solved.joint, solved.first, covariance, name, missing, order)


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
