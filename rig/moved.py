"""Has a camera moved since the rig was calibrated? A test of each camera against what the rig said of it.

New Views, with lenses and rectangle poses unknown, say g of a step of the cameras away from the stored rig, with
information H. The rig itself knows that step to its covariance S. So the new Views see, of a camera that moved by m,

    b = (I + H S)^-1 g,   with information M = H (I + S H)^-1,   and   m = M_ii^-1 b_i

to first order: generalised least squares in which the rig's doubt of lenses and poses is noise like any other
(Woodbury's identity). Of a camera that did not move, b_i M_ii^-1 b_i would be chi-square with six degrees of freedom
if the noise of the corners were known. It is estimated, for H and for S apart, so that the law is Hotelling's:
six times F of six and of Satterthwaite's degrees of freedom.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from quadrig.rig.adjustment.bordered import expand
from quadrig.rig.adjustment.levenberg_marquardt import lens_covariances
from quadrig.rig.adjustment.schur import dense_matrix, unit_covariances
from quadrig.rig.doubt.information import scaled_inverse
from quadrig.rig.joint.cross_validation import cross_validate
from quadrig.rig.joint.residual_noise import residual_sum
from quadrig.rig.joint.stages import Contradicted, Joint, solve_jointly
from quadrig.rig.joint.view_errors import view_error_variances
from quadrig.rig.joint.widened import gradient_covariance
from quadrig.rig.problem.build import Problem, build_problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.problem.connectivity import components
from quadrig.rig.result import CAMERA_PARAMETERS, Rig
from quadrig.rig.start.lenses_and_poses import first_cameras
from quadrig.rig.start.pose_graph import first_rig
from quadrig.rig.words import length
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import LENS_PARAMETERS
from quadrig.single.pose import Pose, step_by_camera_twist
from quadrig.single.posterior.noise import EXPECTED_WEIGHT, noise_of
from quadrig.single.rectangle import WORLD, Rectangle
from quadrig.single.view import View

MoveState = Literal["unmoved", "moved", "cannot tell"]

_FREEDOMS = 6
_POWER = 0.95
# A test that finds nothing below this share of the distance of what was seen (or this angle, rad) decides nothing.
_DECIDES_NOTHING = 0.05
# Of focal, size of picture, and coefficients (a tenth of it for tangential ones): more than lenses of others are off.
_LOOSE = 0.05
# What another focus does to a lens (sigmas), beside what is known of it: of the focal a share, of the principal point
# of the width, and to the coefficients and the aspect.
_REFOCUSED = np.array([0.02, 0.008, 0.008, 0.05, 0.1, 0.003, 0.003, 0.1, 0.003])
# Chi-square by which one explanation must beat another to be named alone: odds of ninety to one.
_AMBIGUOUS = 9.0


@dataclass(frozen=True, eq=False)
class CameraMove:
    """What new Views say of one camera. shift (m) and rotation (rad), with sigmas: of its pose since the calibration.

    chance: probability of as much disagreement in a camera that did not move. found: m, the shift that would have
    been found with 95 % power in the worst direction. instead: cameras whose move would explain it as well.
    covariance (6, 6): of the step of rig_from_camera that the move is; nan where nothing is determined.
    """

    name: str
    state: MoveState
    shift: float = float("nan")
    rotation: float = float("nan")
    shift_sigma: float = float("nan")
    rotation_sigma: float = float("nan")
    chance: float = float("nan")
    found: float = float("nan")
    instead: tuple[str, ...] = ()
    refocused: bool = False
    why: str = ""
    covariance: Floats = field(default_factory=lambda: np.full((6, 6), np.nan))


def find_moved(
    rig: Rig, rectangles: Sequence[Rectangle], views: Sequence[View], false_alarms: float = 0.01
) -> tuple[CameraMove, ...]:
    """One answer for each camera of the rig, in its order.

    false_alarms: the chance that any camera of a rig that did not move is called moved. Rectangles may have been put
    elsewhere, but for those of a body against each other; a motion of all cameras together is not seen. Where several
    moved, the one that explains most is found first and the others are tested without it. Of a rig that does not know
    its doubt no camera is judged: the answers hold shifts with the sigma of the new Views alone. Raises QuadrigError
    where false_alarms is no chance.
    """
    names = [camera.name for camera in rig.cameras]
    if not 0 < false_alarms < 1:
        raise QuadrigError(f"a chance of false alarms of {false_alarms} is none; give a number between 0 and 1")
    if not rig.is_doubt_known:
        return tuple(map(_untested, find_moved(_with_loose_lenses(rig), rectangles, views, false_alarms)))
    problem = _problem(rig, rectangles, views)
    groups = [group for group in components(problem) if len(group) > 1]
    if not groups:
        return tuple(CameraMove(name, "cannot tell", why=_why_not(name, problem)) for name in names)
    largest = {problem.cameras[i].name for i in max(groups, key=len)}
    kept = [view for view in problem.views if view.camera in largest]
    joined = build_problem(
        [camera for camera in problem.cameras if camera.name in largest], list(problem.rectangles.values()), kept
    )
    evidence = _evidence(rig, joined)
    tests = _greedy(evidence, len(largest), false_alarms)
    answers = {test.name: _or_refocused(rig, evidence, test, tests, false_alarms) for test in tests}
    return tuple(answers.get(n) or CameraMove(n, "cannot tell", why=_why_not(n, problem)) for n in names)


def _with_loose_lenses(rig: Rig) -> Rig:
    """The rig with lenses that are hardly known, so that none of their doubt is missed, and poses as it has them."""
    of_lens = [
        _LOOSE * np.array([one.intrinsics.focal, *[one.intrinsics.width] * 2, 1, 1, 0.1, 0.1, 1, 1])
        for one in rig.cameras
    ]
    sigmas = np.concatenate([np.concatenate([sigma, np.zeros(6)]) for sigma in of_lens])
    free = tuple(replace(camera, free_lens=LENS_PARAMETERS) for camera in rig.cameras)
    return replace(rig, cameras=free, covariance=np.diag(sigmas**2))


def _untested(move: CameraMove) -> CameraMove:
    """What is left of an answer where the rig does not know its doubt: where the new Views have the camera."""
    if not np.isfinite(move.shift):
        return move
    why = (
        f"the rig does not say how sure it is; the new Views have it {length(move.shift)} ± "
        f"{length(move.shift_sigma)} from there"
    )
    nothing = float("nan")
    return replace(move, state="cannot tell", chance=nothing, found=nothing, instead=(), why=why)


def _problem(rig: Rig, rectangles: Sequence[Rectangle], views: Sequence[View]) -> Problem:
    inputs = [
        CameraInput(c.name, c.intrinsics.width, c.intrinsics.height, c.intrinsics, fixed=True) for c in rig.cameras
    ]
    known = {camera.name for camera in inputs}
    held = _on_bodies(rig, rectangles)
    return build_problem(inputs, held, [view for view in views if view.camera in known])


def _on_bodies(rig: Rig, rectangles: Sequence[Rectangle]) -> list[Rectangle]:
    """The rectangles, those of a body where the rig has them on it: cameras that see different ones of them see one
    thing. The others, and what was surveyed, are only what several cameras see at once: they may stand elsewhere now.
    """
    layouts: dict[str, tuple[str, Pose, tuple[float, float]]] = {}
    for body in rig.bodies:
        if body.name != WORLD and np.isfinite(body.layout_covariance).all():
            for row, (turn, shift) in enumerate(body.layout_sigmas().T.tolist()):
                layouts[body.rectangles[row]] = body.name, body.body_from_rect[row], (turn, shift)
    nowhere = "", None, (0.0, 0.0)
    return [
        replace(one, body=body, body_from_rect=pose, layout_sigma=sigma)
        for one in rectangles
        for body, pose, sigma in [layouts.get(one.name, nowhere)]
    ]


def _why_not(name: str, problem: Problem) -> str:
    if all(view.camera != name for view in problem.views):
        return f"{name} sees no rectangle in this recording; show it one that others see too"
    return (
        f"{name} sees no rectangle at the same time as the other cameras; show one to it and another camera at once"
    )


@dataclass(frozen=True, eq=False)
class _Evidence:
    """b and M over the cameras' twists, names in order. stored: where the rig has each camera, in the new frame that
    new_from_old leads to. distance (C,): how far off what each camera sees is, m. freedom (C,): degrees of freedom of
    the noise that each camera's test rests on."""

    names: tuple[str, ...]
    score: Floats
    information: Floats
    stored: tuple[Pose, ...]
    new_from_old: Pose
    distance: Floats
    freedom: Floats
    new: "_NewViews"


