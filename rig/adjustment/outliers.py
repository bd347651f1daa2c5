"""Which corners and Views do not belong, against the noise that the data itself shows."""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.problem.build import USUAL_NOISE
from quadrig.rig.problem.observations import Observations
from quadrig.single.arrays import Floats, Mask
from quadrig.single.posterior.noise import noise_of

# A Gaussian corner strays past 5 sigma (in two dimensions) once in 270,000: losing it costs nothing, and what
# strays further is a fault.
_FAR = 25.0
# A View of which this share of the corners is off is wrong as a whole (its id, its order, its instant).
_WHOLE_VIEW = 0.5
# Less than any detector's noise (px): keeps a View that its own few unknowns explain wholly from infinite weight.
LEAST_NOISE = 0.02


@dataclass(frozen=True, eq=False)
class Inliers:
    """weights: for each group (V, P), zero where a corner is out. rejected (views,) bool: Views out as a whole."""

    weights: tuple[Floats, ...]
    rejected: Mask

    def same_points(self, other: "Inliers") -> bool:
        """Whether the same corners carry weight."""
        return all(np.array_equal(a > 0, b > 0) for a, b in zip(self.weights, other.weights, strict=True))

    def without(self, observations: Observations, views: Mask) -> "Inliers":
        """Some Views (views,) rejected as well."""
        groups = zip(observations.groups, self.weights, strict=True)
        weights = tuple(np.where(views[group.view][:, None], 0.0, own) for group, own in groups)
        return Inliers(weights, self.rejected | views)


def find_outliers(observations: Observations, squares: tuple[Floats, ...], noise: float) -> Inliers:
    """Sort corners into those within 5 sigma and those that are not, from squared residuals (px^2)."""
    rejected = np.zeros(len(observations.camera), bool)
    weights = []
    for group, square in zip(observations.groups, squares, strict=True):
        carries = group.weights > 0
        far = carries & ~(square * group.certainty < _FAR * noise**2)
        share = far.sum(axis=1) / np.maximum(carries.sum(axis=1), 1)
        # Three corners cannot place a rectangle twice over: a View needs four that agree, or half of a board's.
        whole = share >= _WHOLE_VIEW
        rejected[group.view] = whole
        weights.append(np.where(far | whole[:, None], 0.0, group.weights))
    return Inliers(tuple(weights), rejected)


def robust_noise(observations: Observations, squares: tuple[Floats, ...], unknowns: float = 0.0) -> float:
    """Sigma (px) of a coordinate from the median squared residual, which outliers do not move.

    unknowns: how many numbers were fitted to the Views; what they took up does not show in the residuals.
    """
    values = [
        (square * group.certainty)[(group.weights > 0) & np.isfinite(square)]
        for group, square in zip(observations.groups, squares, strict=True)
    ]
    every = np.concatenate(values) if values else np.zeros(0)
    if not len(every):
        return USUAL_NOISE
    coordinates = 2 * observations.count
    # Where nearly all is taken up, the rest says little: it counts for a tenth at least.
    left = max(coordinates - unknowns, 0.1 * coordinates) / coordinates
    # The median of a squared length of two unit Gaussians is 2 ln 2.
    return float(np.sqrt(np.median(every) / (2 * np.log(2)) / left))


def first_noise(observations: Observations, squares: tuple[Floats, ...], unknowns: float, expected: float) -> float:
    """Sigma (px) of a coordinate before outliers are known: robust, and with few residuals near what is expected."""
    freedom = max(2 * observations.count - unknowns, 0.0)
    seen = robust_noise(observations, squares, unknowns)
    return max(noise_of(freedom * seen**2, freedom, expected), LEAST_NOISE)
