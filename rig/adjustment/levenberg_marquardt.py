"""The joint adjustment: all lenses, camera poses and rectangle poses at once, to the least weighted squares.

Levenberg-Marquardt on the Schur complement (Triggs et al., "Bundle adjustment - a modern synthesis", 2000).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from quadrig.rig.adjustment.motion import CLOCK, CLOCK_INFORMATION
from quadrig.rig.adjustment.normal_equations import (
    Linearised,
    Normal,
    linearise,
    normal_equations,
    residual_squares,
    weighed,
)
from quadrig.rig.adjustment.pose_priors import LayoutPrior, MotionPrior
from quadrig.rig.adjustment.schur import Reduced, eliminate, node_steps, solve_units
from quadrig.rig.adjustment.slack import EliminatedSlack, SlackPrior, eliminate_slack, slack_steps
from quadrig.rig.adjustment.state import LENS, State, chain_derivatives
from quadrig.rig.adjustment.tables import Tables, tables_of
from quadrig.rig.problem.observations import Observations
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.damping import MOST_DAMPING, UNSOLVABLE, Damping, gain

# A step that is expected to lower chi-square by less than this moves every parameter by less than a thousandth
# of its own sigma: nothing that a result prints can change.
CONVERGED = 1e-6
_FIRST_DAMPING = 1e-5


@dataclass(frozen=True, eq=False)
class FreeParameters:
    """What may change, and what is known beforehand.

    lens (C, 9) bool, pose (C,) bool, node (N,) bool. prior_mean (C, 9), prior_information (C, 9, 9): Gaussian priors
    of the lenses. slack: the prior of each View's slack, None where no View has any. layouts: of the poses of
    rectangles on their bodies, which may change where is_layout_free. motions: of cameras, where nothing shows them.
    """

    lens: Mask
    pose: Mask
    node: Mask
    prior_mean: Floats
    prior_information: Floats
    slack: SlackPrior | None = None
    layouts: LayoutPrior = field(default_factory=LayoutPrior)
    is_layout_free: bool = True
    motions: tuple[MotionPrior, ...] = ()

    @property
    def information(self) -> Floats:
        """(C, 9, 9): what the priors say of the parameters that are estimated, the others being what they are."""
        return self.prior_information * (self.lens[:, :, None] & self.lens[:, None, :])

    @property
    def columns(self) -> Ints:
        """Indices of the lens parameters that any camera estimates."""
        return np.flatnonzero(self.lens.any(axis=0))

    def unknowns(self, columns: Ints, state: State) -> Mask:
        """(E, M) bool: which unknowns of the reduced system are estimated at a state."""
        parts = [self.lens[:, columns], np.repeat(self.pose[:, None], 6, axis=1)]
        if state.motion is not None and state.clocks is not None:
            parts.append(state.motion.free)
        cameras = np.concatenate(parts, axis=1)
        layouts = np.zeros((len(self.layouts.information), cameras.shape[1]), bool)
        layouts[:, len(columns) : len(columns) + 6] = self.is_layout_free
        return np.concatenate([cameras, layouts])


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Where the adjustment ended. costs: chi-square (with priors) at each step that was kept.

    linearised, normal: at the end, undamped; normal includes the priors. eliminated: what leads to the slack.
    """

    state: State
    costs: tuple[float, ...]
    linearised: Linearised
    normal: Normal
    tables: Tables
    columns: Ints
    eliminated: EliminatedSlack | None = None

    def stepped(self, observations: Observations, steps: Floats, poses: Floats) -> State:
        """The state after steps of the units (E, M) and the nodes (N, 6); slack follows them."""
        return _stepped(observations, self, steps, poses)

    def lens_steps(self, steps: Floats) -> Floats:
        """The steps (C, 9) of the lenses, of those of the units (E, M)."""
        return _lens_steps(self, steps)


