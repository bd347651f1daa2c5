"""Each camera by itself: its lens and the pose of every rectangle it sees, from the single-image solver.

This is where a rig starts: closed form for each View, the Views of a camera joined on one lens, both mirror twins and
every reading of a View kept as candidates until other cameras decide.
"""

from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.adjustment.levenberg_marquardt import (
    Adjustment,
    FreeParameters,
    adjust,
    lens_covariances,
    undamped,
    with_prior,
)
from quadrig.rig.adjustment.normal_equations import linearise, normal_equations
from quadrig.rig.adjustment.outliers import LEAST_NOISE, first_noise
from quadrig.rig.adjustment.priors import ENOUGH_POINTS, ROUGH, estimated_lenses, first_priors
from quadrig.rig.adjustment.schur import unit_covariances
from quadrig.rig.adjustment.state import State
from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.observations import Joins, Observations, pack
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.lens import image_middle, unproject
from quadrig.single.lens_prior import usual_focal
from quadrig.single.lens_table import FISHEYE_FOCAL, FOCAL
from quadrig.single.pose import Pose
from quadrig.single.rectangle import rectangle_corners
from quadrig.single.rotation import nearest_rotation
from quadrig.single.solve.closed_form import closed_form
from quadrig.single.solve.corners import Reason, corner_reasons
from quadrig.single.solve.homography import homographies
from quadrig.single.solve.planar_pose import planar_poses

# A first focal outside of these shares of the image's larger side is a 175 or a 3 degree lens: taken as a failure.
_SHORTEST, _LONGEST = 0.05, 20.0
# The focal that a camera starts from when no View of its determines it: 53 degrees across.
_USUAL_FOCAL = 1.0
# Scatter of the logarithms of Views' focals from which the usual one may be nearer: lenses scatter by twice that.
_SCATTERED = 0.18
# Focals that a fisheye may begin from, in sigmas of what fisheyes have: a seventh apart, which a few steps bridge.
_FISHEYE_FOCALS = np.arange(-2.5, 3.01, 0.5)
# A twin whose chi-square is this much above the first candidate's is out of the question (e^-20).
_TWIN_COST = 40.0
# Steps of each camera by itself: the joint adjustment follows.
_MONO_STEPS = 3
# Gauss-Newton steps of a twin, whose closed form is near already.
_TWIN_STEPS = 2
_NO_LENS = np.zeros(0, int)
# Noise adds its variance to the square of a tilt in the mean, and as much again strays.
_NOISE_SQUARES = 2.0
# Of a focal of which all information is noise nothing is known but its prior: this keeps numbers finite.
_LEAST_SHARE = 0.01
# Added to the diagonal of a pose's normal matrix (1/rad^2, 1/m^2): far below what any View contributes.
_LEAST_INFORMATION = 1e-9


@dataclass(frozen=True, eq=False)
class Candidates:
    """What each View says by itself: one row for each reading and twin.

    view, reading (K,): whose they are. camera_from_rect: a batch (K,). covariance (K, 6, 6) of its step,
    with the doubt of its camera's lens. cost (K,): chi-square above the View's likeliest candidate.
    """

    view: Ints
    reading: Ints
    camera_from_rect: Pose
    covariance: Floats
    cost: Floats


@dataclass(frozen=True, eq=False)
class FirstCameras:
    """Lenses (C, 9), candidates of every View, and the noise (px) seen so far. real_tilt (C,): what share of the
    squared tilts that each camera sees is no noise. misfit (C,) px: of a coordinate, what the median View of each
    camera leaves over."""

    lens: Floats
    candidates: Candidates
    noise: float
    real_tilt: Floats
    misfit: Floats


def first_cameras(problem: Problem, steps: int = _MONO_STEPS) -> FirstCameras:
    """Calibrate each camera against the rectangles it sees, in so many steps."""
    observations = views_alone(problem).thinned(ENOUGH_POINTS)
    lens = _first_lenses(problem, observations)
    poses, errors = _both_poses(observations, lens)
    alone = _refine(problem, observations, lens, poses[:, 0], errors[:, 0], steps)
    candidates = _candidates(problem, observations, alone, poses[:, 1], errors)
    tilt, misfit = _real_tilt(problem, observations, alone), _misfit(observations, alone)
    return FirstCameras(alone.lens, candidates, alone.noise, tilt, misfit)


