"""Figures in words, as people write and read them."""

import re

import numpy as np

from quadrig.single.errors import QuadrigError

WRONG_SIZE = "the size that was given"
"""How every sentence on a wrong size begins its complaint."""

_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "in": 0.0254}


def length(metres: float) -> str:
    """ "0.83 mm", "12.3 mm", "0.30 m": two to three digits that matter; "unknown" where it is."""
    if not np.isfinite(metres):
        return "unknown"
    if abs(metres) < 1e-3:
        return f"{1e3 * metres:.2g} mm"
    return f"{1e3 * metres:.1f} mm" if abs(metres) < 0.1 else f"{metres:.2f} m"


def read_length(text: str, unit: str = "m") -> float:
    """Metres of "80mm", "8 cm", "0.08 m", "3in"; unit: that of a bare number.

    Raises QuadrigError where it is no length above zero.
    """
    match = re.fullmatch(r"\s*(\d+\.?\d*(?:e-?\d+)?|\.\d+)\s*([a-zµ]*)\s*", text.lower())
    if match is None or (match[2] or unit) not in _METRES or not float(match[1]) > 0:
        raise QuadrigError(f"{text!r} is no length above zero; give one such as 1mm, 80mm or 3in")
    return float(match[1]) * _METRES[match[2] or unit]


def figure(value: float, decimals: int) -> str:
    """ "0.41"; "unknown" where it is."""
    return f"{value:.{decimals}f}" if np.isfinite(value) else "unknown"


def with_sigma(value: float, sigma: float) -> str:
    """ "535.92 \u00b1 0.41": as many decimals as the sigma's second digit needs; "\u00b1 0" where it is given, and
    "\u00b1 unknown" where it is."""
    if not np.isfinite(sigma):
        return f"{value:.2f} \u00b1 unknown"
    if not sigma > 0:
        return f"{value:.2f} \u00b1 0"
    decimals = int(np.clip(1 - np.floor(np.log10(sigma)), 0, 6))
    return f"{value:.{decimals}f} \u00b1 {sigma:.{decimals}f}"


def counted(number: int, word: str) -> str:
    """ "1 View", "2 Views"."""
    return f"{number} {word}" if number == 1 else f"{number} {word}s"
