"""One camera was moved: solve it anew, in the rig that the others still make."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quadrig.rig.adjustment.levenberg_marquardt import adjust, undamped
from quadrig.rig.adjustment.schur import dense_matrix
from quadrig.rig.adjustment.state import LENS
from quadrig.rig.joint.assemble import assemble_rig, camera_covariance
from quadrig.rig.joint.stages import Contradicted, Joint, solve_jointly
from quadrig.rig.problem.build import Problem, build_problem, of_cameras
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.problem.connectivity import components
from quadrig.rig.result import CAMERA_PARAMETERS, Rig
from quadrig.rig.start.lenses_and_poses import first_cameras
from quadrig.rig.start.pose_graph import FirstRig, first_rig
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import LENS_PARAMETERS
from quadrig.single.pose import Pose, step_by_camera_twist
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View


def recalibrate(
    rig: Rig,
    moved: Sequence[str],
    cameras: Sequence[CameraInput],
    rectangles: Sequence[Rectangle],
    views: Sequence[View],
) -> Rig:
    """The rig with the moved cameras solved anew from new Views; all others keep lens and pose, to the last bit.

    The doubt of the cameras that stay is passed on to those that are solved. Raises QuadrigError where a name is not
    the rig's, or a moved camera shares no rectangle with one that stays.
    """
    stays = _staying(rig, moved, cameras)
    inputs = [_given(rig, camera) if camera.name in stays else camera for camera in cameras]
    inputs = [camera for camera in inputs if camera.name in stays or camera.name in moved]
    names = {camera.name for camera in inputs}
    problem = build_problem(inputs, rectangles, [view for view in views if view.camera in names])
    problem = _joined(problem, stays, moved)
    standing = np.array([camera.name in stays for camera in problem.cameras])
    alone = first_cameras(problem)
    first = _in_rig_frame(
        problem, rig, first_rig(problem, alone.candidates, int(np.flatnonzero(standing)[0])), standing
    )
    joint = solve_jointly(problem, alone, first, standing)
    if isinstance(joint, Contradicted):
        raise QuadrigError(joint.sentence)
    order = [camera.name for camera in rig.cameras if camera.name in {c.name for c in problem.cameras}]
    covariance = _passed_on(problem, joint, rig, standing)
    solved = assemble_rig(problem, joint, first, rig.reference, order, covariance)
    # Inverting a pose there and back costs its last bits.
    kept = tuple(
        replace(camera, rig_from_camera=rig.camera(camera.name).rig_from_camera) if camera.name in stays else camera
        for camera in solved.cameras
    )
    return _with_absent(rig, replace(solved, cameras=kept), moved)


def _staying(rig: Rig, moved: Sequence[str], cameras: Sequence[CameraInput]) -> set[str]:
    known = [camera.name for camera in rig.cameras]
    recorded = {camera.name for camera in cameras}
    for name in moved:
        if name not in recorded:
            raise QuadrigError(
                f"camera {name!r} is not in the recording; its cameras are {', '.join(sorted(recorded))}"
            )
    stays = {name for name in known if name in recorded and name not in moved}
    if not stays:
        raise QuadrigError(
            f"no camera of the rig stays: it has {', '.join(known)}, recorded are {', '.join(sorted(recorded))}; "
            "record at least one that did not move together with those that did"
        )
    return stays


def _given(rig: Rig, camera: CameraInput) -> CameraInput:
    return replace(camera, intrinsics=rig.camera(camera.name).intrinsics, fixed=True)


def _joined(problem: Problem, stays: set[str], moved: Sequence[str]) -> Problem:
    """The part of the problem that hangs together with the moved cameras."""
    for group in components(problem):
        names = {problem.cameras[i].name for i in group}
        if set(moved) <= names and names & stays:
            return of_cameras(problem, group)
    raise QuadrigError(
        f"{', '.join(moved)} shares no rectangle with a camera that stays ({', '.join(sorted(stays))}); "
        "hold one where both see it at once"
    )


def _in_rig_frame(problem: Problem, rig: Rig, first: FirstRig, standing: Mask) -> FirstRig:
    """The first rig in the frame of the old one, standing cameras where they were."""
    anchor = int(np.flatnonzero(standing)[0])
    rig_from_anchor = rig.camera(problem.cameras[anchor].name).rig_from_camera
    placed = first.camera_from_rig @ rig_from_anchor.inverse()
    rotation, translation = placed.rotation.copy(), placed.translation.copy()
    for row in np.flatnonzero(standing):
        old = rig.camera(problem.cameras[row].name).rig_from_camera.inverse()
        rotation[row], translation[row] = old.rotation, old.translation
    return replace(
        first,
        camera_from_rig=Pose(rotation, translation),
        rig_from_body=rig_from_anchor @ first.rig_from_body,
        by_motion=tuple(replace(one, shown=one.shown.moved(rig_from_anchor)) for one in first.by_motion),
    )


def _passed_on(problem: Problem, joint: Joint, rig: Rig, standing: Mask) -> Floats:
    """Covariance (15 C, 15 C): of the moved cameras by themselves, and what the others' doubt adds to it."""
    free = joint.free.lens.copy()
    for row in np.flatnonzero(standing):
        known = rig.camera(problem.cameras[row].name).free_lens
        free[row] = [name in known for name in LENS_PARAMETERS]
    opened = replace(joint.free, lens=free, pose=np.ones(len(standing), bool), slack=None)
    # The clocks stay where they were found: their doubt is not a rig's.
    state = replace(joint.adjustment.state, motion=None, clocks=None, slack=None)
    found = adjust(joint.observations, state, opened, joint.noise, most_steps=0)
    matrix, columns = dense_matrix(undamped(found, opened)), found.columns
    size, units = len(columns) + 6, found.tables.units
    # Poses of rectangles on their bodies are found anew with the moved cameras.
    stays = np.repeat(np.append(standing, np.zeros(units - len(standing), bool)), size)
    is_new = ~stays & joint.free.unknowns(columns, state).ravel()
    is_old = stays & opened.unknowns(columns, state).ravel()
    new, old = np.flatnonzero(is_new), np.flatnonzero(is_old)
    gain = -np.linalg.solve(matrix[np.ix_(new, new)], matrix[np.ix_(new, old)])
    known = _as_solved(problem, rig, standing, columns)[np.ix_(old, old)]
    total = np.zeros_like(matrix)
    total[np.ix_(old, old)] = known
    total[np.ix_(new, old)] = gain @ known
    total[np.ix_(old, new)] = total[np.ix_(new, old)].T
    total[np.ix_(new, new)] = np.linalg.inv(matrix[np.ix_(new, new)]) + gain @ known @ gain.T
    return camera_covariance(replace(joint, adjustment=found, reduced=undamped(found, opened)), total)


