"""From a first rig to the best one: robust fit, outliers out, lenses chosen, least squares to the end."""

from dataclasses import dataclass, replace

import numpy as np

from quadrig.single.rotation import Array

from .adjust import Adjustment, Freedom, adjust, undamped
from .elimination import Reduced, reduced_inverse
from .graph import FirstRig
from .lens_choice import LensChoices, choose_lenses, starting_lenses
from .normal_equations import State, linearise
from .observations import Observations
from .outliers import Judged, judge, noise_of, robust_noise
from .principal_point import learned_sigma
from .problem import Problem
from .slack import learned_information, strays
from .start import LEAST_NOISE, Start, prior

# Principal points of lenses people use lie this far from the middle (root mean square), as a share of the larger
# side: measured on webcams (1.7 %), machine-vision cameras (3 %) and GoPros (0.5 %).
PRINCIPAL_SIGMA = 0.02
# The joint fit may leave this much more than the cameras each by themselves did before the Views of moving rectangles
# are taken to be out of step: chance and first lenses leave a tenth or so.
_OUT_OF_STEP = 1.5
# Slack that learning starts from, rad and m: wide, since it converges from above in few rounds.
_FIRST_SLACK = 0.02
_SLACK_ROUNDS = 6
# Rounds of throwing out and taking back corners: the second rarely changes anything.
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Joint:
    """The end of the joint adjustment.

    observations carry the final weights; judged says what was thrown out. covariance (C M, C M) over the columns of
    the adjustment and the steps of camera_from_rig. predicted: the state whose rectangle poses fit the pictures best
    with no View straying: what the rig says of them, and what residuals are told against.
    """

    adjustment: Adjustment
    observations: Observations
    freedom: Freedom
    judged: Judged
    noise: float
    covariance: Array
    reduced: Reduced
    choices: LensChoices
    costs: tuple[float, ...]
    principal_sigma: float
    predicted: State


def solve_jointly(
    problem: Problem, begin: Start, first: FirstRig, fixed_camera: int | None, fixed_node: int | None
) -> Joint:
    """Adjust everything at once. Exactly one of fixed_camera, fixed_node holds the rig frame."""
    observations = problem.observations(first.reading)
    freedom = _freedom(problem, observations, starting_lenses(problem), PRINCIPAL_SIGMA, fixed_camera, fixed_node)
    state = State(begin.lens, first.camera_from_rig, first.rig_from_node)
    state, noise, costs = _robust(observations, state, freedom, first, max(begin.noise, LEAST_NOISE))
    if noise > _OUT_OF_STEP * begin.noise:
        noise = begin.noise
        state, freedom = _loosened(problem, observations, state, freedom, noise)
    judged = _judge(observations, state, freedom, noise)
    used = observations.with_weights(judged.weights)
    choices = choose_lenses(problem, used, state, freedom, noise)
    state = replace(state, lens=np.where(choices.free | ~_changeable(problem), state.lens, freedom.prior_mean))
    freedom = replace(freedom, lens=choices.free)
    adjustment = adjust(used, state, freedom, noise)
    principal_sigma = PRINCIPAL_SIGMA
    for _ in range(_ROUNDS):
        state = adjustment.state
        costs += adjustment.costs
        learned = learned_sigma(problem, adjustment, freedom, PRINCIPAL_SIGMA)
        noise = _noise(adjustment, used, freedom, noise)
        again = _judge(observations, state, freedom, noise)
        same = all(np.array_equal(a > 0, b > 0) for a, b in zip(again.weights, judged.weights, strict=True))
        if same and learned == principal_sigma:
            break
        judged, principal_sigma = again, learned
        used = observations.with_weights(judged.weights)
        freedom = replace(freedom, prior_information=prior(problem, principal_sigma)[1])
        adjustment = adjust(used, state, freedom, noise)
    # Weights of the final noise: the same minimum but for the priors' share, and the covariance that belongs to it.
    adjustment = adjust(used, adjustment.state, freedom, noise)
    reduced = undamped(adjustment, freedom)
    covariance = reduced_inverse(reduced)
    predicted = _without_slack(used, adjustment.state, freedom, noise)
    return Joint(
        adjustment,
        used,
        freedom,
        judged,
        noise,
        covariance,
        reduced,
        choices,
        costs + adjustment.costs,
        principal_sigma,
        predicted,
    )


