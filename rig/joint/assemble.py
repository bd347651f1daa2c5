"""From the end of the joint adjustment to the Rig: poses, covariances and residuals under their names."""

from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.adjustment.motion import CLOCK, CLOCK_INFORMATION
from quadrig.rig.adjustment.normal_equations import residual_squares, residuals
from quadrig.rig.adjustment.state import LENS
from quadrig.rig.blas_threads import one_thread
from quadrig.rig.doubt.student import student_widening
from quadrig.rig.doubt.weaknesses import weaknesses
from quadrig.rig.doubt.working_accuracy import accuracy_of, covered_points
from quadrig.rig.joint.cross_validation import cross_validate
from quadrig.rig.joint.delivered_lens import DeliveredLenses, delivered_lenses
from quadrig.rig.joint.known_lenses import with_evidence
from quadrig.rig.joint.open_motions import open_motions, with_open_motions
from quadrig.rig.joint.placed import bodies_of, placed_poses, rectangles_of
from quadrig.rig.joint.refocused import refocused
from quadrig.rig.joint.stages import Joint
from quadrig.rig.joint.view_errors import view_error_variances
from quadrig.rig.joint.widened import widened_covariance, with_weak_focals
from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import CAMERA_PARAMETERS, Camera, Rig, ViewFit
from quadrig.rig.start.pose_graph import FirstRig
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.lens import LENS_PARAMETERS, project
from quadrig.single.lens_prior import CLASS_NAMES
from quadrig.single.pose import step_by_camera_twist

# A line time is known where Views say three times as much of it as the prior does, s a row.
_KNOWN_LINE = 0.5 / np.sqrt(CLOCK_INFORMATION[1])
# Sigma of a focal, as a share of it, beyond which the Views do not determine it.
_UNKNOWN_FOCAL = 0.2
# Cameras whose part of a covariance is turned at a time: what that takes beside it is small.
_CAMERAS_AT_ONCE = 64


def cameras_of(problem: Problem, joint: Joint, lenses: DeliveredLenses, covariance: Floats) -> tuple[Camera, ...]:
    """The cameras, with lens and pose but without the figures that need the Views' fits. covariance (E M, E M): of
    the units."""
    rig_from_camera = joint.adjustment.state.camera_from_rig.inverse()
    offsets, lines = _clock_offsets(joint, covariance), _line_times(problem, joint, covariance)
    cameras = []
    for row, given in enumerate(problem.cameras):
        lens = lenses.lens[row]
        free = tuple(name for name, is_free in zip(LENS_PARAMETERS, joint.free.lens[row], strict=True) if is_free)
        cameras.append(
            Camera(
                given.name,
                given.first_lens.with_parameters(lens),
                rig_from_camera[row],
                free,
                _lens_reason(given, joint.priors.kinds[row]),
                clock_offset=float(offsets[row, 0]),
                clock_offset_sigma=float(offsets[row, 1]),
                line_time=float(lines[row, 0]),
                line_time_sigma=float(lines[row, 1]),
                remainder=float(lenses.remainder[row]),
            )
        )
    return tuple(cameras)


def _lens_reason(given: CameraInput, kinds: Floats) -> str:
    """What was estimated of a lens, and which lenses it is like."""
    if given.fixed:
        return "given and kept fixed"
    if given.lens != "auto":
        return f"asked for: {given.lens}"
    if given.lens_covariance is not None or given.lens_evidence is not None:
        return "known before, with its doubt, and estimated further"
    likely = int(np.argmax(kinds))
    return f"all parameters estimated; like lenses that are {CLASS_NAMES[likely]} ({100 * kinds[likely]:.0f} %)"


def _clock_offsets(joint: Joint, covariance: Floats) -> Floats:
    """Offsets about their mean and the sigmas of these (C, 2), s; zero and nan for cameras whose clock is not
    observable. covariance (E M, E M): of the units."""
    state, size = joint.adjustment.state, joint.reduced.free.shape[1]
    offsets = np.tile([0.0, np.nan], (len(state.lens), 1))
    if state.motion is None or state.clocks is None or not state.motion.observable.any():
        return offsets
    known = np.flatnonzero(state.motion.observable)
    columns = known * size + size - CLOCK
    about_mean = np.eye(len(known)) - 1 / len(known)
    offsets[known, 0] = about_mean @ state.clocks[known, 0]
    offsets[known, 1] = np.sqrt(np.diagonal(about_mean @ covariance[np.ix_(columns, columns)] @ about_mean))
    return offsets


