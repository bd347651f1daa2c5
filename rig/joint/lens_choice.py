"""Which lens each camera needs: the one of highest evidence, an information criterion with the priors put in.

One linearisation with every lens parameter free gives the posterior of all of them. The Bayes factor of a lens that
keeps some of them neutral is the ratio of posterior and prior density at the neutral values (Savage and Dickey;
Verdinelli and Wasserman 1995): a misfit costs, and so does a parameter that is barely better known than before. No
further fit is needed to compare the lenses.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from quadrig.rig.adjustment.levenberg_marquardt import FreeParameters, adjust, followed, undamped
from quadrig.rig.adjustment.normal_equations import Layout, State
from quadrig.rig.adjustment.schur import reduced_inverse, solve_cameras
from quadrig.rig.joint.principal_point import PRINCIPAL_SIGMA, learned_sigma
from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.camera_input import LensChoice
from quadrig.rig.problem.observations import Observations
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.lens import LENS_PARAMETERS

_NEUTRAL = np.array([0, 0, 0, 0, 0, 0, 0, 0, 1.0])

# Real lenses bend, and k1 and k2 belong together: k1 alone, fitted, passes k2's share on to focal and pose (bench
# data: 2.2 mm and 0.09 degrees against 1.8 mm and 0.07). Dropping a small k1 for want of evidence biases by up to
# three of the sigmas that are then reported, so a camera is without distortion only where the whole rig is.
_PINHOLE_MODELS: dict[str, tuple[str, ...]] = {
    "f c k1 k2": ("focal", "cx", "cy", "k1", "k2"),
    "f c k1 k2 k3": ("focal", "cx", "cy", "k1", "k2", "k3"),
    "f c k1 k2 p1 p2": ("focal", "cx", "cy", "k1", "k2", "p1", "p2"),
    "f c k1 k2 p1 p2 k3": ("focal", "cx", "cy", "k1", "k2", "p1", "p2", "k3"),
}
# A fisheye's k3 and k4 stand in the places of p1 and p2.
_FISHEYE_MODELS: dict[str, tuple[str, ...]] = {
    "f c k1 k2": ("focal", "cx", "cy", "k1", "k2"),
    "f c k1 k2 k3": ("focal", "cx", "cy", "k1", "k2", "p1"),
    "f c k1 k2 k3 k4": ("focal", "cx", "cy", "k1", "k2", "p1", "p2"),
}

_STRAIGHT = ("focal", "cx", "cy")
_RADIAL = ("focal", "cx", "cy", "k1", "k2")

# A more complex lens must be this much more likely (log odds; e^3 is 20 to 1) than the simpler one.
_CONVINCING = 3.0

_OVERRIDES: dict[LensChoice, tuple[str, ...]] = {
    "f": ("focal",),
    "f k1": ("focal", "k1"),
    "f k1 k2": ("focal", "k1", "k2"),
    "f c k1 k2": ("focal", "cx", "cy", "k1", "k2"),
    "full": LENS_PARAMETERS,
    "fisheye": ("focal", "cx", "cy", "k1", "k2", "p1", "p2"),
}


@dataclass(frozen=True, eq=False)
class LensChoices:
    """free (C, 9) bool, and a sentence for each camera that says why.

    principal_sigma: width of the prior of principal points, as a share of the image's larger side. state: with the
    parameters that are not free at their prior mean, and all others where Newton's step takes them then.
    """

    free: Mask
    reasons: tuple[str, ...]
    principal_sigma: float
    state: State


def _mask(names: tuple[str, ...]) -> Mask:
    return np.array([name in names for name in LENS_PARAMETERS])


def starting_lenses(problem: Problem) -> Mask:
    """The parameters (C, 9) bool that the first joint adjustment frees: what was asked for, or focal, principal
    point and two radial terms."""
    free = np.zeros((len(problem.cameras), 9), bool)
    for row, camera in enumerate(problem.cameras):
        if not camera.fixed:
            free[row] = _mask(_OVERRIDES.get(camera.lens, _RADIAL))
    return free


def choose_lenses(
    problem: Problem,
    observations: Observations,
    state: State,
    first: FreeParameters,
    noise: float,
    tables: Layout,
) -> LensChoices:
    """The lens of every camera, from one linearisation at the state of a first joint adjustment."""
    free = first.lens.copy()
    reasons = ["given and kept fixed" if c.fixed else f"asked for: {c.lens}" for c in problem.cameras]
    automatic = [row for row, c in enumerate(problem.cameras) if not c.fixed and c.lens == "auto"]
    if not automatic:
        return LensChoices(free, tuple(reasons), PRINCIPAL_SIGMA, state)
    everything = first.lens.copy()
    everything[automatic] = True
    opened = replace(first, lens=everything)
    found = adjust(observations, state, opened, noise, most_steps=0, tables=tables)
    reduced = undamped(found, opened)
    step, covariance = solve_cameras(reduced), reduced_inverse(reduced)
    size = covariance.shape[0] // len(problem.cameras)
    for row in automatic:
        block = covariance[row * size : row * size + 9, row * size : row * size + 9]
        away = state.lens[row] + step[row, :9] - _NEUTRAL
        given = problem.cameras[row].intrinsics
        fisheye = given is not None and given.model == "fisheye"
        free[row], reasons[row] = _choose(away, block, 1 / first.prior_information[row, 3:], fisheye)
    if all(free[row].sum() == len(_RADIAL) for row in automatic):
        odds = _straight_odds(state, step, covariance, first, automatic)
        if odds > _CONVINCING:
            free[automatic] = _mask(_STRAIGHT)
            for row in automatic:
                reasons[row] = f"no distortion: none in any camera is {_times(odds)} times as likely as some"
    away = state.lens + step[:, :9] - first.prior_mean
    lens_covariance = covariance.reshape(len(free), size, len(free), size)[:, :9, :, :9]
    principal_sigma = _principal_sigma(problem, away, lens_covariance, free, everything)
    held, value = np.zeros(step.shape, bool), np.zeros(step.shape)
    held[:, :9], value[:, :9] = everything & ~free, first.prior_mean - state.lens
    chosen = followed(found, observations, reduced, _held_at(step, covariance, held, value))
    return LensChoices(free, tuple(reasons), principal_sigma, chosen)


def _times(odds: float) -> str:
    return f"{np.exp(odds):.0f}" if odds < 7 else f"e^{odds:.0f}"


def _straight_odds(
    state: State, step: Floats, covariance: Floats, first: FreeParameters, automatic: list[int]
) -> float:
    """Log odds of no distortion in any of the cameras against two radial terms in each."""
    size = covariance.shape[0] // len(state.lens)
    away = state.lens + step[:, :9] - _NEUTRAL
    scores = []
    for columns in ([5, 6, 7, 8], [3, 4, 5, 6, 7, 8]):
        index = np.array([row * size + column for row in automatic for column in columns])
        variance = np.array([1 / first.prior_information[row, column] for row in automatic for column in columns])
        out = np.array([away[row, column] for row in automatic for column in columns])
        scores.append(_cost_of_neutral(out, covariance[np.ix_(index, index)], variance))
    return (scores[0] - scores[1]) / 2


def _principal_sigma(problem: Problem, away: Floats, covariance: Floats, free: Mask, opened: Mask) -> float:
    """Width of the prior of principal points under the lenses that were chosen.

    away (C, 9), covariance (C, 9, C, 9): the posterior with all of `opened` free, of which only `free` stay.
    """
    cameras = [i for i, c in enumerate(problem.cameras) if c.intrinsics is None and free[i, 1] and free[i, 2]]
    if len(cameras) < 2:
        return PRINCIPAL_SIGMA
    flat, joint = away.ravel(), covariance.reshape(away.size, away.size)
    points = np.array([9 * camera + column for camera in cameras for column in (1, 2)])
    dropped = np.flatnonzero((opened & ~free).ravel())
    offset, own = flat[points], joint[np.ix_(points, points)]
    if len(dropped):
        gain = np.linalg.solve(joint[np.ix_(dropped, dropped)], joint[np.ix_(dropped, points)]).T
        offset = offset - gain @ flat[dropped]
        own = own - gain @ joint[np.ix_(dropped, points)]
    size = np.repeat([float(max(problem.cameras[c].width, problem.cameras[c].height)) for c in cameras], 2)
    return learned_sigma(offset, own, size)


def _cost_of_neutral(away: Floats, covariance: Floats, prior_variance: Floats) -> float:
    """Minus twice the log Bayes factor for parameters at their neutral values (Savage and Dickey)."""
    return float(_costs_of_neutral(away, covariance, prior_variance, np.ones((1, len(away)), bool))[0])


def _costs_of_neutral(away: Floats, covariance: Floats, prior_variance: Floats, out: Mask) -> Floats:
    """The same (M,) for those parameters (M, K) bool alone that a model does without."""
    both = out[:, :, None] & out[:, None, :]
    # Parameters that stay are unit rows: they add nothing to determinant or distance.
    own = np.where(both, covariance, np.eye(len(away)))
    distance = np.where(out, away, 0.0)
    _, log_determinant = np.linalg.slogdet(own)
    squares = (distance * np.linalg.solve(own, distance[..., None])[..., 0]).sum(axis=1)
    return squares + log_determinant - np.where(out, np.log(prior_variance), 0.0).sum(axis=1)


def _held_at(step: Floats, covariance: Floats, held: Mask, value: Floats) -> Floats:
    """Newton's step (C, M) with some elements `held` (C, M) bool at a value (C, M): the others, given these."""
    index, step = np.flatnonzero(held), step.copy()
    if len(index):
        short = value[held] - step[held]
        share = np.linalg.solve(covariance[np.ix_(index, index)], short)
        step += (covariance[:, index] @ share).reshape(step.shape)
    return step


