"""From a first rig to the best one: robust fit, outliers out, least squares to the end, lenses weighed by class."""

from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.adjustment.banded import is_banded, solve_in_band
from quadrig.rig.adjustment.bordered import Bordered, Expansion, expand, solve_bordered
from quadrig.rig.adjustment.levenberg_marquardt import (
    Adjustment,
    FreeParameters,
    adjust,
    cost_at,
    lens_covariances,
    reweighed,
    undamped,
)
from quadrig.rig.adjustment.normal_equations import residual_squares
from quadrig.rig.adjustment.outliers import Inliers, first_noise
from quadrig.rig.adjustment.pose_priors import LayoutPrior, MotionPrior
from quadrig.rig.adjustment.priors import (
    ENOUGH_POINTS,
    ROUGH,
    LensPriors,
    estimated_lenses,
    first_priors,
    weighed_priors,
)
from quadrig.rig.adjustment.schur import Reduced, reduced_inverse, unit_covariances
from quadrig.rig.adjustment.state import State
from quadrig.rig.adjustment.systematic_errors import SystematicErrors, systematic_errors
from quadrig.rig.adjustment.tables import Tables, tables_of
from quadrig.rig.blas_threads import one_thread
from quadrig.rig.joint.folds import folds_of
from quadrig.rig.joint.residual_noise import residual_sum, shown_nodes
from quadrig.rig.joint.time_errors import (
    are_clocks_shown,
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
# Noise, or a width of what is expected, that changes by less than this (log) changes no sigma in its third digit.
_SETTLED_NOISE = 1e-3
# Probabilities of classes of lenses that change by less than this move no figure by a hundredth of its sigma.
_SAME_CLASSES = 0.0005
# A step that lowers chi-square by less, the square of a hundredth, moves no figure by a hundredth of its sigma.
_SAME_ERRORS = 1e-4
# Where it is expected to lower it by less than that of a sigma, what a fit expects may be learned to the end.
_SIGMA = 1.0
# A step that is expected to lower chi-square by less is too short to go wrong: a few sigmas of one number.
_NEAR = 10.0
# Times that a step is halved before it is given up.
_HALVINGS = 8
# A pose that the motion does not show is held to a millimetre and a thousandth of a radian (1/m^2, 1/rad^2).
_HELD = 1e6
# Rounds of rejecting and taking back corners: the second rarely changes anything.
_ROUNDS = 10
# Few Views lead a fit along a bent valley, which it follows for so many while the errors that it finds are likely.
_MOST_ROUNDS = 40
# Chi-square of likely errors, in sigmas of its own beyond their number: some prints and lenses vary more than others.
_LIKELY = 5.0
# Rounds in which what a fit expects is learned where it stands: three or four are usual.
_LEARNING_ROUNDS = 10


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
    freedom: the degrees of freedom that noise (px) rests on. predicted: the state whose rectangle poses fit the
    pictures best with no View straying: what the rig says of them, and what residuals are measured from.
    """

    adjustment: Adjustment
    observations: Observations
    free: FreeParameters
    inliers: Inliers
    noise: float
    freedom: float
    reduced: Reduced
    priors: LensPriors
    costs: tuple[float, ...]
    predicted: State
    errors: SystematicErrors
    values: Floats
    bordered: Bordered

    @property
    def covariance(self) -> Floats:
        """(E M, E M) over the units, without the doubt of the systematic errors; bordered adds that."""
        return self.bordered.firm


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
    clocks: Floats | None = None,
) -> Joint | Contradicted:
    """Adjust everything at once. The cameras that are standing (C,) bool keep their poses, and so does fixed_node:
    one of them at least holds the rig frame. clocks (C, 2): as State has them, where they are known to differ or
    shutters to roll."""
    observations = problem.observations(first.reading)
    priors = first_priors(problem, alone.lens[:, 0]).holding_focals(alone.real_tilt)
    free = _free_parameters(problem, observations, priors, standing, fixed_node)
    free = replace(free, motions=_held_motions(first))
    state = State(alone.lens, first.camera_from_rig, first.rig_from_body, first.body_from_rect, clocks=clocks)
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
    found = robust.adjustment
    covariance = lens_covariances(found, unit_covariances(undamped(found, robust.free)))
    priors, free = _weighed(problem, priors, robust.free, found.state.lens, covariance)
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
    """Cauchy's loss, and where the cameras are out of step slack and clocks; outliers found. wider: widths of the
    loss to begin with, as multiples of the noise's own."""
    if state.clocks is not None:
        state = with_motion(problem, state)
    tables = tables_of(observations)
    thinned = observations.thinned(ENOUGH_POINTS)
    for width in wider:
        found, _ = _robust(problem, thinned, state, width * alone.noise, first, free, tables, most_rounds=1)
        state = found.state
    found, noise = _robust(problem, thinned, state, alone.noise, first, free, tables)
    if state.clocks is not None:
        found = replace(found, state=with_motion(problem, found.state))
    squares = residual_squares(observations, found.state)
    inliers = inliers_of(observations, squares, found.state, free, noise)
    if is_out_of_step(problem, observations, inliers, noise, alone=alone.noise) or are_clocks_shown(
        problem, thinned, found, free, noise
    ):
        noise = alone.noise
        found, free = fit_time_errors(problem, observations, replace(found, state=state), free, noise)
        inliers = inliers_of(observations, residual_squares(observations, found.state), found.state, free, noise)
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
    problem: Problem, priors: LensPriors, free: FreeParameters, lens: Floats, covariance: Floats
) -> tuple[LensPriors, FreeParameters]:
    """The priors of the lenses after a fit with them that gave lens (C, 9) with covariance (C, 9, 9), the classes
    weighed by what the Views say."""
    priors = weighed_priors(problem, priors, free.lens, lens, covariance)
    return priors, replace(free, prior_mean=priors.mean, prior_information=priors.information)