@dataclass(frozen=True, eq=False)
class _NewViews:
    """What new Views say of lenses and twists at the stored rig: score and information over the lens columns and the
    twist of each camera, doubt: what the stored rig knows of these. freedom: of the noise of the stored rig and of
    the new Views. The rest as _Evidence has it."""

    names: tuple[str, ...]
    score: Floats
    information: Floats
    doubt: Floats
    columns: Ints
    stored: tuple[Pose, ...]
    new_from_old: Pose
    distance: Floats
    freedom: tuple[float, float]


def _evidence(rig: Rig, problem: Problem) -> _Evidence:
    alone = first_cameras(problem)
    first = first_rig(problem, alone.candidates, 0)
    joint = solve_jointly(problem, alone, first, np.arange(len(problem.cameras)) == 0)
    if isinstance(joint, Contradicted):
        raise QuadrigError(joint.sentence)
    new_from_old = _aligned(joint, [rig.camera(camera.name).rig_from_camera for camera in problem.cameras])
    stored = tuple(new_from_old @ rig.camera(camera.name).rig_from_camera for camera in problem.cameras)
    matrix, gradient, columns, freedom = _new_information(rig, problem, joint)
    size, count = len(columns) + 6, len(problem.cameras)
    step = np.zeros((count, size))
    found = joint.adjustment.state.camera_from_rig
    for row, rig_from_camera in enumerate(stored):
        step[row, len(columns) :] = _twist(found[row].inverse() @ rig_from_camera.inverse())
    return _against(
        _NewViews(
            tuple(camera.name for camera in problem.cameras),
            gradient - matrix @ step.ravel(),
            matrix,
            _stored_covariance(rig, problem, columns, new_from_old),
            columns,
            stored,
            new_from_old,
            _distances(problem, joint),
            (_stored_freedom(rig), freedom),
        )
    )


