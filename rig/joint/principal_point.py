"""Where principal points are: strayed as those of real lenses do, or at the middle, as rendered ones are.

A Bayes factor between the two for the rig as a whole. Real principal points stray by tens of pixels, so that all of
them within a pixel or so of the middle is a coincidence that only the second explains.
"""

import numpy as np

from quadrig.single.arrays import Floats

# Principal points of lenses people use lie this far from the middle (root mean square), as a share of the larger
# side: measured on webcams (1.7 %), machine-vision cameras (3 %) and GoPros (0.5 %).
PRINCIPAL_SIGMA = 0.02
# The same for rendered cameras: a fraction of a pixel.
_EXACT_SIGMA = 0.0002
# Principal points stray as usual unless the other explains the data this much better (log odds; e^3 is 20 to 1).
_CONVINCING = 3.0


def learned_sigma(offset: Floats, covariance: Floats, size: Floats) -> float:
    """Width of the prior of principal points, as a share of the image's larger side: the usual, or next to nothing.

    offset (M,) px from the middles, covariance (M, M): the posterior under the usual width; size (M,) px: the larger
    side of the image of each coordinate.
    """
    scaled, information = offset / size, np.linalg.inv(covariance / np.outer(size, size))
    # What the data alone says: information minus the prior's, about a point from which the prior pulled.
    pull = information @ scaled
    data = information - np.eye(len(offset)) / PRINCIPAL_SIGMA**2
    gain = _evidence(data, pull, _EXACT_SIGMA) - _evidence(data, pull, PRINCIPAL_SIGMA)
    return _EXACT_SIGMA if gain > _CONVINCING else PRINCIPAL_SIGMA


def _evidence(data: Floats, pull: Floats, sigma: float) -> float:
    """Log probability of the data, but for a constant, under a prior of that width."""
    posterior = data + np.eye(len(data)) / sigma**2
    sign, log_determinant = np.linalg.slogdet(posterior)
    if sign <= 0:
        return -np.inf
    return float(0.5 * pull @ np.linalg.solve(posterior, pull) - 0.5 * log_determinant - len(data) * np.log(sigma))
