"""From a first rig to the best one: robust fit, outliers out, least squares to the end, lenses weighed by class."""

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.adjustment.bordered import Border, Bordered, border_near, border_of, solve_bordered
from quadrig.rig.adjustment.levenberg_marquardt import (
    Adjustment,
    FreeParameters,
    adjust,
    lens_covariances,
    undamped,
)
from quadrig.rig.adjustment.normal_equations import residual_squares
from quadrig.rig.adjustment.outliers import Inliers, first_noise
from quadrig.rig.adjustment.pose_priors import LayoutPrior, PositionPrior
from quadrig.rig.adjustment.priors import (
    ENOUGH_POINTS,
    ROUGH,
    LensPriors,
    estimated_lenses,
    first_priors,
    weighed_priors,
)
from quadrig.rig.adjustment.schur import Reduced, reduced_inverse
from quadrig.rig.adjustment.state import State
from quadrig.rig.adjustment.systematic_errors import SystematicErrors, systematic_errors
from quadrig.rig.adjustment.tables import Tables, tables_of
from quadrig.rig.blas_threads import one_thread
from quadrig.rig.joint.folds import folds_of
from quadrig.rig.joint.residual_noise import residual_sum, shown_nodes
from quadrig.rig.joint.time_errors import (
    fit_time_errors,
    inliers_of,
    is_out_of_step,
    with_motion,
    without_slack,
)
from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.connectivity import components
from quadrig.rig.problem.observations import Observations
from quadrig.rig.start.lenses_and_poses import FirstCameras
from quadrig.rig.start.pose_graph import FirstRig
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.posterior.noise import EXPECTED_WEIGHT, noise_of

# Rounds of a robust fit and the noise that it shows: two or three are usual.
_NOISE_ROUNDS = 20
# The weights of Cauchy's loss hardly change when the noise does by less than this (log).
_SAME_NOISE = 0.3
# A minimum that is not reached in so many steps is a valley that the Views leave open; its sigmas say so.
_MOST_STEPS = 25
# Steps of one robust fit, and widths of its loss before that of the noise: a first rig of few Views may be tens of
# degrees off, and its residuals some ten times the noise.
_ROBUST_STEPS = 12
_WIDER = (20.0, 5.0)
# Share of a camera's Views that are rejected, from which it may stand in a wrong place: Views themselves are wrong in
# one of ten at most.
_GIVEN_UP = 0.2
# Noise that changes by less than this (log) changes no sigma in its third digit.
_SETTLED_NOISE = 1e-3
# Probabilities of classes of lenses that change by less than this move no figure by a hundredth of its sigma.
_SAME_CLASSES = 0.0005
# A step of sheets' shapes and tones that lowers chi-square by less moves no figure by a thousandth of its sigma.
_SAME_ERRORS = 1e-5
# A step that is expected to lower chi-square by less is too short to go wrong: a few sigmas of one number.
_NEAR = 10.0
# Chi-square to be gained by a step that moves nothing by more than a third of its sigma: derivatives stay as they
# are, and cameras and systematic errors go on together.
_CLOSE = 0.1
# Times that a step is halved before it is given up.
_HALVINGS = 8
# A position that the motion does not show is held to a millimetre (1/m^2).
_HELD = 1e6
# Rounds of rejecting and taking back corners: the second rarely changes anything.
_ROUNDS = 10


@dataclass(frozen=True)
class Contradicted:
    """Cameras, by name, all of whose Views the others contradict: the rest can be solved without them."""

    names: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """What is wrong, and what to check, where nothing can be solved without them."""
        return (
            f"the Views of {' and '.join(self.names)} contradict the other cameras throughout; "
            "check that the cameras ran at the same time and the rectangles' sizes are right"
        )


@dataclass(frozen=True, eq=False)
class Joint:
    """The end of the joint adjustment.

    observations carry the final weights, errors of the final values (U,) taken off; inliers says what was rejected.
    freedom: the degrees of freedom that noise (px) rests on. covariance (E M, E M) over the units, without the doubt
    of the systematic errors; bordered adds that. predicted: the state whose rectangle poses fit the pictures best
    with no View straying: what the rig says of them, and what residuals are measured from.
    """

    adjustment: Adjustment
    observations: Observations
    free: FreeParameters
    inliers: Inliers
    noise: float
    freedom: float
    covariance: Floats
    reduced: Reduced
    priors: LensPriors
    costs: tuple[float, ...]
    predicted: State
    errors: SystematicErrors
    values: Floats
    bordered: Bordered