def views_alone(problem: Problem) -> Observations:
    """Every View with a pose of its own, in the frame of its rectangle, where it is flat."""
    views = problem.views
    return pack(
        [v.points for v in views],
        [v.pixels for v in views],
        problem.sigmas,
        problem.shares,
        Joins.alone(problem.camera, len(problem.cameras)),
        problem.models,
    )


def _first_lenses(problem: Problem, observations: Observations) -> Floats:
    """Lenses (C, 9): given ones as they are, others with the weighted median focal of their Views in closed form."""
    middles = np.array([image_middle(c.width, c.height) for c in problem.cameras]).reshape(-1, 2)
    larger = np.array([max(c.width, c.height) for c in problem.cameras], float)
    focal, weight = np.full(len(problem.views), np.nan), np.zeros(len(problem.views))
    unsure = np.zeros(len(problem.cameras), bool)
    for group in observations.groups:
        focal[group.view], weight[group.view] = _focals(
            group.points, group.pixels, group.weights, middles[group.camera]
        )
    lens = np.zeros((len(problem.cameras), 9))
    lens[:, 8], lens[:, 1:3], lens[:, 0] = 1.0, middles, _USUAL_FOCAL * larger
    for row, camera in enumerate(problem.cameras):
        if camera.intrinsics is not None:
            lens[row] = camera.intrinsics.parameters
            continue
        size = focal / larger[row]
        own = (problem.camera == row) & (weight > 0) & (size > _SHORTEST) & (size < _LONGEST)
        if own.any():
            lens[row, 0] = _weighted_median(focal[own], weight[own])
            unsure[row] = _scatter(focal[own] / lens[row, 0], weight[own]) > _SCATTERED
            unsure[row] |= abs(np.log(lens[row, 0] / larger[row]) - FOCAL[0]) > FOCAL[1]
    given = np.array([camera.intrinsics is not None for camera in problem.cameras])
    lens[:, 0] = np.where(given, lens[:, 0], usual_focal(larger, problem.models, lens[:, 0]))
    fisheyes = ~given & np.array([model == "fisheye" for model in problem.models])
    tried = np.exp(FISHEYE_FOCAL[0] + _FISHEYE_FOCALS[:, None] * FISHEYE_FOCAL[1]) * np.ones(len(larger))
    lens = _likeliest(observations, lens, fisheyes, tried, larger, FISHEYE_FOCAL)
    tried = np.stack([lens[:, 0] / larger, np.full(len(larger), np.exp(FOCAL[0]))])
    return _likeliest(observations, lens, unsure & ~fisheyes, tried, larger, FOCAL)


def _likeliest(
    observations: Observations, lens: Floats, which: Mask, focals: Floats, side: Floats, usual: tuple[float, float]
) -> Floats:
    """Lenses (C, 9), of some (C,) with the likeliest of focals (K, C), in the larger side of the picture, side (C,)
    px. usual: mean and sigma of the logarithm of what lenses have."""
    best, least = lens.copy(), np.full(len(lens), np.inf)
    for tried in focals if which.any() else ():
        at = lens.copy()
        at[which, 0] = (tried * side)[which]
        _, errors = _both_poses(observations, at)
        for camera in np.flatnonzero(which):
            own = errors[observations.camera == camera, 0]
            # What the lens bends is not known yet and the same in all points of a View, so a View counts as one.
            miss = max(at[camera, 0] * np.median(own), LEAST_NOISE) if len(own) else LEAST_NOISE
            cost = 2 * len(own) * np.log(miss) + ((np.log(tried[camera]) - usual[0]) / usual[1]) ** 2
            if cost < least[camera]:
                best[camera], least[camera] = at[camera], cost
    return best


def _focals(points: Floats, pixels: Floats, weights: Floats, middle: Floats) -> tuple[Floats, Floats]:
    """Focal (V,) of each View and its weight, zero where the View does not determine it."""
    homography = homographies(points[..., :2], pixels, weights)
    low, high = points[..., :2].min(axis=1), points[..., :2].max(axis=1)
    size = high - low
    corners = rectangle_corners(size[:, 0], size[:, 1])[..., :2] + ((low + high) / 2)[:, None]
    mapped = np.concatenate([corners, np.ones((*corners.shape[:-1], 1))], axis=-1) @ np.swapaxes(homography, -1, -2)
    with np.errstate(divide="ignore", invalid="ignore"):
        seen = mapped[..., :2] / mapped[..., 2:]
        # From behind, corners turn the other way; the focal is that of the same sheet turned over.
        behind = corner_reasons(seen) == Reason.REVERSED
        seen = np.where(behind[:, None, None], seen[:, ::-1], seen)
        found = closed_form(seen, size[:, 0], size[:, 1], middle)
        # The four corners of the homography stand for all points: their noise falls with the number of points.
        weight = (weights > 0).sum(axis=1) * (found.focal**2 / found.focal_sigma) ** 2
    # An unknowable focal still votes, with the little weight that its sigma leaves it.
    usable = (found.reason == Reason.OK) | (found.reason == Reason.FOCAL_UNKNOWABLE)
    return found.focal, np.where(usable & np.isfinite(weight) & np.isfinite(found.focal), weight, 0.0)