def adjust(
    observations: Observations,
    state: State,
    free: FreeParameters,
    noise: float,
    *,
    robust: bool = False,
    most_steps: int = 50,
    tables: Tables | None = None,
    tolerance: float = CONVERGED,
) -> Adjustment:
    """The state of least cost that can be reached from `state`.

    noise: sigma (px) of a pixel coordinate of weight 1. robust: Cauchy's loss instead of squares. tolerance: the
    fall of chi-square to be expected of a further step, below which none is taken.
    """
    problem = _Adjusted(observations, free, tables or tables_of(observations), free.columns, noise, robust)
    if free.slack is not None and state.slack is None:
        state = replace(state, slack=np.zeros((len(observations.camera), 6)))
    here = _expand(problem, state)
    costs, damping = [here.cost], Damping.of(_FIRST_DAMPING)
    while len(costs) <= most_steps and (found := _better(problem, here, damping, tolerance)) is not None:
        here, damping = found
        costs.append(here.cost)
    return _ended(here, costs)


def at_state(
    observations: Observations,
    state: State,
    free: FreeParameters,
    noise: float,
    tables: Tables,
    linearised: Linearised,
) -> Adjustment:
    """The end of an adjustment by least squares that took no step, of Views that are linearised already."""
    problem = _Adjusted(observations, free, tables, free.columns, noise, robust=False)
    here = _expand(problem, state, (linearised, linearised.cost + _prior_cost(state, free)))
    return _ended(here, [here.cost])


def cost_at(observations: Observations, state: State, free: FreeParameters, noise: float) -> float:
    """Chi-square of a state, with priors. noise: px."""
    squares = residual_squares(observations, state)
    costs = [weighed(g, s, noise, robust=False)[1] for g, s in zip(observations.groups, squares, strict=True)]
    return sum(costs) + _prior_cost(state, free)


@dataclass(frozen=True, eq=False)
class _Adjusted:
    """What stays the same through one adjustment."""

    observations: Observations
    free: FreeParameters
    tables: Tables
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
    tables: Tables
    columns: Ints
    eliminated: EliminatedSlack | None


def _ended(here: _Expansion, costs: Sequence[float]) -> Adjustment:
    parts = here.linearised, here.normal, here.tables, here.columns, here.eliminated
    return Adjustment(here.state, tuple(costs), *parts)


def _stepped(observations: Observations, here: "Adjustment | _Expansion", steps: Floats, poses: Floats) -> State:
    state, count, cameras = here.state, len(here.columns), len(here.state.lens)
    lens = _lens_steps(here, steps)
    slack = state.slack
    if here.eliminated is not None and slack is not None:
        slack = slack + slack_steps(
            here.eliminated, view_steps(observations, here.tables, state, steps, poses, count)
        )
    clocks = state.clocks if state.motion is None or state.clocks is None else state.clocks + steps[:cameras, -CLOCK:]
    twists = steps[:, count : count + 6]
    return replace(state.moved(lens, twists[:cameras], poses, twists[cameras:]), slack=slack, clocks=clocks)


def _lens_steps(here: "Adjustment | _Expansion", steps: Floats) -> Floats:
    lens = np.zeros_like(here.state.lens)
    lens[:, here.columns] = steps[: len(lens), : len(here.columns)]
    return lens


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
    normal = with_prior(normal, state, problem.free, problem.columns)
    return _Expansion(state, cost, linearised, normal, problem.tables, problem.columns, eliminated)


def _better(
    problem: _Adjusted, here: _Expansion, damping: Damping, tolerance: float
) -> tuple[_Expansion, Damping] | None:
    """The next state of lower cost, and the next damping; None where the cost is expected to fall by less than the
    tolerance, if at all."""
    free, normal = problem.free, here.normal
    unknowns = free.unknowns(problem.columns, here.state)
    while damping.value < MOST_DAMPING:
        try:
            reduced = eliminate(normal, problem.tables, unknowns, free.node, float(damping.value))
            steps = solve_units(reduced)
        except np.linalg.LinAlgError:
            damping = damping.after(UNSOLVABLE)
            continue
        poses = node_steps(normal, problem.tables, reduced, steps)
        expected = float((steps * normal.unit_gradient * unknowns).sum() + (poses * normal.node_gradient).sum())
        # A step that damping cut short may promise little wherever it is.
        if expected < (tolerance if damping.value <= _FIRST_DAMPING else CONVERGED):
            return None
        trial = _stepped(problem.observations, here, steps, poses)
        found = _linearised(problem, trial)
        gained = gain(here.cost, found[1], expected)
        damping = damping.after(gained)
        if gained > 0:
            return _expand(problem, trial, found), damping
    return None