def _loosened(
    problem: Problem, observations: Observations, state: State, freedom: Freedom, noise: float
) -> tuple[State, Freedom]:
    """State and freedom with slack for the Views of moving rectangles, its width learned."""
    moving = np.array([problem.rectangles[view.rectangle].moving for view in problem.views])
    if not moving.any():
        return state, freedom
    information = np.full((len(moving), 6), np.inf)
    information[moving] = 1 / _FIRST_SLACK**2
    freedom = replace(freedom, slack_information=information)
    for _ in range(_SLACK_ROUNDS):
        found = adjust(observations, state, freedom, noise, robust=True, most_steps=3)
        state = found.state
        assert found.softened is not None
        assert state.slack is not None
        freedom = replace(freedom, slack_information=learned_information(state.slack, found.softened, information))
        information = freedom.slack_information
    return state, freedom


def _without_slack(used: Observations, state: State, freedom: Freedom, noise: float) -> State:
    """The cameras as they are, rectangle poses by least squares of the residuals alone."""
    if state.slack is None:
        return state
    still = np.zeros(used.cameras, bool)
    fixed = replace(freedom, lens=np.zeros_like(freedom.lens), pose=still, slack_information=None)
    return adjust(used, replace(state, slack=None), fixed, noise).state


def _judge(observations: Observations, state: State, freedom: Freedom, noise: float) -> Judged:
    """Corners by their residual, and Views of moving rectangles by how far they stray."""
    judged = judge(observations, _squares(observations, state), noise)
    if state.slack is None or freedom.slack_information is None:
        return judged
    stray = strays(state.slack, freedom.slack_information)
    weights = [
        np.where(stray[g.view][:, None], 0.0, w) for g, w in zip(observations.groups, judged.weights, strict=True)
    ]
    return Judged(tuple(weights), judged.rejected | stray)


def _changeable(problem: Problem) -> Array:
    """(C, 1) bool: cameras whose lens is estimated; a lens that is kept keeps all its numbers."""
    return np.array([[not c.fixed] for c in problem.cameras])


def _freedom(
    problem: Problem,
    observations: Observations,
    lens: Array,
    principal_sigma: float,
    fixed_camera: int | None,
    fixed_node: int | None,
) -> Freedom:
    mean, information = prior(problem, principal_sigma)
    pose, node = np.ones(observations.cameras, bool), np.ones(observations.nodes, bool)
    if fixed_camera is not None:
        pose[fixed_camera] = False
    if fixed_node is not None:
        node[fixed_node] = False
    return Freedom(lens, pose, node, mean, information)


def _robust(
    observations: Observations, state: State, freedom: Freedom, first: FirstRig, noise: float
) -> tuple[State, float, tuple[float, ...]]:
    """Cauchy's loss from the first rig on, Views that fit nothing left out until the rig can judge them."""
    weights = [np.where(first.agrees[g.view][:, None], g.weights, 0.0) for g in observations.groups]
    trusted = observations.with_weights(weights)
    costs: tuple[float, ...] = ()
    for steps in (4, 8):
        found = adjust(trusted, state, freedom, noise, robust=True, most_steps=steps)
        state, costs = found.state, costs + found.costs
        noise = max(robust_noise(trusted, _squares(trusted, state)), LEAST_NOISE)
    return state, noise, costs


def _squares(observations: Observations, state: State) -> tuple[Array, ...]:
    return linearise(observations, state, np.zeros(0, int), 1.0, False).squares


def _noise(adjustment: Adjustment, used: Observations, freedom: Freedom, noise: float) -> float:
    """Sigma of a coordinate from what is left over, counting parameters that a prior holds for less than one."""
    chi_square = adjustment.linearised.cost * noise**2
    seen = np.zeros(used.nodes, bool)
    for group in used.groups:
        seen[group.node[(group.weights > 0).any(axis=1)]] = True
    unknowns = 6 * int((seen & freedom.node).sum()) + 6 * int(freedom.pose.sum())
    reduced = undamped(adjustment, freedom)
    variance = np.diagonal(reduced_inverse(reduced)).reshape(reduced.free.shape)[:, : len(adjustment.columns)]
    held = (freedom.prior_information * freedom.lens)[:, adjustment.columns] * variance
    unknowns += float(freedom.lens.sum() - held.sum())
    if adjustment.softened is not None and freedom.slack_information is not None:
        loose = np.isfinite(freedom.slack_information)
        pulled = np.where(loose, freedom.slack_information, 0.0)
        unknowns += float((loose - pulled * np.einsum("vii->vi", adjustment.softened.inverse)).sum())
    return noise_of(chi_square, 2 * used.count - unknowns)
