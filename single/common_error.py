"""Errors that all points of a View share: their covariance beside each point's own is one direction, taken out of it.

With residuals in units of their own sigma, and u the shared error in the same units, the covariance is I + u u^T. Its
inverse square root is I - a v v^T with v = u / |u| and a = 1 - 1 / sqrt(1 + u^2).
"""

from collections.abc import Sequence

import numpy as np

from quadrig.single.arrays import Floats


def stacked_common(commons: Sequence[Floats | None], sigma: Floats, most: int) -> Floats:
    """Shared errors (V, most, 2) in units of each View's own sigma (V): zero for a View without, and as padding."""
    stacked = np.zeros((len(commons), most, 2))
    for row, common, own in zip(stacked, commons, sigma, strict=True):
        if common is not None:
            row[: len(common)] = common / own
    return stacked


def whitened(rows: Floats, common: Floats) -> Floats:
    """Rows (V, P, 2) or (V, P, 2, K) over their own sigma, so that all together have unit covariance."""
    flat = common.reshape(len(common), -1)
    square = np.sum(flat**2, axis=1)
    # Written so that it is smooth to zero: a / u^2 = 1 / (r (r + 1)) with r^2 = 1 + u^2.
    root = np.sqrt(1 + square)
    columns = rows.reshape(*flat.shape, -1)
    along = (flat[:, None] @ columns) / (root * (root + 1))[:, None, None]
    return (columns - flat[..., None] * along).reshape(rows.shape)
