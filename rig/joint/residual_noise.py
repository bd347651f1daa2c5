"""What a fit leaves over and how many degrees of freedom that has: the noise follows from both."""

import numpy as np

from quadrig.rig.adjustment.levenberg_marquardt import Adjustment, FreeParameters
from quadrig.rig.problem.observations import Observations
from quadrig.single.arrays import Floats, Mask


def shown_nodes(used: Observations) -> Mask:
    """Which poses of bodies (N,) a View that carries weight shows."""
    shown = np.zeros(used.nodes, bool)
    for group in used.groups:
        shown[group.node[(group.weights > 0).any(axis=1)]] = True
    return shown


def residual_sum(
    adjustment: Adjustment,
    used: Observations,
    free: FreeParameters,
    noise: float,
    covariance: Floats,
    held_errors: float,
) -> tuple[float, float]:
    """Sum of the weighted squared residuals (px^2) of a fit made with that noise, and its degrees of freedom, where
    parameters that a prior holds count for less than one. covariance (C, 9, 9): of the lenses, for that noise;
    held_errors: how many unknowns the systematic errors count for."""
    chi_square = adjustment.linearised.cost * noise**2
    unknowns = 6.0 * int((shown_nodes(used) & free.node).sum()) + 6 * int(free.pose.sum()) + held_errors
    if free.is_layout_free:
        # Poses on bodies that nothing is known of; what is given counts as known.
        unknowns += 6.0 * int((free.layouts.information.max(axis=1, initial=0.0) < 1).sum())
    unknowns += float(free.lens.sum() - (free.information * covariance).sum())
    if adjustment.eliminated is not None and free.slack is not None:
        loose = free.slack.loose
        held = free.slack.information[loose] * np.einsum("vii->vi", adjustment.eliminated.inverse)[loose]
        unknowns += float((1 - held).sum())
    return chi_square, 2 * used.count - unknowns