def _scatter(ratios: Floats, weights: Floats) -> float:
    """Root mean square of the logarithms of ratios (V,)."""
    return float(np.sqrt(weights @ np.log(ratios) ** 2 / weights.sum()))


def _weighted_median(values: Floats, weights: Floats) -> float:
    order = np.argsort(values, kind="stable")
    cumulative = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(cumulative, cumulative[-1] / 2)])


def _both_poses(observations: Observations, lens: Floats) -> tuple[Pose, Floats]:
    """Both twins camera_from_rect of every View, a batch (V, 2), and their errors (V, 2) as PlanarPoses has them."""
    count = len(observations.camera)
    rotation, translation = np.tile(np.eye(3), (count, 2, 1, 1)), np.zeros((count, 2, 3))
    translation[..., 2] = 1.0
    errors = np.full((count, 2), np.inf)
    for group in observations.groups:
        ray = unproject(lens[group.camera][:, None, :], group.pixels, group.model)
        found = planar_poses(group.points, ray, group.weights)
        solved = np.isfinite(found.errors[:, 0])
        index = group.view[solved]
        rotation[index] = found.camera_from_rect.rotation[solved]
        translation[index] = found.camera_from_rect.translation[solved]
        errors[index] = found.errors[solved]
    return Pose(rotation, translation), errors


@dataclass(frozen=True, eq=False)
class _Alone:
    """Each camera by itself: lenses (C, 9), noise (px), and of every View its pose, a batch (V,), the pose's
    covariance (V, 6, 6) for its lens, chi-square (V,), and what the doubt of its lens adds (V, 6, 6)."""

    lens: Floats
    noise: float
    camera_from_rect: Pose
    covariance: Floats
    cost: Floats
    lens_doubt: Floats


def _refine(
    problem: Problem, observations: Observations, lens: Floats, poses: Pose, errors: Floats, steps: int
) -> _Alone:
    """Joint fit of each camera's lens over its Views, poses following."""
    cameras = len(problem.cameras)
    priors, still, every = (
        first_priors(problem, lens[:, 0]),
        np.zeros(cameras, bool),
        np.ones(observations.nodes, bool),
    )
    free = FreeParameters(estimated_lenses(problem), still, every, priors.mean, priors.information)
    lengths = (lens[observations.camera, 0] * errors)[np.isfinite(errors)]
    # A mean squared length is twice the variance of a coordinate.
    noise = max(float(np.median(lengths)) / np.sqrt(2), LEAST_NOISE) if len(lengths) else problem.expected_noise
    state = _by_themselves(lens, poses)
    found = adjust(observations, state, free, noise, robust=True, most_steps=steps, tolerance=ROUGH)
    unknowns = 6 * float(problem.shares.sum()) + float(free.lens.sum())
    seen = first_noise(observations, found.linearised.squares, unknowns, problem.expected_noise)
    gram = found.linearised.gram * (noise / seen) ** 2
    lens_size = len(found.columns)
    pose = slice(lens_size, lens_size + 6)
    covariance, cost = _own_doubt(gram[:, pose, pose], _chi_squares(observations, found.linearised.squares, seen))
    by_lens = covariance @ gram[:, pose, :lens_size]
    own = _lens_covariances(observations, found, free, gram)[observations.camera]
    lens_doubt = by_lens @ own @ np.swapaxes(by_lens, -1, -2)
    return _Alone(found.state.lens, seen, found.state.rig_from_body, covariance, cost, lens_doubt)


def _lens_covariances(observations: Observations, found: Adjustment, free: FreeParameters, gram: Floats) -> Floats:
    """(C, K, K) of the lens columns, the cameras each by itself."""
    normal = normal_equations(observations, found.tables, found.state, gram)
    weighed = replace(found, normal=with_prior(normal, found.state, free, found.columns))
    reduced = undamped(weighed, free)
    covariance = lens_covariances(found, unit_covariances(reduced))
    return covariance[:, found.columns[:, None], found.columns]


