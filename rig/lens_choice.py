"""Which lens each camera needs: the one of highest evidence, an information criterion with the priors put in.

One linearisation with every lens parameter free gives the posterior of all of them. The Bayes factor of a lens that
keeps some of them neutral is the ratio of posterior and prior density at the neutral values (Savage and Dickey;
Verdinelli and Wasserman 1995): a misfit costs, and so does a parameter that is barely better known than before. No
further fit is needed to compare the lenses.
"""

from dataclasses import dataclass, replace

import numpy as np

from quadrig.single.lens import LENS_PARAMETERS
from quadrig.single.rotation import Array

from .adjust import Freedom, adjust, undamped
from .elimination import reduced_inverse, solve_cameras
from .inputs import LensChoice
from .normal_equations import State
from .observations import Observations
from .problem import Problem

_NEUTRAL = np.array([0, 0, 0, 0, 0, 0, 0, 0, 1.0])

# A lens that bends at the third order bends at the fifth too: k1 alone, fitted, passes k2's share on to focal and
# pose (bench data: 2.2 mm and 0.09 degrees against 1.8 mm and 0.07), so k1 and k2 come and go together.
_PINHOLE_MODELS: dict[str, tuple[str, ...]] = {
    "f c": ("focal", "cx", "cy"),
    "f c k1 k2": ("focal", "cx", "cy", "k1", "k2"),
    "f c k1 k2 k3": ("focal", "cx", "cy", "k1", "k2", "k3"),
    "f c k1 k2 p1 p2": ("focal", "cx", "cy", "k1", "k2", "p1", "p2"),
    "f c k1 k2 p1 p2 k3": ("focal", "cx", "cy", "k1", "k2", "p1", "p2", "k3"),
}
# A fisheye's k3 and k4 stand in the places of p1 and p2.
_FISHEYE_MODELS: dict[str, tuple[str, ...]] = {
    "f c": ("focal", "cx", "cy"),
    "f c k1 k2": ("focal", "cx", "cy", "k1", "k2"),
    "f c k1 k2 k3": ("focal", "cx", "cy", "k1", "k2", "p1"),
    "f c k1 k2 k3 k4": ("focal", "cx", "cy", "k1", "k2", "p1", "p2"),
}

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
    """free (C, 9) bool, and a sentence for each camera that says why."""

    free: Array
    reasons: tuple[str, ...]


def _mask(names: tuple[str, ...]) -> Array:
    return np.array([name in names for name in LENS_PARAMETERS])


def starting_lenses(problem: Problem) -> Array:
    """The parameters (C, 9) bool that the first joint adjustment frees: what was asked for, or focal, principal
    point and two radial terms."""
    free = np.zeros((len(problem.cameras), 9), bool)
    for row, camera in enumerate(problem.cameras):
        if not camera.fixed:
            free[row] = _mask(_OVERRIDES.get(camera.lens, _PINHOLE_MODELS["f c k1 k2"]))
    return free


def choose_lenses(
    problem: Problem, observations: Observations, state: State, freedom: Freedom, noise: float
) -> LensChoices:
    """The lens of every camera, from one linearisation at the state of a first joint adjustment."""
    free = freedom.lens.copy()
    reasons = ["given and kept fixed" if c.fixed else f"asked for: {c.lens}" for c in problem.cameras]
    automatic = [row for row, c in enumerate(problem.cameras) if not c.fixed and c.lens == "auto"]
    if not automatic:
        return LensChoices(free, tuple(reasons))
    everything = freedom.lens.copy()
    everything[automatic] = True
    step, covariance = _full_step(observations, state, freedom, everything, noise)
    for row in automatic:
        start = row * covariance.shape[0] // len(problem.cameras)
        block = covariance[start : start + 9, start : start + 9]
        away = state.lens[row] + step[row, :9] - _NEUTRAL
        fisheye = problem.cameras[row].intrinsics is not None and problem.cameras[row].intrinsics.model == "fisheye"
        free[row], reasons[row] = _choose(away, block, 1 / freedom.prior_information[row, 3:], fisheye)
    return LensChoices(free, tuple(reasons))


def _full_step(
    observations: Observations, state: State, freedom: Freedom, everything: Array, noise: float
) -> tuple[Array, Array]:
    """Newton's step (C, 15) with all lens parameters free, and its covariance (15 C, 15 C)."""
    opened = replace(freedom, lens=everything)
    reduced = undamped(adjust(observations, state, opened, noise, most_steps=0), opened)
    return solve_cameras(reduced), reduced_inverse(reduced)


def _steps(mask: Array) -> int:
    """How many times a lens was made more complex: radial pair, tangential pair, a further term, aspect."""
    names = dict(zip(LENS_PARAMETERS, mask, strict=True))
    return sum(int(names[name]) for name in ("k1", "p1", "k3", "aspect"))


def _choose(away: Array, covariance: Array, prior_variance: Array, fisheye: bool) -> tuple[Array, str]:
    """The model of highest evidence, and why. away (9,): from neutral; prior_variance (6,): of k1 to aspect."""
    models = _FISHEYE_MODELS if fisheye else _PINHOLE_MODELS
    prior_logs = np.concatenate([np.zeros(3), np.log(prior_variance)])
    scores: dict[str, tuple[float, Array]] = {}
    for name, names in models.items():
        for label, extra in ((name, ()), (f"{name} aspect", ("aspect",))):
            mask = _mask(names + extra)
            dropped = ~mask
            score = 0.0
            if dropped.any():
                out, block = away[dropped], covariance[np.ix_(dropped, dropped)]
                _, log_determinant = np.linalg.slogdet(block)
                score = float(out @ np.linalg.solve(block, out) + log_determinant - prior_logs[dropped].sum())
            scores[label] = (score + 2 * _CONVINCING * _steps(mask), mask)
    best = min(scores, key=lambda label: (scores[label][0], len(label)))
    odds = (scores["f c"][0] - scores[best][0]) / 2
    if best == "f c":
        return scores[best][1], "no distortion: none of its terms raises the evidence"
    return scores[best][1], f"{best}: log evidence {odds:.0f} above no distortion"