@dataclass(frozen=True, eq=False)
class _Fit:
    """The joint fit between two stages: of all observations, with noise in px."""

    adjustment: Adjustment
    free: FreeParameters
    inliers: Inliers
    noise: float


@one_thread
def solve_jointly(
    problem: Problem,
    alone: FirstCameras,
    first: FirstRig,
    standing: Mask,
    *,
    fixed_node: int | None = None,
    offsets: Floats | None = None,
) -> Joint | Contradicted:
    """Adjust everything at once. The cameras that are standing (C,) bool keep their poses, and so does fixed_node:
    one of them at least holds the rig frame. offsets (C,) s: of the clocks, where they are known to differ."""
    observations = problem.observations(first.reading)
    priors = first_priors(problem, alone.lens[:, 0]).holding_focals(alone.real_tilt)
    free = _free_parameters(problem, observations, priors, standing, fixed_node)
    free = replace(free, positions=_held_positions(first))
    state = State(alone.lens, first.camera_from_rig, first.rig_from_body, first.body_from_rect, offsets=offsets)
    robust = _robust_stage(problem, observations, state, alone, first, free)
    if _is_one_given_up(observations, robust.inliers):
        # A camera whose first lens or pose is wrong is brought round by all of its Views under a wider loss, where
        # Cauchy's loss at the noise's own width gives them up.
        whole = replace(first, agrees=np.ones_like(first.agrees))
        wide = _robust_stage(problem, observations, state, alone, whole, free, wider=_WIDER)
        robust = min(robust, wide, key=lambda fit: int(fit.inliers.rejected.sum()))
    contradicted = _contradicted(problem, observations, robust.inliers)
    if contradicted:
        return contradicted
    used = observations.with_weights(robust.inliers.weights)
    found = adjust(
        used, robust.adjustment.state, robust.free, robust.noise, most_steps=0, tables=robust.adjustment.tables
    )
    priors, free = _weighed(problem, priors, robust.free, found)
    return _least_squares_stage(problem, observations, replace(robust, free=free), priors)


def _robust_stage(
    problem: Problem,
    observations: Observations,
    state: State,
    alone: FirstCameras,
    first: FirstRig,
    free: FreeParameters,
    wider: tuple[float, ...] = (),
) -> _Fit:
    """Cauchy's loss, and where the cameras are out of step slack and clock offsets; outliers found. wider: widths of
    the loss to begin with, as multiples of the noise's own."""
    if state.offsets is not None:
        state = with_motion(problem, state)
    tables = tables_of(observations)
    thinned = observations.thinned(ENOUGH_POINTS)
    for width in wider:
        found, _ = _robust(problem, thinned, state, width * alone.noise, first, free, tables, most_rounds=1)
        state = found.state
    found, noise = _robust(problem, thinned, state, alone.noise, first, free, tables)
    if state.offsets is not None:
        found = replace(found, state=with_motion(problem, found.state))
    squares = residual_squares(observations, found.state)
    inliers = inliers_of(observations, squares, found.state, free, noise)
    if is_out_of_step(problem, observations, inliers, noise, alone=alone.noise):
        noise = alone.noise
        found, free = fit_time_errors(problem, observations, replace(found, state=state), free, noise)
        inliers = inliers_of(observations, found.linearised.squares, found.state, free, noise)
    return _Fit(found, free, inliers, noise)


def _robust(
    problem: Problem,
    observations: Observations,
    state: State,
    noise: float,
    first: FirstRig,
    free: FreeParameters,
    tables: Tables,
    most_rounds: int = _NOISE_ROUNDS,
) -> tuple[Adjustment, float]:
    """From the first rig on, Views that fit nothing left out until the rig can judge them; with the noise (px)."""
    weights = [np.where(first.agrees[g.view][:, None], g.weights, 0.0) for g in observations.groups]
    trusted = observations.with_weights(weights)
    poses = shown_nodes(trusted).sum() + free.pose.sum() + len(free.layouts.information)
    unknowns = 6 * float(poses) + float(free.lens.sum())

    def fit(used: Observations, at: State, sigma: float) -> Adjustment:
        return adjust(used, at, free, sigma, robust=True, most_steps=_ROBUST_STEPS, tables=tables, tolerance=ROUGH)

    rounds = 0
    while True:
        rounds += 1
        found = fit(trusted, state, noise)
        seen = first_noise(trusted, found.linearised.squares, unknowns, problem.expected_noise)
        if abs(np.log(seen / noise)) < _SAME_NOISE or rounds == most_rounds:
            break
        state, noise = found.state, seen
    if not first.agrees.all():
        # Views where a lens was not known yet disagree as wrong ones do, but bring it round once the rig stands.
        found = fit(observations, found.state, seen)
    return found, seen