def _against(new: "_NewViews") -> _Evidence:
    """What new Views say of the cameras' poses, beside what is known of the stored rig."""
    count = len(new.names)
    unit, size = np.eye(len(new.information)), len(new.columns) + 6
    information = new.information @ np.linalg.inv(unit + new.doubt @ new.information)
    seen = np.asarray(np.linalg.solve(unit + new.information @ new.doubt, new.score), float)
    poses = (np.arange(count)[:, None] * size + len(new.columns) + np.arange(6)).ravel()
    passed = (information @ new.doubt @ information)[np.ix_(poses, poses)]
    information = information[np.ix_(poses, poses)]
    freedom = _freedom(information, passed, *new.freedom)
    return _Evidence(new.names, seen[poses], information, new.stored, new.new_from_old, new.distance, freedom, new)


def _or_refocused(
    rig: Rig, evidence: _Evidence, test: CameraMove, tests: Sequence[CameraMove], false_alarms: float
) -> CameraMove:
    """The answer, and whether a camera that seems to have moved may have another focus instead: the test again, with
    as much doubt of its lens as autofocus leaves, and with the others that moved free to."""
    if test.state != "moved":
        return test
    index, new = evidence.names.index(test.name), evidence.new
    lens = rig.camera(test.name).intrinsics
    sigma = _REFOCUSED * np.array([lens.focal, *[lens.width] * 2, *np.ones(6)])
    doubt, size = new.doubt.copy(), len(new.columns) + 6
    rows = index * size + np.arange(len(new.columns))
    doubt[rows, rows] += sigma[new.columns] ** 2
    again = _against(replace(new, doubt=doubt))
    others = [i for i, one in enumerate(tests) if one.state == "moved" and i != index]
    limit = _limits(again, false_alarms)[index]
    return replace(test, refocused=bool(_gain(again, others, index) < limit))