def _least_squares_stage(
    problem: Problem, observations: Observations, fit: _Fit, priors: LensPriors
) -> Joint | Contradicted:
    """Least squares until inliers, systematic errors and what is expected of noise and lenses stay the same, and the
    covariance."""
    tables, fold, costs = fit.adjustment.tables, folds_of(problem), fit.adjustment.costs
    errors = systematic_errors(problem, observations)
    expected = _Expected(fit.noise, priors, fit.free, errors)
    inliers, values, seen = fit.inliers, np.zeros(len(errors.held)), observations
    state, used = fit.adjustment.state, observations.with_weights(inliers.weights)
    near, rounds, reached, before = False, 0, None, None
    while True:
        rounds += 1
        if not near:
            found = adjust(
                used, state, expected.free, expected.noise, most_steps=_MOST_STEPS, tables=tables, tolerance=ROUGH
            )
            state, costs = found.state, costs + found.costs[:-1]
        try:
            end = _end(expected, values, used, state, tables, fold)
        except np.linalg.LinAlgError:
            if before is None:
                raise
            # A far step ended where rounding leaves nothing determined: what stood before it is where this goes on.
            end, state, values = before, before.adjustment.state, before.values
            used = expected.errors.corrected(observations, values).with_weights(inliers.weights)
            break
        costs, before = costs + end.adjustment.costs, end
        then = None
        if end.bordered.fall < _NEAR:
            reached = expected, end, used, inliers
            if end.bordered.fall < _SIGMA and fit.free.slack is None:
                expected, end, then = _expecting_alike(problem, expected, end, used)
        state, values = _moved(expected, end, observations, used)
        then = then or _learned(problem, expected, end, state.lens)
        squares = end.adjustment.linearised.squares
        again = inliers_of(seen, squares, end.adjustment.state, fit.free, then.noise)
        same = again.same_points(inliers)
        if same and then.is_like(expected) and end.bordered.fall < _SAME_ERRORS:
            return _joint(problem, expected, end, used, inliers, costs)
        near = same and end.bordered.fall < _NEAR
        expected, inliers, seen = then, again, expected.errors.corrected(observations, values)
        used = seen.with_weights(again.weights)
        contradicted = _contradicted(problem, observations, inliers)
        if contradicted:
            return contradicted
        # A fit that was near its minimum and is not there after so many is led away by what it learns.
        if rounds >= (_MOST_ROUNDS if reached is None and _are_likely(expected.errors, values) else _ROUNDS):
            break
    if end.bordered.fall > _NEAR:
        if reached is not None:
            # With what it taught, sheet, lens and focal bend against one another along a valley without an end.
            return _joint(problem, *reached, costs)
        # Few Views of one camera may bend sheet, lens and focal against one another along a long valley: what was not
        # reached is no solution, and the misfit stays in the noise.
        state, values, used = fit.adjustment.state, np.zeros_like(values), observations.with_weights(inliers.weights)
        expected = replace(expected, errors=errors)
    found = adjust(used, state, expected.free, expected.noise, most_steps=_MOST_STEPS, tables=tables)
    end = _end(expected, values, used, found.state, tables, fold)
    return _joint(problem, expected, end, used, inliers, costs)


def _are_likely(errors: SystematicErrors, values: Floats) -> bool:
    """Whether priors expect errors as large as these values (U,)."""
    count = len(values)
    return float(values @ errors.pull(values)) < count + _LIKELY * np.sqrt(2 * count)


def _joint(
    problem: Problem,
    expected: "_Expected",
    end: "_End",
    used: Observations,
    inliers: Inliers,
    costs: tuple[float, ...],
) -> Joint:
    noise = noise_of(*end.residuals, problem.expected_noise)
    return Joint(
        end.adjustment,
        used,
        expected.free,
        inliers,
        noise,
        max(end.residuals[1], 0.0) + EXPECTED_WEIGHT,
        end.reduced,
        expected.priors,
        costs,
        without_slack(used, end.adjustment.state, expected.free, noise),
        expected.errors,
        end.values,
        end.bordered.with_step_in_doubt(),
    )