def _weighed(
    problem: Problem, priors: LensPriors, free: FreeParameters, found: Adjustment, covariance: Floats | None = None
) -> tuple[LensPriors, FreeParameters]:
    """The priors of the lenses after a fit with them, the classes weighed by what the Views say."""
    covariance = reduced_inverse(undamped(found, free)) if covariance is None else covariance
    own = lens_covariances(found, covariance)
    priors = weighed_priors(problem, priors, free.lens, found.state.lens, own)
    return priors, replace(free, prior_mean=priors.mean, prior_information=priors.information)


def _least_squares_stage(
    problem: Problem, observations: Observations, fit: _Fit, priors: LensPriors
) -> Joint | Contradicted:
    """Least squares until inliers, systematic errors and the weights of the classes of lenses stay the same, and the
    covariance."""
    free, inliers, noise, costs = fit.free, fit.inliers, fit.noise, fit.adjustment.costs
    errors = systematic_errors(problem, observations)
    values, seen = np.zeros(len(errors.information)), observations
    state, used = fit.adjustment.state, observations.with_weights(inliers.weights)
    rounds, border = 0, None
    while True:
        rounds += 1
        found = adjust(
            used, state, free, noise, most_steps=_MOST_STEPS, tables=fit.adjustment.tables, tolerance=_CLOSE
        )
        end, before, kinds = _end(errors, values, used, found, free, noise, border=border), noise, priors.kinds
        costs, noise = costs + found.costs, noise_of(*end.residuals, problem.expected_noise)
        again = inliers_of(seen, found.linearised.squares, found.state, free, noise)
        state, values = _moved(errors, values, observations, used, found, free, before, end.bordered)
        priors, free = _weighed(problem, priors, free, replace(found, state=state), end.covariance)
        if end.bordered.fall < _NEAR and border is None:
            # All derivatives are of one state here: what is learned of mixed ones jumps from round to round.
            errors = errors.with_learned_fields(end.bordered.data_information, end.bordered.data_pull)
        seen = errors.corrected(observations, values)
        same = abs(np.log(noise / before)) < _SETTLED_NOISE and np.abs(priors.kinds - kinds).max() < _SAME_CLASSES
        if (same and again.same_points(inliers) and end.bordered.fall < _SAME_ERRORS) or rounds == _ROUNDS:
            break
        near = end.bordered.fall < _CLOSE and free.slack is None and again.same_points(inliers)
        border = end.bordered.border.at_noise(before, noise) if near else None
        inliers, used = again, seen.with_weights(again.weights)
        contradicted = _contradicted(problem, observations, inliers)
        if contradicted:
            return contradicted
    if end.bordered.fall > _NEAR:
        # Few Views of one camera may bend sheet, lens and focal against one another along a long valley: what was not
        # reached is no solution, and the misfit stays in the noise.
        state, values, seen = fit.adjustment.state, np.zeros_like(values), observations
    used = seen.with_weights(inliers.weights)
    adjustment = adjust(used, state, free, noise, most_steps=_MOST_STEPS, tables=fit.adjustment.tables)
    end = _end(errors, values, used, adjustment, free, noise, fold=folds_of(problem))
    noise = noise_of(*end.residuals, problem.expected_noise)
    predicted = without_slack(used, adjustment.state, free, noise)
    freedom = max(end.residuals[1], 0.0) + EXPECTED_WEIGHT
    return Joint(
        adjustment,
        used,
        free,
        inliers,
        noise,
        freedom,
        end.firm,
        end.reduced,
        priors,
        costs,
        predicted,
        errors,
        values,
        end.bordered,
    )


