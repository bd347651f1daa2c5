"""From a first rig to the best one: robust fit, outliers out, lenses chosen, least squares to the end."""

from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.adjustment.levenberg_marquardt import Adjustment, Freedom, adjust, undamped, with_noise
from quadrig.rig.adjustment.motion import motion
from quadrig.rig.adjustment.normal_equations import Layout, State, chain_derivatives, layout, residual_squares
from quadrig.rig.adjustment.outliers import Judged, judge, noise_of, robust_noise
from quadrig.rig.adjustment.priors import ENOUGH_POINTS, LEAST_NOISE, ROUGH, prior
from quadrig.rig.adjustment.schur import Reduced, node_inverses, reduced_inverse
from quadrig.rig.adjustment.slack import SlackPrior, learned, slack_variances, strays
from quadrig.rig.joint.lens_choice import LensChoices, choose_lenses, starting_lenses
from quadrig.rig.joint.principal_point import PRINCIPAL_SIGMA
from quadrig.rig.problem.build import Problem, components
from quadrig.rig.problem.observations import Observations
from quadrig.rig.start.lenses_and_poses import Start
from quadrig.rig.start.pose_graph import FirstRig
from quadrig.single.arrays import Floats

# A fit that others follow is good enough once a step would lower chi-square by this little: a sigma.
_ROUGH = 1.0
# The weights of Cauchy's loss hardly change when the noise does by less than this (log).
_SAME_NOISE = 0.3
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
# A minimum that is not reached in so many steps is a valley that the Views leave open; its sigmas say so.
_MOST_STEPS = 25
# Rounds of throwing out and taking back corners: the second rarely changes anything.
_ROUNDS = 3


class Contradicted(Exception):  # noqa: N818 - an answer for the caller, not an error
    """Cameras, by name, all of whose Views the others contradict: the rest can be solved without them."""

    def __init__(self, names: list[str]) -> None:
        super().__init__(", ".join(names))
        self.names = names


@dataclass(frozen=True, eq=False)
class Joint:
    """The end of the joint adjustment.

    observations carry the final weights; judged says what was thrown out. covariance (C M, C M) over the columns of
    the adjustment and the twists of camera_from_rig. predicted: the state whose rectangle poses fit the pictures best
    with no View straying: what the rig says of them, and what residuals are told against.
    """

    adjustment: Adjustment
    observations: Observations
    freedom: Freedom
    judged: Judged
    noise: float
    covariance: Floats
    reduced: Reduced
    choices: LensChoices
    costs: tuple[float, ...]
    predicted: State


def solve_jointly(
    problem: Problem,
    begin: Start,
    first: FirstRig,
    standing: Floats,
    fixed_node: int | None = None,
    offsets: Floats | None = None,
) -> Joint:
    """Adjust everything at once. The cameras that are standing (C,) bool keep their poses, and so does fixed_node:
    one of them at least holds the rig frame. offsets (C,) s: of the clocks, where they are known to differ."""
    observations = problem.observations(first.reading)
    tables = layout(observations)
    freedom = _freedom(problem, observations, begin, standing, fixed_node)
    begun = State(begin.lens, first.camera_from_rig, first.rig_from_node, offsets=offsets)
    if offsets is not None:
        begun = _with_motion(problem, begun)
    found, noise = _robust(observations.thinned(ENOUGH_POINTS), begun, begin.noise, first, freedom, tables)
    if offsets is not None:
        found = replace(found, state=_with_motion(problem, found.state))
    judged = _judge(observations, residual_squares(observations, found.state), found.state, freedom, noise)
    if noise > _OUT_OF_STEP * begin.noise or _outvoted(problem, observations, judged, _OUTVOTED).any():
        noise = begin.noise
        found, freedom = _loosened(problem, observations, replace(found, state=begun), freedom, noise)
        judged = _judge(observations, found.linearised.squares, found.state, freedom, noise)
    costs = found.costs
    _refuse_contradicted(problem, observations, judged)
    used = observations.with_weights(judged.weights)
    choices = choose_lenses(problem, used, found.state, freedom, noise, tables)
    state = choices.state
    state = replace(state, lens=np.where(choices.free | ~_changeable(problem), state.lens, freedom.prior_mean))
    information = _priors(problem, begin, choices.principal_sigma)[1]
    freedom = replace(freedom, lens=choices.free, prior_information=information)
    for _ in range(_ROUNDS):
        found = adjust(used, state, freedom, noise, most_steps=_MOST_STEPS, tables=tables)
        state, costs, last = found.state, costs + found.costs, noise
        noise = _noise(found, used, freedom, noise)
        again = _judge(observations, found.linearised.squares, state, freedom, noise)
        if all(np.array_equal(a > 0, b > 0) for a, b in zip(again.weights, judged.weights, strict=True)):
            break
        judged = again
        _refuse_contradicted(problem, observations, judged)
        used = observations.with_weights(judged.weights)
    # The same minimum with weights of the final noise, and the covariance that belongs to them.
    adjustment = _at_noise(used, found, freedom, last, noise)
    reduced = undamped(adjustment, freedom)
    covariance = reduced_inverse(reduced)
    noise = noise_of(*left_over(adjustment, used, freedom, noise, covariance))
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
        costs,
        predicted,
    )


