"""Cameras out of step: moving rectangles seen at other instants than the frameset's, by slack and clocks."""

from dataclasses import replace

import numpy as np

from quadrig.rig.adjustment.levenberg_marquardt import Adjustment, FreeParameters, adjust
from quadrig.rig.adjustment.motion import motion
from quadrig.rig.adjustment.outliers import Inliers, find_outliers, robust_noise
from quadrig.rig.adjustment.schur import node_inverses
from quadrig.rig.adjustment.slack import SlackPrior, learned, slack_variances, strays
from quadrig.rig.adjustment.state import State, chain_derivatives
from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.observations import Observations
from quadrig.single.arrays import Floats, Mask

# Fall of chi-square, beyond two for each unknown, that shows clocks to be more than chance; the steps to see it by.
_EVIDENCE, _CLOCK_STEPS = 30.0, 3
# A fit that others follow is good enough once a step would lower chi-square by this little: a sigma.
_ROUGH = 1.0
# The joint fit may leave this much more than the cameras each by themselves did before the Views of moving rectangles
# are taken to be out of step: chance and first lenses leave a tenth or so.
_OUT_OF_STEP = 1.5
# Nor does a camera lose this share of its Views to chance or to single faults.
_OUTVOTED = 0.3
# A camera that is out of step loses nearly all of them; one with many wrong ids keeps at least half.
_MAJORITY = 0.5
# Slack that learning starts from, rad and m: wide, since it converges from above in few rounds.
_FIRST_SLACK = 0.02
_SLACK_ROUNDS = 15
# A width that changes by less than this (log) is learned.
_SAME_WIDTH = 0.1
# Clocks explain everything when no more noise is left than this much of what the cameras by themselves have.
_EXPLAINED = 1.1


def is_out_of_step(
    problem: Problem, observations: Observations, inliers: Inliers, noise: float, *, alone: float
) -> bool:
    """Whether the joint fit leaves more than chance does. noise, alone: px, of it and of each camera by itself."""
    return noise > _OUT_OF_STEP * alone or bool(_outvoted(problem, observations, inliers, _OUTVOTED).any())


def are_clocks_shown(
    problem: Problem, observations: Observations, found: Adjustment, free: FreeParameters, noise: float
) -> bool:
    """Whether what moves is followed much better with stamps, offsets and line times than as of one instant: shutters
    that roll bend every View alike, and the cameras follow with hardly more noise."""
    state = found.state
    if state.motion is not None or not problem.moving.any():
        return False
    state = with_motion(problem, state)
    if state.motion is None:
        return False
    least = adjust(observations, found.state, free, noise, robust=True, most_steps=0, tables=found.tables).costs[-1]
    tried = adjust(observations, state, free, noise, robust=True, most_steps=_CLOCK_STEPS, tables=found.tables)
    return least - tried.costs[-1] > _EVIDENCE + 2 * int(state.motion.free.sum())


def inliers_of(
    observations: Observations, squares: tuple[Floats, ...], state: State, free: FreeParameters, noise: float
) -> Inliers:
    """Corners by their residual, and Views of moving rectangles by how far they stray."""
    found = find_outliers(observations, squares, noise)
    if state.slack is None or free.slack is None:
        return found
    return found.without(observations, strays(state.slack, free.slack))


def fit_time_errors(
    problem: Problem, observations: Observations, found: Adjustment, free: FreeParameters, noise: float
) -> tuple[Adjustment, FreeParameters]:
    """The fit with slack for the Views of moving rectangles and the cameras' clocks, the width of the slack learned;
    without slack where it is not needed."""
    if not problem.moving.any():
        return found, free
    slack_prior = SlackPrior.wide(problem.moving, _FIRST_SLACK)
    state, tables = found.state, found.tables
    for _ in range(_SLACK_ROUNDS):
        free = replace(free, slack=slack_prior)
        found = adjust(observations, state, free, noise, robust=True, most_steps=3, tables=tables, tolerance=_ROUGH)
        last, slack_prior = slack_prior, _learned_prior(observations, found, slack_prior)
        state = with_motion(problem, found.state)
        if np.abs(np.log(slack_prior.precision / last.precision)).max() < _SAME_WIDTH:
            break
    free = replace(free, slack=slack_prior)
    found = adjust(observations, state, free, noise, robust=True, most_steps=6, tables=tables, tolerance=_ROUGH)
    return _without_need(problem, observations, found, free, noise)


def _learned_prior(observations: Observations, found: Adjustment, slack_prior: SlackPrior) -> SlackPrior:
    assert found.eliminated is not None
    assert found.state.slack is not None
    by_node = chain_derivatives(observations, found.state).by_node
    covariance = node_inverses(found.normal)[observations.node]
    variances = slack_variances(found.eliminated, by_node, covariance)
    return learned(found.state.slack, variances, slack_prior)


def with_motion(problem: Problem, state: State) -> State:
    """The state with the motion of rectangles that its poses show, where frames are close enough to show any."""
    clocks = problem.first_clocks if state.clocks is None else state.clocks
    moved = motion(problem, state.rig_from_body, clocks)
    if moved is None:
        return state
    return replace(state, motion=moved, clocks=clocks)


def without_slack(used: Observations, state: State, free: FreeParameters, noise: float) -> State:
    """The cameras and clocks as they are, rectangle poses by least squares of the residuals alone."""
    if state.slack is None:
        return state
    still = np.zeros(used.cameras, bool)
    fixed = replace(free, lens=np.zeros_like(free.lens), pose=still, slack=None, is_layout_free=False)
    firm = replace(state, slack=None)
    if state.motion is None:
        return adjust(used, firm, fixed, noise).state
    held = replace(firm, motion=replace(state.motion, free=np.zeros_like(state.motion.free)))
    return replace(adjust(used, held, fixed, noise).state, motion=state.motion)


def _without_need(
    problem: Problem, observations: Observations, found: Adjustment, free: FreeParameters, noise: float
) -> tuple[Adjustment, FreeParameters]:
    """The fit without slack where clocks, or single Views that are wrong, explain what the cameras disagreed on; else
    as it is."""
    firm = replace(free, slack=None)
    inliers = inliers_of(observations, found.linearised.squares, found.state, free, noise)
    kept = observations.with_weights(inliers.weights)
    state = replace(found.state, slack=None)
    tried = adjust(kept, state, firm, noise, robust=True, most_steps=12, tables=found.tables, tolerance=_ROUGH)
    quiet = robust_noise(kept, tried.linearised.squares) < _EXPLAINED * noise
    inliers = find_outliers(observations, tried.linearised.squares, noise)
    outvoted = _outvoted(problem, observations, inliers, _MAJORITY)
    return (tried, firm) if quiet and not outvoted.any() else (found, free)


def _outvoted(problem: Problem, observations: Observations, inliers: Inliers, share: float) -> Mask:
    """Cameras (C,) bool that lost more than a share of their Views: sound by themselves, at odds with the others.

    Only of rectangles that move: what stands still looks the same at every instant, and no clock explains it.
    """
    seen = np.bincount(observations.camera, problem.moving, observations.cameras)
    lost = np.bincount(observations.camera, inliers.rejected & problem.moving, observations.cameras)
    return lost > share * seen
