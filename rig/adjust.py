"""The joint adjustment: all lenses, camera poses and rectangle poses at once, to the least weighted squares.

Levenberg-Marquardt on the Schur complement (Triggs et al., "Bundle adjustment - a modern synthesis", 2000).
"""

from dataclasses import dataclass, replace

import numpy as np

from quadrig.single.rotation import Array

from .elimination import Reduced, eliminate, node_steps, solve_cameras
from .normal_equations import (
    Layout,
    Linearised,
    Normal,
    State,
    layout,
    linearise,
    normal_equations,
)
from .observations import Observations

# A step that is expected to lower chi-square by less than this moves every parameter by less than a thousandth
# of its own sigma: nothing that a result prints can change.
_CONVERGED = 1e-6
_FIRST_DAMPING = 1e-5
# Past this damping a step is shorter than rounding; the state is at a minimum, or cannot be left.
_LAST_DAMPING = 1e8


@dataclass(frozen=True, eq=False)
class Freedom:
    """What may change, and what is known beforehand.

    lens (C, 9) bool, pose (C,) bool, node (N,) bool. prior_mean, prior_information (C, 9): independent Gaussian
    priors of the lens parameters, information in 1/sigma^2, zero for none.
    """

    lens: Array
    pose: Array
    node: Array
    prior_mean: Array
    prior_information: Array

    @property
    def columns(self) -> Array:
        """Indices of the lens parameters that any camera estimates."""
        return np.flatnonzero(self.lens.any(axis=0))

    def unknowns(self, columns: Array) -> Array:
        """(C, K + 6) bool: which unknowns of the reduced system are estimated."""
        return np.concatenate([self.lens[:, columns], np.repeat(self.pose[:, None], 6, axis=1)], axis=1)


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Where the adjustment ended. costs: chi-square (with priors) at each step that was kept.

    linearised, normal: at the end, undamped; normal includes the priors.
    """

    state: State
    costs: tuple[float, ...]
    linearised: Linearised
    normal: Normal
    layout: Layout
    columns: Array


def adjust(
    observations: Observations,
    state: State,
    freedom: Freedom,
    noise: float,
    robust: bool = False,
    most_steps: int = 50,
    tables: Layout | None = None,
) -> Adjustment:
    """The state of least cost that can be reached from `state`.

    noise: sigma (px) of a pixel coordinate of weight 1. robust: Cauchy's loss instead of squares.
    """
    tables = tables or layout(observations)
    columns = freedom.columns
    unknowns = freedom.unknowns(columns)
    current = linearise(observations, state, columns, noise, robust)
    cost = current.cost + _prior_cost(state, freedom)
    normal = with_prior(normal_equations(observations, tables, state, current.gram), state, freedom, columns)
    costs, damping = [cost], _FIRST_DAMPING
    while len(costs) <= most_steps:
        found = _better(observations, tables, state, freedom, unknowns, normal, cost, damping, noise, robust)
        if found is None:
            break
        state, current, expected, damping = found
        cost = current.cost + _prior_cost(state, freedom)
        costs.append(cost)
        normal = with_prior(normal_equations(observations, tables, state, current.gram), state, freedom, columns)
        if expected < _CONVERGED:
            break
    return Adjustment(state, tuple(costs), current, normal, tables, columns)


def _better(
    observations: Observations,
    tables: Layout,
    state: State,
    freedom: Freedom,
    unknowns: Array,
    normal: Normal,
    cost: float,
    damping: float,
    noise: float,
    robust: bool,
) -> tuple[State, Linearised, float, float] | None:
    """The next state of lower cost, the fall that was expected, and the next damping; None at a minimum."""
    columns = freedom.columns
    while damping < _LAST_DAMPING:
        try:
            reduced = eliminate(normal, tables, unknowns, freedom.node, damping)
            steps = solve_cameras(reduced)
        except np.linalg.LinAlgError:
            damping *= 100
            continue
        poses = node_steps(normal, tables, reduced, steps)
        expected = float((steps * normal.camera_gradient * unknowns).sum() + (poses * normal.node_gradient).sum())
        trial = _stepped(state, columns, steps, poses)
        found = linearise(observations, trial, columns, noise, robust)
        # At the very minimum rounding decides whether the cost still falls: equal to its last digits is as good.
        if found.cost + _prior_cost(trial, freedom) <= cost * (1 + 1e-14):
            return trial, found, expected, damping / 10
        if expected < _CONVERGED:
            return None
        damping = max(damping, 1e-6) * 10
    return None


def _stepped(state: State, columns: Array, steps: Array, poses: Array) -> State:
    lens = state.lens.copy()
    lens[:, columns] += steps[:, : len(columns)]
    return State(lens, state.camera_from_rig.retract(steps[:, len(columns) :]), state.rig_from_rect.retract(poses))


def _prior_cost(state: State, freedom: Freedom) -> float:
    return float((freedom.prior_information * freedom.lens * (state.lens - freedom.prior_mean) ** 2).sum())


def with_prior(normal: Normal, state: State, freedom: Freedom, columns: Array) -> Normal:
    """The normal equations with the priors of the lens parameters added."""
    information = (freedom.prior_information * freedom.lens)[:, columns]
    cameras, gradient = normal.cameras.copy(), normal.camera_gradient.copy()
    place = np.arange(len(columns))
    cameras[:, place, place] += information
    gradient[:, place] += information * (freedom.prior_mean - state.lens)[:, columns]
    return replace(normal, cameras=cameras, camera_gradient=gradient)


def undamped(adjustment: Adjustment, freedom: Freedom) -> Reduced:
    """The reduced system at the end of an adjustment, for covariances and tests."""
    unknowns = freedom.unknowns(adjustment.columns)
    return eliminate(adjustment.normal, adjustment.layout, unknowns, freedom.node)