def _steps(masks: Mask) -> Ints:
    """How many times a lens (M, 9) was made more complex: radial pair, tangential pair, a further term, aspect."""
    return masks[:, [LENS_PARAMETERS.index(name) for name in ("k1", "p1", "k3", "aspect")]].sum(axis=1)


def _choose(away: Floats, covariance: Floats, prior_variance: Floats, fisheye: bool) -> tuple[Mask, str]:
    """The model of highest evidence, and why. away (9,): from neutral; prior_variance (6,): of k1 to aspect."""
    names, masks = _models(fisheye)
    costs = _costs_of_neutral(away[3:], covariance[3:, 3:], prior_variance, ~masks[:, 3:])
    costs = costs + 2 * _CONVINCING * _steps(masks)
    best = min(range(len(names)), key=lambda index: (costs[index], len(names[index])))
    if best == 0:
        return masks[0], f"{names[0]}: no further term raises the evidence"
    return masks[best], f"{names[best]}: log evidence {(costs[0] - costs[best]) / 2:.0f} above two radial terms"


@cache
def _models(fisheye: bool) -> tuple[tuple[str, ...], Mask]:
    """Names and parameters (M, 9) bool of the lenses to choose from, the simplest first."""
    models = _FISHEYE_MODELS if fisheye else _PINHOLE_MODELS
    names = [(label, ()) for label in models] + [(label, ("aspect",)) for label in models]
    masks = np.stack([_mask(models[label] + more) for label, more in names])
    return tuple(" ".join((label, *more)) for label, more in names), masks