def _line_times(problem: Problem, joint: Joint, covariance: Floats) -> Floats:
    """Line times and their sigmas (C, 2), s a row: those given, exact, and those that the Views say more of than was
    known beforehand; nan for others. covariance (E M, E M): of the units."""
    state, size = joint.adjustment.state, joint.reduced.free.shape[1]
    given = np.array([np.nan if camera.line_time is None else camera.line_time for camera in problem.cameras])
    lines = np.stack([given, np.where(np.isfinite(given), 0.0, np.nan)], axis=1)
    if state.motion is not None and state.clocks is not None:
        sigma = np.sqrt(np.diagonal(covariance)[size - 1 :: size][: len(lines)])
        known = state.motion.free[:, 1] & (sigma < _KNOWN_LINE)
        lines[known] = np.stack([state.clocks[:, 1], sigma], axis=1)[known]
    return lines


def camera_covariance(joint: Joint, reduced: Floats) -> Floats:
    """Covariance (15 C, 15 C) as Rig.covariance has it: lenses, and steps of rig_from_camera; from one (E M, E M) of
    the reduced system."""
    cameras, size = len(joint.adjustment.state.lens), joint.reduced.free.shape[1]
    reduced = reduced[: cameras * size, : cameras * size]
    columns = joint.adjustment.columns
    parameter = np.concatenate([columns, np.arange(LENS, CAMERA_PARAMETERS)])
    jacobian = step_by_camera_twist(joint.adjustment.state.camera_from_rig.inverse())
    block = np.zeros((cameras, CAMERA_PARAMETERS, size))
    block[:, parameter[: len(columns)], np.arange(len(columns))] = 1.0
    block[:, LENS:, len(columns) : len(columns) + 6] = jacobian
    total = cameras * CAMERA_PARAMETERS
    result, by_camera = np.empty((total, cameras, CAMERA_PARAMETERS)), reduced.reshape(cameras, size, -1)
    for begin in range(0, cameras, _CAMERAS_AT_ONCE):
        run = slice(begin, begin + _CAMERAS_AT_ONCE)
        spread = (block[run] @ by_camera[run]).reshape(-1, cameras, size).transpose(1, 0, 2)
        rows = slice(begin * CAMERA_PARAMETERS, begin * CAMERA_PARAMETERS + spread.shape[1])
        result[rows] = (spread @ block.transpose(0, 2, 1)).transpose(1, 0, 2)
    return result.reshape(total, total)


def fits_of(problem: Problem, joint: Joint, reading: Ints) -> tuple[ViewFit, ...]:
    """Residuals of every View, and why those that were rejected were."""
    observations = joint.observations
    used: list[Mask] = [np.zeros(0, bool)] * len(problem.views)
    own: list[Floats] = [np.zeros((0, 2))] * len(problem.views)
    for group, left_over in zip(observations.groups, residuals(observations, joint.predicted), strict=True):
        for row, view in enumerate(group.view):
            count = len(problem.views[view].pixels)
            own[view], used[view] = left_over[row, :count], group.weights[row, :count] > 0
    return tuple(
        ViewFit(view, own[i], used[i], int(reading[i]), _why(problem, i, own[i], joint))
        for i, view in enumerate(problem.views)
    )


def _why(problem: Problem, index: int, residuals: Floats, joint: Joint) -> str:
    """Why a View was rejected, or an empty string."""
    if not joint.inliers.rejected[index]:
        return ""
    length = np.linalg.norm(residuals, axis=-1)
    if not np.isfinite(length).any():
        return "the rig puts this rectangle behind the camera: the id is another rectangle's"
    shift = _shift(problem, index, joint)
    if shift:
        return f"its corners are in the wrong order: shifted by {shift}"
    median = float(np.nanmedian(length))
    far = int((~(length < 5 * joint.noise * problem.sigmas[index])).sum())
    return f"{far} of {len(length)} corners are off, by {median:.1f} px in the middle: another id, or another instant"


def _shift(problem: Problem, index: int, joint: Joint) -> int:
    """By how many the corners of a four-corner View would have to be shifted to fit; 0 where none does."""
    view = problem.views[index]
    if len(view.pixels) != 4:
        return 0
    state = joint.adjustment.state
    camera = joint.observations.camera[index]
    pose = state.camera_from_rig[camera] @ state.rig_from_seen(joint.observations)[index]
    model = problem.cameras[camera].first_lens.model
    with np.errstate(invalid="ignore"):
        predicted = project(state.lens[camera], pose.transform(view.points), model)
    for shift in (1, 2, 3):
        error = np.linalg.norm(np.roll(view.pixels, shift, axis=0) - predicted, axis=-1)
        # Twice the usual limit: the pose of the rectangle comes from others, this View had no part in it.
        if (error < 10 * joint.noise * problem.sigmas[index]).all():
            return shift
    return 0