def _at_noise(used: Observations, found: Adjustment, freedom: Freedom, before: float, after: float) -> Adjustment:
    """The minimum for another noise: the same, but for what priors and slack hold."""
    if found.state.slack is not None:
        return adjust(used, found.state, freedom, after, tables=found.layout, most_steps=10)
    return with_noise(found, used, freedom, before, after)


def _outvoted(problem: Problem, observations: Observations, judged: Judged, share: float) -> Floats:
    """Cameras (C,) bool that lost more than a share of their Views: sound by themselves, at odds with the others.

    Only of rectangles that move: what stands still looks the same at every instant, and no clock explains it.
    """
    moving = np.array([problem.rectangles[view.rectangle].moving for view in problem.views])
    seen = np.bincount(observations.camera, moving, observations.cameras)
    lost = np.bincount(observations.camera, judged.rejected & moving, observations.cameras)
    return lost > share * seen


def _refuse_contradicted(problem: Problem, observations: Observations, judged: Judged) -> None:
    """Raises Contradicted for cameras that no View that was kept joins to the others."""
    if not judged.rejected.any():
        return
    kept = np.flatnonzero(~judged.rejected)
    loose = sorted(set(range(observations.cameras)) - set(components(problem, kept)[0]))
    if loose:
        raise Contradicted([problem.cameras[i].name for i in loose])


def _loosened(
    problem: Problem, observations: Observations, found: Adjustment, freedom: Freedom, noise: float
) -> tuple[Adjustment, Freedom]:
    """The fit with slack for the Views of moving rectangles and the offsets of the cameras' clocks, and the
    freedom with the width of the slack, learned."""
    moving = np.array([problem.rectangles[view.rectangle].moving for view in problem.views])
    if not moving.any():
        return found, freedom
    prior = SlackPrior.wide(moving, _FIRST_SLACK)
    state = found.state
    for _ in range(_SLACK_ROUNDS):
        freedom = replace(freedom, slack=prior)
        found = adjust(observations, state, freedom, noise, True, 3, found.layout, _ROUGH)
        assert found.softened is not None
        assert found.state.slack is not None
        _, by_node = chain_derivatives(observations, found.state)
        covariance = node_inverses(found.normal)[observations.node]
        variances = slack_variances(found.softened, by_node, covariance)
        last, prior = prior, learned(found.state.slack, variances, prior)
        state = _with_motion(problem, found.state)
        if np.abs(np.log(prior.precision / last.precision)).max() < _SAME_WIDTH:
            break
    freedom = replace(freedom, slack=prior)
    found = adjust(observations, state, freedom, noise, True, 6, found.layout, _ROUGH)
    return _without_need(problem, observations, found, freedom, noise)


def _with_motion(problem: Problem, state: State) -> State:
    """The state with the motion of rectangles that its poses show, where frames are close enough to show any."""
    offsets = np.zeros(len(state.lens)) if state.offsets is None else state.offsets
    moved = motion(problem, state.rig_from_rect, offsets)
    if moved is None:
        return state
    return replace(state, motion=moved, offsets=offsets)


def _without_need(
    problem: Problem, observations: Observations, found: Adjustment, freedom: Freedom, noise: float
) -> tuple[Adjustment, Freedom]:
    """The fit without slack where clocks, or single Views that are wrong, explain what the cameras disagreed on; else
    as it is."""
    firm = replace(freedom, slack=None)
    judged = _judge(observations, found.linearised.squares, found.state, freedom, noise)
    kept = observations.with_weights(judged.weights)
    tried = adjust(kept, replace(found.state, slack=None), firm, noise, True, 12, found.layout, _ROUGH)
    quiet = robust_noise(kept, tried.linearised.squares) < _EXPLAINED * noise
    outvoted = _outvoted(problem, observations, judge(observations, tried.linearised.squares, noise), _MAJORITY)
    return (tried, firm) if quiet and not outvoted.any() else (found, freedom)


def _without_slack(used: Observations, state: State, freedom: Freedom, noise: float) -> State:
    """The cameras and clocks as they are, rectangle poses by least squares of the residuals alone."""
    if state.slack is None:
        return state
    still = np.zeros(used.cameras, bool)
    fixed = replace(freedom, lens=np.zeros_like(freedom.lens), pose=still, slack=None)
    return _with_still_clocks(used, replace(state, slack=None), fixed, noise)


