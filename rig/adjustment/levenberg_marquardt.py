"""The joint adjustment: all lenses, camera poses and rectangle poses at once, to the least weighted squares.

Levenberg-Marquardt on the Schur complement (Triggs et al., "Bundle adjustment - a modern synthesis", 2000).
"""

from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.adjustment.normal_equations import (
    LENS,
    Layout,
    Linearised,
    Normal,
    State,
    chain_derivatives,
    layout,
    linearise,
    normal_equations,
)
from quadrig.rig.adjustment.schur import Reduced, eliminate, node_steps, solve_cameras
from quadrig.rig.adjustment.slack import EliminatedSlack, SlackPrior, eliminate_slack, slack_steps
from quadrig.rig.problem.observations import Observations
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.damping import MOST_DAMPING, UNSOLVABLE, Damping, gain

# A step that is expected to lower chi-square by less than this moves every parameter by less than a thousandth
# of its own sigma: nothing that a result prints can change.
CONVERGED = 1e-6
# Clocks are known to a second beforehand (1/s^2): this holds their common offset, which nothing else does.
_CLOCK_INFORMATION = 1.0
# Near a minimum each fall of chi-square is a share of the last one: as small as the last two show, but Gauss-Newton's
# neglect of residuals keeps it from getting much smaller than this (0.004 seen).
_SLOWEST = 0.01
_FIRST_DAMPING = 1e-5