@dataclass(frozen=True, eq=False)
class Squares:
    """Of every View: its camera (V,), the sum of squared residuals (V,) px^2 of the points that took part, and their
    number (V,); zero for rejected Views."""

    camera: Ints
    total: Floats
    points: Floats

    def rms(self, chosen: Mask | None = None) -> float:
        """Root mean square length (px) of the residuals of all Views, or of those that are chosen; nan for none."""
        chosen = np.ones(len(self.total), bool) if chosen is None else chosen
        count = self.points[chosen].sum()
        return float(np.sqrt(max(self.total[chosen].sum(), 0.0) / count)) if count else float("nan")


def squares_of(problem: Problem, joint: Joint) -> Squares:
    """Of the fit, against what the rig says of the pictures."""
    total, points = np.zeros(len(problem.views)), np.zeros(len(problem.views))
    squares = residual_squares(joint.observations, joint.predicted)
    for group, square in zip(joint.observations.groups, squares, strict=True):
        used = group.weights > 0
        total[group.view], points[group.view] = np.where(used, square, 0.0).sum(axis=1), used.sum(axis=1)
    return Squares(problem.camera, total, points)


def with_figures(
    cameras: tuple[Camera, ...], fit: Squares, held_out: Squares, covariance: Floats
) -> tuple[Camera, ...]:
    """The cameras with RMS, counts, and whether their focal is observable."""
    result = []
    for index, camera in enumerate(cameras):
        own = fit.camera == index
        sigma = float(np.sqrt(covariance[index * CAMERA_PARAMETERS, index * CAMERA_PARAMETERS]))
        result.append(
            replace(
                camera,
                rms=fit.rms(own),
                held_out_rms=held_out.rms(own),
                views=int((fit.points[own] > 0).sum()),
                observable_focal=sigma < _UNKNOWN_FOCAL * camera.intrinsics.focal,
            )
        )
    return tuple(result)


@one_thread
def assemble_rig(
    problem: Problem,
    joint: Joint,
    first: FirstRig,
    reference: str,
    order: list[str],
    known: Floats | None = None,
) -> Rig:
    """The Rig of a joint adjustment, cameras in the given order of names. known: the covariance, as Rig.covariance
    has it, before it is widened, where that is not the adjustment's own."""
    fit, without = squares_of(problem, joint), cross_validate(problem, joint)
    held_out = _predicted(without.squares, fit)
    view_errors = view_error_variances(problem, joint)
    lenses = delivered_lenses(joint)
    widened = widened_covariance(joint, without.widening, view_errors, lenses.taken)
    widened = with_open_motions(problem, joint, first.by_motion, with_weak_focals(joint, widened))
    student = student_widening(joint.freedom)
    # Of a large rig there is no room for many matrices of its size.
    widened *= student
    if known is None:
        covariance = camera_covariance(joint, widened)
    else:
        covariance = student * known + camera_covariance(joint, widened - student * joint.covariance)
    widening = student * float(without.widening.mean())
    cameras = cameras_of(problem, joint, lenses, widened)
    cameras = with_figures(cameras, fit, held_out, covariance)
    cameras, contradicted = with_evidence(problem, joint, cameras, covariance)
    placed = placed_poses(problem, joint, widening, widened)
    rectangles = rectangles_of(problem, joint, placed)
    # Who triangulates with the lenses alone does not know what they leave over.
    remainder = np.nan_to_num([camera.remainder for camera in cameras])
    noise = float(np.hypot(joint.noise, np.sqrt(np.mean(remainder**2))))
    accuracy = accuracy_of(cameras, covariance, covered_points(rectangles), noise)
    rows = [index for name in order for index, camera in enumerate(cameras) if camera.name == name]
    rig = Rig(
        reference,
        tuple(cameras[i] for i in rows),
        rectangles,
        _reordered(covariance, rows),
        fits_of(problem, joint, first.reading),
        joint.noise,
        fit.rms(),
        held_out.rms(),
        accuracy.working,
        accuracy.single,
        accuracy.scale,
        costs=joint.costs,
        bodies=bodies_of(problem, placed),
        dispersion=float(without.widening.mean()),
    )
    changed = refocused(problem, joint)
    return replace(rig, weak=(*contradicted, *open_motions(problem, first.by_motion), *changed, *weaknesses(rig)))


def _reordered(covariance: Floats, rows: list[int]) -> Floats:
    if rows == list(range(len(rows))):
        return covariance
    size = len(covariance) // len(rows)
    index = (np.array(rows)[:, None] * size + np.arange(size)).ravel()
    return covariance[np.ix_(index, index)]


def _predicted(squares: Floats, fit: Squares) -> Squares:
    """Of Views as predicted without them, those for which there is a prediction."""
    known = np.isfinite(squares) & (fit.points > 0)
    return replace(fit, total=np.where(known, squares, 0.0), points=np.where(known, fit.points, 0))
