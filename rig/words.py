"""Lengths in words."""

import numpy as np


def millimetres(metres: float) -> str:
    """Two digits, in the unit a person would use."""
    value = 1000 * metres
    if not np.isfinite(value):
        return "an unknown accuracy"
    return f"{value:.2g} mm" if value < 100 else f"{value / 10:.0f} cm"


def length(metres: float) -> str:
    """A length as people read it, with two to three digits that matter."""
    if not np.isfinite(metres):
        return "unknown"
    if abs(metres) < 1e-3:
        return f"{1e3 * metres:.2g} mm"
    return f"{1e3 * metres:.1f} mm" if abs(metres) < 0.1 else f"{metres:.2f} m"