def _misfit(observations: Observations, alone: _Alone) -> Floats:
    """What the median View of each camera leaves over, px (C,); zero where none has more points than a pose needs."""
    freedom = np.zeros(len(alone.cost))
    for group in observations.groups:
        freedom[group.view] = 2 * (group.weights > 0).sum(axis=1) - 6
    known = (freedom > 0) & np.isfinite(alone.cost)
    left = np.sqrt(alone.cost[known] / freedom[known])
    own = observations.camera[known]
    medians = [np.median(left[own == row]) if (own == row).any() else 0.0 for row in range(observations.cameras)]
    return alone.noise * np.array(medians)


def _real_tilt(problem: Problem, observations: Observations, alone: _Alone) -> Floats:
    """Share (C,) of the squared tilts of a camera's Views that is not noise, nearly 0 to 1.

    A rectangle seen flat on shows the same for every focal; what separates the focal from the distance goes with the
    square of the tilt. Noise alone tilts a fitted rectangle, and the fit takes that tilt for knowledge, of a focal
    far too short. So tilts are looked at as they are for the usual focal.
    """
    side = np.array([float(max(camera.width, camera.height)) for camera in problem.cameras])
    lens = alone.lens.copy()
    lens[:, 0] = usual_focal(side, problem.models)
    poses, errors = _both_poses(observations, lens)
    found = linearise(observations, _by_themselves(lens, poses[:, 0]), _NO_LENS, alone.noise, robust=True)
    covariance, _ = _own_doubt(found.gram[:, :6, :6], errors[:, 0])
    usable = np.isfinite(errors[:, 0]) & (np.trace(found.gram[:, :6, :6], axis1=1, axis2=2) > 0)
    square = 1 - np.clip(poses.rotation[:, 0, 2, 2], -1, 1) ** 2
    noise = np.diagonal(covariance, axis1=1, axis2=2)[:, :2].sum(axis=1)
    camera = observations.camera[usable]
    squares, noises = (np.bincount(camera, values[usable], observations.cameras) for values in (square, noise))
    share = 1 - _NOISE_SQUARES * noises / np.maximum(squares, 1e-12)
    # What is known of a lens ties its focal to the rest of it, and holds as it is.
    known = np.array([c.lens_covariance is not None or c.lens_evidence is not None for c in problem.cameras])
    return np.where((squares > 0) & ~known, np.clip(share, _LEAST_SHARE, 1.0), 1.0)


def _by_themselves(lens: Floats, poses: Pose) -> State:
    """Cameras (C,) that are each the rig frame, and poses camera_from_rect of all Views (V,)."""
    cameras = len(lens)
    return State(lens, Pose(np.tile(np.eye(3), (cameras, 1, 1)), np.zeros((cameras, 3))), poses)


def _own_doubt(gram: Floats, cost: Floats) -> tuple[Floats, Floats]:
    """Covariance (V, 6, 6) of poses of which the normal matrices are given, and chi-square (V,).

    A View of no information (all points behind) gets a doubt that no vote will count.
    """
    behind = (np.trace(gram, axis1=-2, axis2=-1) == 0) | ~np.isfinite(cost)
    covariance = np.linalg.inv(gram + _LEAST_INFORMATION * np.eye(6))
    return np.asarray(covariance, float), np.where(behind, np.inf, cost)


def _chi_squares(observations: Observations, squares: tuple[Floats, ...], noise: float) -> Floats:
    """Chi-square (V,) of each View from its squared residuals; infinite for Views that are not among these."""
    cost = np.full(len(observations.camera), np.inf)
    for group, square in zip(observations.groups, squares, strict=True):
        cost[group.view] = np.where(group.weights > 0, square * group.weights, 0.0).sum(axis=1) / noise**2
    return cost