@dataclass(frozen=True, eq=False)
class _Expected:
    """What a fit expects beforehand, as it learns it from the Views: noise (px), lenses, and systematic errors."""

    noise: float
    priors: LensPriors
    free: FreeParameters
    errors: SystematicErrors

    def is_like(self, other: "_Expected") -> bool:
        """Whether no figure differs by it."""
        return (
            abs(np.log(self.noise / other.noise)) < _SETTLED_NOISE
            and np.abs(self.priors.kinds - other.priors.kinds).max() < _SAME_CLASSES
            and self.errors.is_like(other.errors, _SETTLED_NOISE)
        )


def _learned(problem: Problem, before: _Expected, end: "_End", lens: Floats) -> _Expected:
    """What is to be expected after an end, and the lenses (C, 9) that its step leads to."""
    noise, errors = noise_of(*end.residuals, problem.expected_noise), before.errors
    priors, free = _weighed(problem, before.priors, before.free, lens, end.lens_covariances)
    if end.bordered.fall < _NEAR:
        fields = end.bordered.error_covariances(errors.lens_rows)
        errors = errors.with_learned_fields(end.bordered.values, fields)
    return _Expected(noise, priors, free, errors)


def _expecting_alike(
    problem: Problem, expected: _Expected, end: "_End", used: Observations
) -> tuple[_Expected, "_End", _Expected]:
    """The same end as it is once what it expects is nearly what it teaches, and this: of that all changes, and close
    by nothing of what the Views say."""
    then = _learned(problem, expected, end, end.lens_after)
    for _ in range(_LEARNING_ROUNDS):
        if then.is_like(expected):
            break
        found = reweighed(used, end.adjustment, then.free, expected.noise, then.noise)
        border = end.bordered.border.at_noise(expected.noise, then.noise)
        there = Expansion(found, undamped(found, then.free), border)
        expected, end = then, _solved(then, there, end.values, used)
        then = _learned(problem, expected, end, end.lens_after)
    return expected, end, then


@dataclass(frozen=True, eq=False)
class _End:
    """The end of an adjustment, its reduced system, and what the systematic errors, of values (U,) there, add to it.

    lens_covariances (C, 9, 9): with the errors' doubt. residuals: as residual_sum has it.
    """

    adjustment: Adjustment
    values: Floats
    reduced: Reduced
    bordered: Bordered
    lens_covariances: Floats
    residuals: tuple[float, float]

    @property
    def lens_after(self) -> Floats:
        """The lenses (C, 9) that the whole step leads to."""
        return self.adjustment.state.lens + self.adjustment.lens_steps(self.bordered.unit_steps)


def _end(expected: _Expected, values: Floats, used: Observations, state: State, tables: Tables, fold: Ints) -> _End:
    """values (U,): of the errors that were taken off; fold (N,): as expand has it."""
    there = expand(expected.errors, used, state, expected.free, expected.noise, tables, fold)
    return _solved(expected, there, values, used)


def _solved(expected: _Expected, there: Expansion, values: Floats, used: Observations) -> _End:
    found, reduced = there.adjustment, there.reduced
    bordered: Bordered
    if is_banded(reduced):
        bordered = solve_in_band(there.border, expected.errors, values, found, reduced)
    else:
        firm = reduced_inverse(reduced)
        bordered = solve_bordered(there.border, expected.errors, values, found, reduced, firm)
    lenses = bordered.lens_covariances(found)
    residuals = residual_sum(found, used, expected.free, expected.noise, lenses, bordered.effective)
    return _End(found, values, reduced, bordered, lenses, residuals)


def _moved(expected: _Expected, end: _End, observations: Observations, used: Observations) -> tuple[State, Floats]:
    """State and errors (U,) after the step, or after as much of it as lowers the cost: far from the minimum, where
    few Views leave a focal open, the whole of it may not."""
    errors = expected.errors
    found, values, bordered = end.adjustment, end.values, end.bordered
    if bordered.fall < _NEAR:
        return bordered.part(used, found, 1.0)
    weights = [group.weights for group in used.groups]

    def cost(state: State, at: Floats) -> float:
        seen = errors.corrected(observations, at).with_weights(weights)
        return cost_at(seen, state, expected.free, expected.noise) + float(at @ errors.pull(at))

    here, share = found.costs[-1] + float(values @ errors.pull(values)), 1.0
    for _ in range(_HALVINGS):
        state, at = bordered.part(used, found, share)
        if cost(state, at) < here:
            return state, at
        share /= 2
    return found.state, values


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


def _held_motions(first: FirstRig) -> tuple[MotionPrior, ...]:
    """Cameras are held where the motion says nothing of how they stand: noise would put them anywhere."""
    rig_from_camera = first.camera_from_rig.inverse()
    held = [(int(np.flatnonzero(one.cameras)[0]), one.open) for one in first.by_motion if one.open.size]
    return tuple(MotionPrior(row, twists, rig_from_camera[row], _HELD) for row, twists in held)