def _moved(
    errors: SystematicErrors,
    values: Floats,
    observations: Observations,
    used: Observations,
    found: Adjustment,
    free: FreeParameters,
    noise: float,
    bordered: Bordered,
) -> tuple[State, Floats]:
    """State and errors (U,) after the step, or after as much of it as lowers the cost: far from the minimum, where
    few Views leave a focal open, the whole of it may not."""
    if bordered.fall < _NEAR:
        return bordered.part(used, found, 1.0)
    weights = [group.weights for group in used.groups]

    def cost(state: State, at: Floats) -> float:
        seen = errors.corrected(observations, at).with_weights(weights)
        tried = adjust(seen, state, free, noise, most_steps=0, tables=found.tables)
        return tried.costs[-1] + float(at @ errors.information @ at)

    here, share = found.costs[-1] + float(values @ errors.information @ values), 1.0
    for _ in range(_HALVINGS):
        state, at = bordered.part(used, found, share)
        if cost(state, at) < here:
            return state, at
        share /= 2
    return found.state, values


@dataclass(frozen=True, eq=False)
class _End:
    """The end of an adjustment, its reduced system, and what the systematic errors add to it.

    firm, covariance (E M, E M): of the units without and with the errors' doubt. residuals: as residual_sum has it.
    """

    adjustment: Adjustment
    reduced: Reduced
    firm: Floats
    bordered: Bordered
    covariance: Floats
    residuals: tuple[float, float]


def _end(
    errors: SystematicErrors,
    values: Floats,
    used: Observations,
    found: Adjustment,
    free: FreeParameters,
    noise: float,
    *,
    fold: Ints | None = None,
    border: Border | None = None,
) -> _End:
    """fold (N,): as border_of has it. border: of an end so near that only its gradient differs; else it is made."""
    reduced = undamped(found, free)
    firm = reduced_inverse(reduced)
    bordered = None
    if border is not None:
        near = border_near(border, errors, used, found, noise)
        # What no picture shows, as the scale of all sheets, seems to show where derivatives are not all of one state.
        with suppress(np.linalg.LinAlgError):
            bordered = solve_bordered(near, errors, values, found, reduced, firm)
    if bordered is None:
        border = border_of(errors, used, found, free, noise, reduced, fold)
        bordered = solve_bordered(border, errors, values, found, reduced, firm)
    covariance = bordered.with_errors(firm)
    residuals = residual_sum(found, used, free, noise, covariance, bordered.effective)
    return _End(found, reduced, firm, bordered, covariance, residuals)


def _is_one_given_up(observations: Observations, inliers: Inliers) -> bool:
    """Whether so many Views of some camera were rejected that it may stand in a wrong place."""
    count, out = (
        np.bincount(observations.camera[chosen], minlength=observations.cameras)
        for chosen in (slice(None), inliers.rejected)
    )
    return bool((out > _GIVEN_UP * count).any())


def _contradicted(problem: Problem, observations: Observations, inliers: Inliers) -> Contradicted | None:
    """The cameras that no View that was kept joins to the others; None where there are none."""
    if not inliers.rejected.any():
        return None
    kept = np.flatnonzero(~inliers.rejected)
    loose = sorted(set(range(observations.cameras)) - set(components(problem, kept)[0]))
    return Contradicted(tuple(problem.cameras[i].name for i in loose)) if loose else None


def _free_parameters(
    problem: Problem, observations: Observations, priors: LensPriors, standing: Mask, fixed_node: int | None
) -> FreeParameters:
    node = np.ones(observations.nodes, bool)
    if fixed_node is not None:
        node[fixed_node] = False
    found = problem.layouts.found
    layouts = LayoutPrior(problem.layouts.given[:found], problem.layouts.information[:found])
    return FreeParameters(
        estimated_lenses(problem), ~standing, node, priors.mean, priors.information, layouts=layouts
    )


def _held_positions(first: FirstRig) -> tuple[PositionPrior, ...]:
    """Cameras are held where the motion says nothing of where they stand: noise would put them anywhere."""
    rig_from_camera = first.camera_from_rig.inverse()
    held = [(int(np.flatnonzero(weak.cameras)[0]), weak.axis) for weak in first.weak if not weak.is_known]
    return tuple(PositionPrior(row, axis, rig_from_camera.translation[row], _HELD) for row, axis in held)