def _with_still_clocks(used: Observations, state: State, freedom: Freedom, noise: float) -> State:
    if state.motion is None:
        return adjust(used, state, freedom, noise).state
    still = replace(state.motion, free=np.zeros(used.cameras, bool))
    return replace(adjust(used, replace(state, motion=still), freedom, noise).state, motion=state.motion)


def _judge(
    observations: Observations, squares: tuple[Floats, ...], state: State, freedom: Freedom, noise: float
) -> Judged:
    """Corners by their residual, and Views of moving rectangles by how far they stray."""
    judged = judge(observations, squares, noise)
    if state.slack is None or freedom.slack is None:
        return judged
    stray = strays(state.slack, freedom.slack)
    weights = [
        np.where(stray[g.view][:, None], 0.0, w) for g, w in zip(observations.groups, judged.weights, strict=True)
    ]
    return Judged(tuple(weights), judged.rejected | stray)


def _changeable(problem: Problem) -> Floats:
    """(C, 1) bool: cameras whose lens is estimated; a lens that is kept keeps all its numbers."""
    return np.array([[not c.fixed] for c in problem.cameras])


def _priors(problem: Problem, begin: Start, principal_sigma: float) -> tuple[Floats, Floats]:
    """Prior mean and information (C, 9); a focal is known to its own size, which counts where no View tells it."""
    mean, information = prior(problem, principal_sigma)
    mean[:, 0], information[:, 0] = begin.lens[:, 0], 1 / begin.lens[:, 0] ** 2
    return mean, information


def _freedom(
    problem: Problem,
    observations: Observations,
    begin: Start,
    standing: Floats,
    fixed_node: int | None,
) -> Freedom:
    mean, information = _priors(problem, begin, PRINCIPAL_SIGMA)
    node = np.ones(observations.nodes, bool)
    if fixed_node is not None:
        node[fixed_node] = False
    return Freedom(starting_lenses(problem), ~standing, node, mean, information)


def _robust(
    observations: Observations, state: State, noise: float, first: FirstRig, freedom: Freedom, tables: Layout
) -> tuple[Adjustment, float]:
    """Cauchy's loss from the first rig on, Views that fit nothing left out until the rig can judge them."""
    weights = [np.where(first.agrees[g.view][:, None], g.weights, 0.0) for g in observations.groups]
    trusted = observations.with_weights(weights)
    unknowns = 6 * float(_seen(trusted).sum() + freedom.pose.sum()) + float(freedom.lens.sum())
    while True:
        found = adjust(trusted, state, freedom, noise, robust=True, most_steps=12, tables=tables, tolerance=ROUGH)
        seen = max(robust_noise(trusted, found.linearised.squares, unknowns), LEAST_NOISE)
        if abs(np.log(seen / noise)) < _SAME_NOISE:
            break
        state, noise = found.state, seen
    if not first.agrees.all():
        # Views where a lens was not known yet disagree as wrong ones do, but bring it round once the rig stands.
        found = adjust(observations, found.state, freedom, seen, True, 12, tables, ROUGH)
    return found, seen


def _noise(adjustment: Adjustment, used: Observations, freedom: Freedom, noise: float) -> float:
    covariance = reduced_inverse(undamped(adjustment, freedom))
    return noise_of(*left_over(adjustment, used, freedom, noise, covariance))


def _seen(used: Observations) -> Floats:
    """Which rectangle poses (N,) a View that carries weight shows."""
    seen = np.zeros(used.nodes, bool)
    for group in used.groups:
        seen[group.node[(group.weights > 0).any(axis=1)]] = True
    return seen


def left_over(
    adjustment: Adjustment, used: Observations, freedom: Freedom, noise: float, covariance: Floats
) -> tuple[float, float]:
    """Sum of the weighted squared residuals (px^2) of a fit made with that noise, and its degrees of freedom, where
    parameters that a prior holds count for less than one. covariance (C M, C M): of the cameras, for that noise."""
    chi_square = adjustment.linearised.cost * noise**2
    unknowns = 6 * int((_seen(used) & freedom.node).sum()) + 6 * int(freedom.pose.sum())
    cameras = len(adjustment.state.lens)
    variance = np.diagonal(covariance).reshape(cameras, -1)[:, : len(adjustment.columns)]
    held = (freedom.prior_information * freedom.lens)[:, adjustment.columns] * variance
    unknowns += float(freedom.lens.sum() - held.sum())
    if adjustment.softened is not None and freedom.slack is not None:
        loose = freedom.slack.loose
        held = freedom.slack.information[loose] * np.einsum("vii->vi", adjustment.softened.inverse)[loose]
        unknowns += float((1 - held).sum())
    return chi_square, 2 * used.count - unknowns