def _candidates(
    problem: Problem, observations: Observations, alone: _Alone, twin: Pose, errors: Floats
) -> Candidates:
    """First candidates, twins that cannot be excluded, and the further readings of both."""
    count = len(problem.views)
    views, none = np.arange(count), np.zeros(count, int)
    scale = alone.lens[observations.camera, 0] / alone.noise
    # The closed form's own error says which twins are worth a refinement: it overstates their cost, if anything.
    points = np.zeros(count)
    for group in observations.groups:
        points[group.view] = (group.weights > 0).sum(axis=1)
    possible = np.isfinite(errors[:, 1])
    gap = points * scale**2 * (np.where(possible, errors[:, 1], 0.0) ** 2 - errors[:, 0] ** 2)
    weak = views[possible & (gap < 4 * _TWIN_COST)]
    parts: list[_Part] = [(views, none, alone.camera_from_rect, alone.covariance, np.zeros(count))]
    if len(weak):
        refined, covariance, cost = _refined_twins(observations, alone, twin, weak)
        apart = _differs(alone.camera_from_rect[weak], refined[weak], alone.covariance[weak])
        keep = weak[(cost[weak] - alone.cost[weak] < _TWIN_COST) & apart]
        parts.append((keep, none[keep], refined[keep], covariance[keep], (cost - alone.cost)[keep]))
    parts += _read_otherwise(problem, parts)
    view = np.concatenate([p[0] for p in parts])
    every_cost = np.concatenate([p[4] for p in parts])
    least = np.full(count, np.inf)
    np.minimum.at(least, view, every_cost)
    order = np.lexsort((np.concatenate([p[1] for p in parts]), every_cost, view))
    return Candidates(
        view[order],
        np.concatenate([p[1] for p in parts])[order],
        Pose(
            np.concatenate([p[2].rotation for p in parts])[order],
            np.concatenate([p[2].translation for p in parts])[order],
        ),
        (np.concatenate([p[3] for p in parts]) + alone.lens_doubt[view])[order],
        (every_cost - least[view])[order],
    )


_Part = tuple[Ints, Ints, Pose, Floats, Floats]


def _refined_twins(observations: Observations, alone: _Alone, twin: Pose, weak: Ints) -> tuple[Pose, Floats, Floats]:
    """Twins of the weak Views (indices) fitted, all with their covariance (V, 6, 6) and chi-square (V,)."""
    chosen = np.zeros(observations.nodes, bool)
    chosen[weak] = True
    views, here, best = observations.only(chosen), twin, twin
    gram, cost = np.zeros((len(chosen), 6, 6)), np.full(len(chosen), np.inf)
    for step in range(_TWIN_STEPS + 1):
        found = linearise(views, _by_themselves(alone.lens, here), _NO_LENS, alone.noise, robust=True)
        seen, normal = _chi_squares(views, found.squares, alone.noise), found.gram[:, :6, :6]
        better = seen < cost
        cost[better], gram[better] = seen[better], normal[better]
        best = Pose(
            np.where(better[:, None, None], here.rotation, best.rotation),
            np.where(better[:, None], here.translation, best.translation),
        )
        if step < _TWIN_STEPS:
            steps = np.linalg.solve(normal + _LEAST_INFORMATION * np.eye(6), found.gram[:, :6, 6:])[..., 0]
            here = here.retract(np.asarray(steps, float))
    return best, *_own_doubt(gram, cost)


def _differs(first: Pose, other: Pose, covariance: Floats) -> Mask:
    """Which poses (V,) are further apart than their own doubt: the others are one candidate, found twice."""
    step = first.step_to(other)
    return np.einsum("vi,vij,vj->v", step, np.linalg.inv(covariance), step) > 9.0


def _read_otherwise(problem: Problem, parts: list[_Part]) -> list[_Part]:
    """The same poses read with the points of each further reading."""
    read: list[_Part] = []
    readings = np.array([len(v.readings) for v in problem.views])
    for reading in range(1, int(readings.max(initial=1))):
        for view, _, pose, covariance, cost in parts:
            own = np.flatnonzero(readings[view] > reading)
            if not len(own):
                continue
            motions = [_plane_motion(problem.views[v].readings[reading], problem.views[v].points) for v in view[own]]
            first_from_other = Pose(
                np.stack([m.rotation for m in motions]), np.stack([m.translation for m in motions])
            )
            read.append(
                (view[own], np.full(len(own), reading), pose[own] @ first_from_other, covariance[own], cost[own])
            )
    return read


def _plane_motion(from_points: Floats, to_points: Floats) -> Pose:
    """The rigid motion of the plane that takes one reading's points to another's (Kabsch 1976)."""
    a, b = from_points - from_points.mean(axis=0), to_points - to_points.mean(axis=0)
    correlation = b.T @ a
    # Points of a plane leave the third axis open: it stays where it is.
    correlation[2, 2] += np.trace(a.T @ a)
    rotation = nearest_rotation(correlation)
    return Pose(rotation, to_points.mean(axis=0) - rotation @ from_points.mean(axis=0))