def reweighed(
    observations: Observations, found: Adjustment, free: FreeParameters, before: float, noise: float
) -> Adjustment:
    """The end of an adjustment made with another noise (px, before) and other priors, as these would have it there.
    No View strays."""
    share, state = (before / noise) ** 2, found.state
    linearised = replace(found.linearised, gram=share * found.linearised.gram, cost=share * found.linearised.cost)
    normal = normal_equations(observations, found.tables, state, linearised.gram)
    return replace(found, linearised=linearised, normal=with_prior(normal, state, free, found.columns))


def followed(found: Adjustment, observations: Observations, reduced: Reduced, steps: Floats) -> State:
    """The state after steps (E, M) of the units from the end of an adjustment; all else follows."""
    poses = node_steps(found.normal, found.tables, reduced, steps)
    return found.stepped(observations, steps, poses)


def view_steps(
    observations: Observations, tables: Tables, state: State, steps: Floats, poses: Floats, lens: int
) -> Floats:
    """Steps (V, K + 6) of lens and chained camera_from_rect, of steps of the units (E, M) and nodes (N, 6); with the
    line time after the lens, where things move.

    lens: K, how many of a camera's unknowns are the lens's.
    """
    chain = chain_derivatives(observations, state)
    own = steps[tables.camera]
    chained = (chain.by_camera @ own[:, lens:, None] + chain.by_node @ poses[observations.node][..., None])[..., 0]
    if len(tables.loose):
        by_layout = chain.by_layout[tables.loose]
        chained[tables.loose] += (by_layout @ steps[tables.layout, lens : lens + 6, None])[..., 0]
    line = [] if state.motion is None else [own[:, -1:]]
    return np.concatenate([own[:, :lens], *line, chained], axis=1)


def _prior_cost(state: State, free: FreeParameters) -> float:
    away = state.lens - free.prior_mean
    cost = float((away[:, None] @ free.information @ away[..., None]).sum())
    if free.slack is not None and state.slack is not None:
        held = np.where(free.slack.loose[:, None], free.slack.information, 0.0)
        cost += float((held * state.slack**2).sum())
    if state.clocks is not None:
        cost += float((CLOCK_INFORMATION * state.clocks**2).sum())
    cost += sum(prior.cost(state) for prior in free.motions)
    return cost + free.layouts.cost(state) if len(free.layouts.information) else cost


def with_prior(normal: Normal, state: State, free: FreeParameters, columns: Ints) -> Normal:
    """The normal equations with the priors of lenses, clocks and given layouts added."""
    information, cameras, count = free.information, len(state.lens), len(columns)
    pull = (information @ (free.prior_mean - state.lens)[..., None])[..., 0]
    units, gradient = normal.units.copy(), normal.unit_gradient.copy()
    units[:cameras, :count, :count] += information[:, columns[:, None], columns]
    gradient[:cameras, :count] += pull[:, columns]
    if state.clocks is not None and state.motion is not None:
        units[:cameras, range(-CLOCK, 0), range(-CLOCK, 0)] += CLOCK_INFORMATION
        gradient[:cameras, -CLOCK:] -= CLOCK_INFORMATION * state.clocks
    twist = slice(count, count + 6)
    if len(free.layouts.information):
        of_layouts, down = free.layouts.on_twists(state)
        units[cameras:, twist, twist] += of_layouts
        gradient[cameras:, twist] += down
    for prior in free.motions:
        own, down = prior.on_twist(state)
        units[prior.camera, twist, twist] += own
        gradient[prior.camera, twist] += down
    return replace(normal, units=units, unit_gradient=gradient)


def undamped(adjustment: Adjustment, free: FreeParameters) -> Reduced:
    """The reduced system at the end of an adjustment, for covariances and tests."""
    unknowns = free.unknowns(adjustment.columns, adjustment.state)
    return eliminate(adjustment.normal, adjustment.tables, unknowns, free.node)


def lens_covariances(adjustment: Adjustment, blocks: Floats) -> Floats:
    """(C, 9, 9) of each camera's lens, from the covariances (E, M, M) of the units."""
    cameras, columns = len(adjustment.state.lens), adjustment.columns
    result = np.zeros((cameras, LENS, LENS))
    result[:, columns[:, None], columns] = blocks[:cameras, : len(columns), : len(columns)]
    return result
