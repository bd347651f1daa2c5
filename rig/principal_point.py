"""Where principal points are: strayed as those of real lenses do, or at the middle, as rendered ones are.

A Bayes factor between the two for the rig as a whole. Real principal points stray by tens of pixels, so that all of
them within a pixel or so of the middle is a coincidence that only the second explains.
"""

import numpy as np

from quadrig.single.rotation import Array

from .adjust import Adjustment, Freedom, undamped
from .elimination import reduced_inverse
from .problem import Problem

# Width of the prior "at the middle", as a share of the usual one: a fraction of a pixel.
_EXACT = 0.01
# The usual width is taken unless the other explains the data this much better (log odds; e^3 is 20 to 1).
_CONVINCING = 3.0


def learned_sigma(problem: Problem, adjustment: Adjustment, freedom: Freedom, usual: float) -> float:
    """Width of the prior of principal points, as a share of the image's larger side: `usual`, or next to nothing."""
    columns = adjustment.columns
    open_cameras = np.flatnonzero(freedom.lens[:, 1] & freedom.lens[:, 2])
    given = [problem.cameras[c].intrinsics is not None for c in open_cameras]
    if len(open_cameras) < 2 or any(given):
        return usual
    size = np.array([max(problem.cameras[c].width, problem.cameras[c].height) for c in open_cameras], float)
    place = np.searchsorted(columns, [1, 2])
    index = (open_cameras[:, None] * (len(columns) + 6) + place).ravel()
    covariance = reduced_inverse(undamped(adjustment, freedom))[np.ix_(index, index)]
    scale = np.repeat(size, 2)
    offset = (adjustment.state.lens - freedom.prior_mean)[open_cameras, 1:3].ravel() / scale
    information = np.linalg.inv(covariance / np.outer(scale, scale))
    current = freedom.prior_information[open_cameras, 1:3].ravel() * scale**2
    # What the data alone says: information minus the prior's, about a point where the prior pulled to.
    pull = information @ offset
    data = information - np.diag(current)
    exact = usual * _EXACT
    return exact if _evidence(data, pull, exact) > _evidence(data, pull, usual) + _CONVINCING else usual


def _evidence(data: Array, pull: Array, sigma: float) -> float:
    """Log probability of the data, but for a constant, under a prior of that width."""
    posterior = data + np.eye(len(data)) / sigma**2
    sign, log_determinant = np.linalg.slogdet(posterior)
    if sign <= 0:
        return -np.inf
    return float(0.5 * pull @ np.linalg.solve(posterior, pull) - 0.5 * log_determinant - len(data) * np.log(sigma))