@dataclass(frozen=True, eq=False)
class FreeParameters:
    """What may change, and what is known beforehand.

    lens (C, 9) bool, pose (C,) bool, node (N,) bool. prior_mean (C, 9), prior_information (C, 9, 9): Gaussian priors
    of the lenses. slack: the prior of each View's slack, None where no View has any.
    """

    lens: Mask
    pose: Mask
    node: Mask
    prior_mean: Floats
    prior_information: Floats
    slack: SlackPrior | None = None

    @property
    def information(self) -> Floats:
        """(C, 9, 9): what the priors say of the parameters that are estimated, the others being what they are."""
        return self.prior_information * (self.lens[:, :, None] & self.lens[:, None, :])

    @property
    def columns(self) -> Ints:
        """Indices of the lens parameters that any camera estimates."""
        return np.flatnonzero(self.lens.any(axis=0))

    def unknowns(self, columns: Ints, state: State) -> Mask:
        """(C, M) bool: which unknowns of the reduced system are estimated at a state."""
        parts = [self.lens[:, columns], np.repeat(self.pose[:, None], 6, axis=1)]
        if state.motion is not None and state.offsets is not None:
            parts.append(state.motion.free[:, None])
        return np.concatenate(parts, axis=1)


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Where the adjustment ended. costs: chi-square (with priors) at each step that was kept.

    linearised, normal: at the end, undamped; normal includes the priors. eliminated: what leads to the slack.
    """

    state: State
    costs: tuple[float, ...]
    linearised: Linearised
    normal: Normal
    layout: Layout
    columns: Ints
    eliminated: EliminatedSlack | None = None


def adjust(
    observations: Observations,
    state: State,
    free: FreeParameters,
    noise: float,
    *,
    robust: bool = False,
    most_steps: int = 50,
    tables: Layout | None = None,
    tolerance: float = CONVERGED,
) -> Adjustment:
    """The state of least cost that can be reached from `state`.

    noise: sigma (px) of a pixel coordinate of weight 1. robust: Cauchy's loss instead of squares. tolerance: the
    fall of chi-square to be expected of a further step, below which none is taken.
    """
    problem = _Adjusted(observations, free, tables or layout(observations), free.columns, noise, robust)
    if free.slack is not None and state.slack is None:
        state = replace(state, slack=np.zeros((len(observations.camera), 6)))
    here = _expand(problem, state)
    costs, damping = [here.cost], Damping.of(_FIRST_DAMPING)
    last = 0.0
    while len(costs) <= most_steps:
        found = _better(problem, here, damping)
        if found is None:
            break
        here, expected, damping = found
        costs.append(here.cost)
        share = expected / last if last > expected else 1.0
        if expected * max(share, _SLOWEST) < tolerance:
            break
        last = expected
    return Adjustment(
        here.state, tuple(costs), here.linearised, here.normal, problem.tables, problem.columns, here.eliminated
    )


@dataclass(frozen=True, eq=False)
class _Adjusted:
    """What stays the same through one adjustment."""

    observations: Observations
    free: FreeParameters
    tables: Layout
    columns: Ints
    noise: float
    robust: bool


@dataclass(frozen=True, eq=False)
class _Expansion:
    """The cost and its quadratic model at a state."""

    state: State
    cost: float
    linearised: Linearised
    normal: Normal
    eliminated: EliminatedSlack | None


def _linearised(problem: _Adjusted, state: State) -> tuple[Linearised, float]:
    found = linearise(problem.observations, state, problem.columns, problem.noise, robust=problem.robust)
    return found, found.cost + _prior_cost(state, problem.free)


def _expand(problem: _Adjusted, state: State, known: tuple[Linearised, float] | None = None) -> _Expansion:
    linearised, cost = known or _linearised(problem, state)
    prior, eliminated, gram = problem.free.slack, None, linearised.gram
    if prior is not None and state.slack is not None:
        eliminated = eliminate_slack(gram, state.slack, prior.information)
        gram = eliminated.gram
    normal = normal_equations(problem.observations, problem.tables, state, gram)
    return _Expansion(state, cost, linearised, with_prior(normal, state, problem.free, problem.columns), eliminated)


def _better(problem: _Adjusted, here: _Expansion, damping: Damping) -> tuple[_Expansion, float, Damping] | None:
    """The next state of lower cost, the fall that was expected, and the next damping; None at a minimum."""
    free, normal = problem.free, here.normal
    unknowns = free.unknowns(problem.columns, here.state)
    while damping.value < MOST_DAMPING:
        try:
            reduced = eliminate(normal, problem.tables, unknowns, free.node, float(damping.value))
            steps = solve_cameras(reduced)
        except np.linalg.LinAlgError:
            damping = damping.after(UNSOLVABLE)
            continue
        poses = node_steps(normal, problem.tables, reduced, steps)
        expected = float((steps * normal.camera_gradient * unknowns).sum() + (poses * normal.node_gradient).sum())
        trial = stepped(problem.observations, problem.columns, here.state, here.eliminated, steps, poses)
        found = _linearised(problem, trial)
        gained = gain(here.cost, found[1], expected)
        damping = damping.after(gained)
        if gained > 0:
            return _expand(problem, trial, found), expected, damping
        # At the very minimum rounding decides whether the cost still falls.
        if expected < CONVERGED:
            return None
    return None


def followed(found: Adjustment, observations: Observations, reduced: Reduced, steps: Floats) -> State:
    """The state after steps (C, M) of the cameras from the end of an adjustment; all else follows."""
    poses = node_steps(found.normal, found.layout, reduced, steps)
    return stepped(observations, found.columns, found.state, found.eliminated, steps, poses)


def stepped(
    observations: Observations,
    columns: Ints,
    state: State,
    eliminated: EliminatedSlack | None,
    steps: Floats,
    poses: Floats,
) -> State:
    """The state after steps of the cameras (C, M) and the nodes (N, 6); slack follows them."""
    count = len(columns)
    lens = np.zeros_like(state.lens)
    lens[:, columns] = steps[:, :count]
    slack = state.slack
    if eliminated is not None and slack is not None:
        slack = slack + slack_steps(eliminated, view_steps(observations, state, steps, poses, count))
    offsets = None if state.offsets is None else state.offsets + steps[:, count + 6 :].sum(axis=1)
    return replace(state.moved(lens, steps[:, count : count + 6], poses), slack=slack, offsets=offsets)


def view_steps(observations: Observations, state: State, steps: Floats, poses: Floats, lens: int) -> Floats:
    """Steps (V, K + 6) of lens and chained camera_from_rect, of steps of the cameras (C, M) and nodes (N, 6).

    lens: K, how many of a camera's unknowns are the lens's.
    """
    by_camera, by_node = chain_derivatives(observations, state)
    own = steps[observations.camera]
    chained = by_camera @ own[:, lens:, None] + by_node @ poses[observations.node][..., None]
    return np.concatenate([own[:, :lens], chained[..., 0]], axis=1)


def _prior_cost(state: State, free: FreeParameters) -> float:
    away = state.lens - free.prior_mean
    cost = float((away[:, None] @ free.information @ away[..., None]).sum())
    if free.slack is not None and state.slack is not None:
        held = np.where(free.slack.loose[:, None], free.slack.information, 0.0)
        cost += float((held * state.slack**2).sum())
    if state.offsets is not None:
        cost += float((state.offsets**2).sum()) * _CLOCK_INFORMATION
    return cost


def with_prior(normal: Normal, state: State, free: FreeParameters, columns: Ints) -> Normal:
    """The normal equations with the priors of the lens parameters added."""
    information = free.information
    pull = (information @ (free.prior_mean - state.lens)[..., None])[..., 0]
    cameras, gradient = normal.cameras.copy(), normal.camera_gradient.copy()
    cameras[:, : len(columns), : len(columns)] += information[:, columns[:, None], columns]
    gradient[:, : len(columns)] += pull[:, columns]
    if state.offsets is not None and state.motion is not None:
        cameras[:, -1, -1] += _CLOCK_INFORMATION
        gradient[:, -1] -= _CLOCK_INFORMATION * state.offsets
    return replace(normal, cameras=cameras, camera_gradient=gradient)


def undamped(adjustment: Adjustment, free: FreeParameters) -> Reduced:
    """The reduced system at the end of an adjustment, for covariances and tests."""
    unknowns = free.unknowns(adjustment.columns, adjustment.state)
    return eliminate(adjustment.normal, adjustment.layout, unknowns, free.node)


def lens_covariances(adjustment: Adjustment, covariance: Floats) -> Floats:
    """(C, 9, 9) of each camera's lens, from the covariance (C M, C M) of the reduced system."""
    cameras, columns = len(adjustment.state.lens), adjustment.columns
    blocks = covariance.reshape(cameras, len(covariance) // cameras, cameras, -1)
    own = blocks[np.arange(cameras), :, np.arange(cameras), :]
    result = np.zeros((cameras, LENS, LENS))
    result[:, columns[:, None], columns] = own[:, : len(columns), : len(columns)]
    return result