def _freedom(information: Floats, passed: Floats, stored: float, new: float) -> Floats:
    """Satterthwaite's degrees of freedom (C,) where a share of each camera's doubt comes from the stored rig's noise
    and the rest from the new Views'. passed: M S M, by how much that share lowers the information."""
    freedom = []
    for rows in (_rows([i]) for i in range(len(information) // 6)):
        block = np.ix_(rows, rows)
        share = np.trace(scaled_inverse(information[block]) @ passed[block]) / _FREEDOMS
        freedom.append(1 / (share**2 / stored + (1 - share) ** 2 / new))
    return np.array(freedom)


def _stored_freedom(rig: Rig) -> float:
    """Degrees of freedom of the stored rig's noise; infinite where it does not say what it rests on."""
    if not rig.fits:
        return float("inf")
    used = sum(int(np.sum(fit.used)) for fit in rig.fits if not fit.rejected)
    poses = len(rig.cameras) - 1 + sum(max(len(placed.framesets), 1) for placed in rig.rectangles)
    return max(2.0 * used - 6 * poses - sum(len(camera.free_lens) for camera in rig.cameras), 1.0)


def _aligned(joint: Joint, stored: Sequence[Pose]) -> Pose:
    """new_from_old, which takes the stored rig's frame to the new one's, by the camera that leaves the others least
    astray."""
    rig_from_camera = joint.adjustment.state.camera_from_rig.inverse()
    best, least = Pose.identity(), np.inf
    for row, pose in enumerate(stored):
        new_from_old = rig_from_camera[row] @ pose.inverse()
        steps = [rig_from_camera[i].step_to(new_from_old @ other) for i, other in enumerate(stored) if i != row]
        astray = float(np.median([np.linalg.norm(step[3:]) for step in steps]))
        if astray < least:
            best, least = new_from_old, astray
    return best


def _new_information(rig: Rig, problem: Problem, joint: Joint) -> tuple[Floats, Floats, Ints, float]:
    """H, g and the lens columns at the new rig, every lens that the stored rig estimated and every pose free; and the
    degrees of freedom of the noise that H and g rest on."""
    free = np.array(
        [[name in rig.camera(camera.name).free_lens for name in LENS_PARAMETERS] for camera in problem.cameras]
    )
    nothing = np.zeros_like(joint.free.prior_information)
    opened = replace(joint.free, lens=free, pose=np.ones(len(free), bool), prior_information=nothing)
    lenses = lens_covariances(joint.adjustment, unit_covariances(joint.reduced))
    chi_square, freedom = residual_sum(
        joint.adjustment, joint.observations, joint.free, joint.noise, lenses, joint.bordered.effective
    )
    # What is known of the noise beforehand is what these cameras had when they were calibrated.
    usual = rig.noise if np.isfinite(rig.noise) else joint.noise
    noise = noise_of(chi_square, freedom, usual)
    state, tables = joint.adjustment.state, joint.adjustment.tables
    there = expand(joint.errors, joint.observations, state, opened, noise, tables)
    found, reduced, border = there.adjustment, there.reduced, there.border
    unknown = reduced.free.ravel()
    lost, pulled = border.lost(joint.errors, joint.values)
    matrix = np.where(unknown[:, None] & unknown, dense_matrix(reduced) - lost, 0.0)
    gradient = np.where(unknown, reduced.gradient.ravel(), 0.0) - pulled
    # What the new recording's own parts and Views disagree on is no motion either.
    widening, errors = cross_validate(problem, joint).widening, view_error_variances(problem, joint)
    spread = gradient_covariance(joint.observations, found, opened, reduced, widening, errors)
    spread = np.where(unknown[:, None] & unknown, spread @ np.eye(len(unknown)) - lost, 0.0)
    weight = scaled_inverse(spread) @ np.column_stack([matrix, gradient])
    matrix, gradient = matrix @ weight[:, :-1], matrix @ weight[:, -1]
    size = len(found.columns) + 6
    # Clocks, and where rectangles stand on their bodies, are of no interest here.
    unit, column = np.divmod(np.arange(len(unknown)), reduced.free.shape[1])
    nuisance = (column >= size) | (unit >= len(free))
    return (*_without(matrix, gradient, nuisance), found.columns, max(freedom, 0.0) + EXPECTED_WEIGHT)


def _without(matrix: Floats, gradient: Floats, nuisance: Mask) -> tuple[Floats, Floats]:
    """Information and gradient of the rest when what is of no interest takes its best value."""
    if not nuisance.any():
        return matrix, gradient
    gain = matrix[np.ix_(~nuisance, nuisance)] @ scaled_inverse(matrix[np.ix_(nuisance, nuisance)])
    rest = matrix[np.ix_(~nuisance, ~nuisance)] - gain @ matrix[np.ix_(nuisance, ~nuisance)]
    return rest, gradient[~nuisance] - gain @ gradient[nuisance]


def _stored_covariance(rig: Rig, problem: Problem, columns: Ints, new_from_old: Pose) -> Floats:
    """The stored rig's covariance over lens columns and twists, in the new frame, in the order of the problem."""
    rotation = np.kron(np.eye(2), new_from_old.rotation)
    size = len(columns) + 6
    spread = np.zeros((len(problem.cameras) * size, len(rig.covariance)))
    for row, camera in enumerate(problem.cameras):
        begin, lens = rig.camera_index(camera.name) * CAMERA_PARAMETERS, len(LENS_PARAMETERS)
        spread[row * size + np.arange(len(columns)), begin + columns] = 1.0
        stored = new_from_old @ rig.camera(camera.name).rig_from_camera
        twist_by_step = np.linalg.inv(step_by_camera_twist(stored)) @ rotation
        spread[row * size + len(columns) : (row + 1) * size, begin + lens : begin + CAMERA_PARAMETERS] = twist_by_step
    return spread @ rig.covariance @ spread.T


def _twist(pose: Pose) -> Floats:
    """The twist (6,) whose exponential is the pose, to second order: moves are small beside a radian."""
    rotation = pose.rotation_vector()
    return np.concatenate([rotation, pose.translation - np.cross(rotation, pose.translation) / 2])


def _distances(problem: Problem, joint: Joint) -> Floats:
    """Median distance (C,) from each camera of the rectangles that it saw, m."""
    place = joint.adjustment.state.camera_from_rect(joint.observations).translation
    distance = np.linalg.norm(place, axis=1)
    return np.array([np.median(distance[problem.camera == row]) for row in range(len(problem.cameras))])


def _limits(evidence: _Evidence, false_alarms: float) -> Floats:
    """Fall of chi-square (C,) from which a camera is said to have moved."""
    from scipy.special import fdtri

    # Every camera is tested, and any of them may raise the alarm: each has its share of the chance.
    return _FREEDOMS * fdtri(_FREEDOMS, evidence.freedom, 1 - false_alarms / len(evidence.names))


def _greedy(evidence: _Evidence, cameras: int, false_alarms: float) -> list[CameraMove]:
    limits = _limits(evidence, false_alarms)
    moved: list[int] = []
    instead: dict[int, tuple[str, ...]] = {}
    # One camera at least must stay: moves are measured against it.
    while len(moved) < cameras - 1:
        gains = np.array([-np.inf if i in moved else _gain(evidence, moved, i) for i in range(cameras)])
        gains[gains < limits] = -np.inf
        best = int(np.argmax(gains))
        if not np.isfinite(gains[best]):
            break
        near = [i for i in range(cameras) if i != best and gains[i] > gains[best] - _AMBIGUOUS]
        instead[best] = tuple(evidence.names[i] for i in near)
        moved.append(best)
    answers = []
    for index in range(cameras):
        rivals = [i for i in moved if evidence.names[index] in instead[i]]
        others = [i for i in moved if i != index and i not in rivals]
        answer = _answer(evidence, others, index, _found_sigmas(limits[index], evidence.freedom[index]))
        if index in moved:
            answer = replace(answer, state="moved", instead=instead[index], why="")
        elif rivals:
            rival = evidence.names[rivals[0]]
            answer = replace(
                answer, state="cannot tell", why=f"a move of it or of {rival} explains the Views as well"
            )
        answers.append(answer)
    return answers


def _found_sigmas(limit: float, freedom: float) -> float:
    """Of how many sigmas a shift is that passes the limit with the power promised."""
    from scipy.optimize import root_scalar
    from scipy.special import ncfdtr

    def missing_power(centre: float) -> float:
        return float(1 - ncfdtr(_FREEDOMS, freedom, centre, limit / _FREEDOMS)) - _POWER

    # Ten times the limit is beyond it 95 times of 100 even where one degree of freedom tells the noise.
    return float(np.sqrt(root_scalar(missing_power, bracket=(0.1, 10 * limit)).root))


def _gain(evidence: _Evidence, others: list[int], index: int) -> float:
    """Fall of chi-square when a camera may have moved, where the others in the list may have, too."""
    return _fall(evidence, [*others, index]) - _fall(evidence, others)


def _fall(evidence: _Evidence, cameras: list[int]) -> float:
    if not cameras:
        return 0.0
    rows = _rows(cameras)
    score = evidence.score[rows]
    return float(score @ scaled_inverse(evidence.information[np.ix_(rows, rows)]) @ score)


def _rows(cameras: list[int]) -> Ints:
    return (np.array(cameras)[:, None] * 6 + np.arange(6)).ravel()


def _answer(evidence: _Evidence, others: list[int], index: int, sigmas: float) -> CameraMove:
    """What Views say of one camera where the others in the list may have moved. sigmas: of a shift surely found."""
    from scipy.special import fdtrc

    rows = _rows([*others, index])
    covariance = scaled_inverse(evidence.information[np.ix_(rows, rows)])
    twist = (covariance @ evidence.score[rows])[-6:]
    stored, name = evidence.stored[index], evidence.names[index]
    step = stored.step_to(Pose.from_twist(twist).inverse() @ stored)
    jacobian = np.kron(np.eye(2), evidence.new_from_old.rotation.T) @ step_by_camera_twist(stored)
    doubt = jacobian @ covariance[-6:, -6:] @ jacobian.T
    rotation_doubt, shift_doubt = np.linalg.eigvalsh(doubt[:3, :3]), np.linalg.eigvalsh(doubt[3:, 3:])
    found, rotation_found = (sigmas * float(np.sqrt(max(part.max(), 0))) for part in (shift_doubt, rotation_doubt))
    blind = found > _DECIDES_NOTHING * evidence.distance[index] or rotation_found > _DECIDES_NOTHING
    return CameraMove(
        name,
        "cannot tell" if blind else "unmoved",
        float(np.linalg.norm(step[3:])),
        float(np.linalg.norm(step[:3])),
        float(np.sqrt(max(shift_doubt.mean(), 0))),
        float(np.sqrt(max(rotation_doubt.mean(), 0))),
        float(fdtrc(_FREEDOMS, evidence.freedom[index], max(_gain(evidence, others, index), 0) / _FREEDOMS)),
        found,
        why=f"it would have to move by {length(found)} to be noticed; show more rectangles to it" if blind else "",
        covariance=doubt,
    )
