"""From Views to a Rig: the one call that runs pose graph, chain and joint adjustment."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quadrig.rig.blas_threads import one_thread
from quadrig.rig.culprits.bodies import apart, loose_rectangle, suspects
from quadrig.rig.culprits.cameras import Solve, contradicting_camera, why_it_contradicts
from quadrig.rig.culprits.carried import carried_sentence, may_be_carried, through_a_room
from quadrig.rig.culprits.lenses import freed, lens_sentences, wrong_lenses
from quadrig.rig.culprits.pictures import no_pictures, set_aside, size_sentences
from quadrig.rig.culprits.sheets import measured, resized, wrong_size
from quadrig.rig.culprits.surveys import found_instead, misplaced
from quadrig.rig.doubt.weaknesses import never_seen
from quadrig.rig.joint.assemble import assemble_rig
from quadrig.rig.joint.clock_rounds import Solved, solve_with_clocks
from quadrig.rig.joint.stages import Contradicted
from quadrig.rig.problem.build import Problem, absurd_sentence, absurd_views, build_problem, of_cameras, rebuilt
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.problem.connectivity import components, contradiction, missing_cameras, refuse
from quadrig.rig.result import Rig
from quadrig.rig.start.in_step import groups_in_step
from quadrig.rig.start.lenses_and_poses import first_cameras
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# More sizes than these are not wrong by mistake.
_MOST_WRONG_SIZES = 3
# Of rectangles that may have moved on their body so many are tried, those first of which most Views were rejected.
_MOST_LOOSE = 3


def calibrate(
    cameras: Sequence[CameraInput],
    rectangles: Sequence[Rectangle],
    views: Sequence[View],
    reference: str | None = None,
) -> Rig:
    """The rig that the Views of these cameras and rectangles show; of one camera it is its lens.

    reference: the camera, or the rectangle, whose frame is the rig frame (the world's, where the rectangle is
    surveyed); the first camera that can be placed where None. Cameras that share nothing with the largest rig are
    not placed: Rig.missing says why, and Rig.apart has their lenses; so are cameras that the others contradict. Views
    that cannot be right, and given lenses that the Views rule out, are left out and named in Rig.weak, and so are
    rectangles that nobody saw. Raises QuadrigError where nothing was seen, or the Views determine no camera.
    """
    whole = build_problem(cameras, rectangles, views, reference)
    sound = set_aside(whole.cameras, whole.views)
    if sound.said or sound.lost:
        whole = rebuilt(whole, cameras=sound.cameras, views=sound.views)
    unusable = sound.lost | (no_pictures(whole) if whole.views else {})
    if unusable:
        left = [view for view in whole.views if view.camera not in unusable]
        whole = rebuilt(whole, views=left)
    if not whole.views:
        raise QuadrigError("; ".join(unusable.values())) if unusable else refuse(whole)
    named = _reference(whole, cameras, reference)
    order = [camera.name for camera in cameras]

    def solve(problem: Problem) -> list[Rig]:
        return sorted(_rigs(problem, order, named), key=lambda rig: _rank(rig, order, named))

    rigs, agreeing, lost = _in_agreement(whole, solve)
    if not rigs:
        raise QuadrigError(
            f"the {len(whole.views)} Views of {len(whole.cameras)} cameras do not determine a rig; "
            "show more rectangles, tilted, to more cameras at once"
        )
    first, *apart = rigs
    if named in whole.rectangles and first.reference != named:
        raise QuadrigError(
            f"reference {named!r} was seen by no camera of the rig; show it, or take another reference"
        )
    names = {camera.name for camera in first.cameras}
    placed = [index for index, camera in enumerate(agreeing.cameras) if camera.name in names]
    missing = missing_cameras(agreeing, placed) | lost | unusable
    said = (*map(absurd_sentence, absurd_views(views)), *sound.said)
    return replace(
        first, missing=missing, apart=tuple(apart), weak=(*said, *first.weak, *never_seen(rectangles, views))
    )


def _in_agreement(whole: Problem, solve: Solve) -> tuple[list[Rig], Problem, dict[str, str]]:
    """The rigs, the largest first, cameras that the others contradict each by itself; the problem without these, and
    a sentence of each of them."""
    rigs, agreeing, out = solve(whole), whole, []
    while rigs and (name := contradicting_camera(agreeing, rigs[0], solve)):
        out.append(name)
        agreeing = of_cameras(agreeing, [i for i, one in enumerate(agreeing.cameras) if one.name != name])
        rigs = solve(agreeing)
    lost = {}
    for name in out:
        alone = solve(of_cameras(whole, [i for i, one in enumerate(whole.cameras) if one.name == name]))
        suspects = [i for i, one in enumerate(whole.cameras) if one.name == name or one.name not in out]
        why = why_it_contradicts(of_cameras(whole, suspects), name, alone[0] if alone else None, solve)
        lost[name] = why or contradiction(name)
        rigs += alone
    return rigs, agreeing, lost


@one_thread
def _rigs(problem: Problem, order: Sequence[str], reference: str | None) -> list[Rig]:
    """A rig for each group of cameras that share rectangles and agree; none for one whose Views determine nothing."""
    rigs: list[Rig] = []
    for group in components(problem):
        part = of_cameras(problem, group)
        if not part.views:
            continue
        placed = [name for name in order if name in {camera.name for camera in part.cameras}]
        frame = reference if reference is not None and _has_frame(part, reference) else placed[0]
        solved = _solved(_as_seen(part, frame), frame)
        if not isinstance(solved, Solved) or solved.joint.adjustment.state.slack is not None:
            together = _groups_in_step(part)
            if len(together) > 1:
                for own in together:
                    rigs += _rigs(of_cameras(part, own), order, reference)
                continue
        if solved is None:
            continue
        if isinstance(solved, Contradicted):
            # What contradicts the others is solved without them, and they without it.
            numbers = range(len(part.cameras))
            for loose in (False, True):
                own = [i for i in numbers if (part.cameras[i].name in solved.names) is loose]
                rigs += _rigs(of_cameras(part, own), order, reference)
            continue
        solved, carried = _as_carried(solved, frame)
        solved, surveys = _with_surveys(solved, frame)
        solved, loose = _with_loose_rectangles(solved, frame)
        solved, sizes = _with_sizes(solved, frame)
        rig = assemble_rig(solved.problem, solved.joint, solved.first, frame, placed)
        accused = (
            *carried,
            *surveys,
            *loose,
            *sizes,
            *lens_sentences(part.cameras, wrong_lenses(solved), rig),
            *size_sentences(rig),
        )
        rigs.append(replace(rig, weak=(*accused, *rig.weak)))
    return rigs


def _solved(problem: Problem, frame: str) -> Solved | Contradicted | None:
    """The rig in that frame; None where the Views do not determine one."""
    try:
        # A fit that runs away overflows before it is given up.
        with np.errstate(over="ignore", invalid="ignore"):
            return solve_with_clocks(problem, frame)
    except np.linalg.LinAlgError:
        return None


def _groups_in_step(problem: Problem) -> list[list[int]]:
    """Cameras (indices) that saw rectangles at the same instants; each by itself where nothing can be said."""
    try:
        return groups_in_step(problem, first_cameras(problem).candidates)
    except np.linalg.LinAlgError:
        return [[index] for index in range(len(problem.cameras))]


def _as_carried(solved: Solved, frame: str) -> tuple[Solved, list[str]]:
    """The rig as carried past what was said to stand still, where the Views have it so; and what to say."""
    # A rectangle that is the rig frame stands still in it.
    if frame in solved.problem.rectangles or not may_be_carried(solved):
        return solved, []
    again = _solved(through_a_room(solved.problem), frame)
    said = carried_sentence(solved, again) if isinstance(again, Solved) else ""
    return (again, [said]) if said and isinstance(again, Solved) else (solved, [])


def _with_surveys(solved: Solved, frame: str) -> tuple[Solved, list[str]]:
    """The rig with the poses on bodies found that were given, but that all others contradict; and what to say."""
    said: list[str] = []
    while len(said) < _MOST_LOOSE and (wrong := misplaced(solved)):
        again = _solved(found_instead(solved.problem, wrong.name), frame)
        if not isinstance(again, Solved):
            break
        said.append(wrong.sentence)
        solved = again
    return solved, said


def _with_loose_rectangles(solved: Solved, frame: str) -> tuple[Solved, list[str]]:
    """The rig with rectangles that moved on their body, or do not stand on it as given, by themselves; and what to
    say."""
    said: list[str] = []
    for name in suspects(solved)[:_MOST_LOOSE]:
        if name == frame:
            continue
        again = _solved(apart(solved.problem, name), frame)
        found = loose_rectangle(name, solved, again) if isinstance(again, Solved) else None
        if found is not None and isinstance(again, Solved):
            said.append(found.sentence)
            solved = again
    return solved, said


def _with_sizes(solved: Solved, frame: str) -> tuple[Solved, list[str]]:
    """The rig with rectangles of the sizes that it shows, where some that were given are wrong; and what to say."""
    said: list[str] = []
    while len(said) < _MOST_WRONG_SIZES and (wrong := wrong_size(solved)):
        again = _solved(resized(solved.problem, wrong), frame)
        if not isinstance(again, Solved):
            break
        before, after = (int(one.joint.inliers.rejected.sum()) for one in (solved, again))
        if after > before or (after == before and again.joint.noise >= solved.joint.noise):
            break
        found = measured(wrong, again)
        if not found.stands:
            break
        said.append(found.sentence(solved.problem))
        solved = again
    return solved, said


def _as_seen(part: Problem, frame: str) -> Problem:
    """The problem with the lenses that are fixed, but ruled out by the Views, left to be estimated."""
    if not any(camera.fixed for camera in part.cameras):
        return part
    trial = _solved(freed(part), frame)
    wrong = wrong_lenses(trial) if isinstance(trial, Solved) else set()
    cameras = tuple(replace(camera, fixed=camera.fixed and camera.name not in wrong) for camera in part.cameras)
    return replace(part, cameras=cameras)


def _has_frame(problem: Problem, reference: str) -> bool:
    """Whether a camera or a rectangle of that name can be the frame of this problem's rig."""
    if reference in {camera.name for camera in problem.cameras}:
        return True
    return reference in problem.rectangles and problem.frame_node(reference) is not None


def _rank(rig: Rig, order: Sequence[str], reference: str | None) -> tuple[int, bool, int]:
    """The largest rig comes first; of equals the one with the reference, then the one with the first camera."""
    names = [camera.name for camera in rig.cameras]
    return -len(names), rig.reference != reference, min(order.index(name) for name in names)


def _reference(problem: Problem, cameras: Sequence[CameraInput], reference: str | None) -> str | None:
    """The reference as it was asked for. Raises QuadrigError where it is nothing that can be one."""
    if reference is None or reference in {camera.name for camera in cameras}:
        return reference
    if reference not in problem.rectangles:
        raise QuadrigError(
            f"reference {reference!r} is neither a camera nor a rectangle; "
            f"cameras are {', '.join(c.name for c in cameras)}, rectangles {', '.join(problem.rectangles)}"
        )
    if problem.rectangles[reference].moving:
        raise QuadrigError(f"reference {reference!r} moves; take a camera or a rectangle that stands still")
    return reference