def _as_solved(problem: Problem, rig: Rig, standing: Mask, columns: Ints) -> Floats:
    """The old rig's covariance over lens columns and twists of camera_from_rig, zero for the moved cameras."""
    size = len(columns) + 6
    spread = np.zeros((len(standing) * size, len(rig.covariance)))
    for row in np.flatnonzero(standing):
        name = problem.cameras[row].name
        start_old, start_new = rig.camera_index(name) * CAMERA_PARAMETERS, row * size
        spread[start_new + np.arange(len(columns)), start_old + columns] = 1.0
        jacobian = np.linalg.inv(step_by_camera_twist(rig.camera(name).rig_from_camera))
        spread[start_new + len(columns) : start_new + size, start_old + LENS : start_old + CAMERA_PARAMETERS] = (
            jacobian
        )
    return spread @ rig.covariance @ spread.T


def _with_absent(rig: Rig, solved: Rig, moved: Sequence[str]) -> Rig:
    """Cameras that stay but were not recorded, carried over; their doubt keeps its ties among themselves alone."""
    present = {camera.name for camera in solved.cameras}
    absent = [camera for camera in rig.cameras if camera.name not in present and camera.name not in moved]
    if not absent:
        return solved
    cameras = [*solved.cameras, *absent]
    order = [c.name for c in rig.cameras] + [name for name in moved if name not in {c.name for c in rig.cameras}]
    cameras.sort(key=lambda camera: order.index(camera.name))
    total = np.zeros((len(cameras) * CAMERA_PARAMETERS,) * 2)
    for part, names in ((rig, {c.name for c in absent} | present - set(moved)), (solved, present)):
        rows = [_block(i) for i, c in enumerate(cameras) if c.name in names]
        from_rows = [_block(part.camera_index(c.name)) for c in cameras if c.name in names]
        index, source = np.concatenate(rows), np.concatenate(from_rows)
        total[np.ix_(index, index)] = part.covariance[np.ix_(source, source)]
    return replace(solved, cameras=tuple(cameras), covariance=total)


def _block(index: int) -> Ints:
    return np.arange(index * CAMERA_PARAMETERS, (index + 1) * CAMERA_PARAMETERS)
