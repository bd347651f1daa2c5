"""Figures in words, as people write and read them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.single.errors import QuadrigError

WRONG_SIZE = "the size that was given"
"""How every sentence on a wrong size begins its complaint."""

ONE_SIGMA = "± is one sigma: of a position in one direction, of a rotation about one axis."
"""Stands once beside every result, and holds for each figure of it."""

_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "in": 0.0254, "ft": 0.3048}
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*([a-zµ]*)\s*")


@dataclass(frozen=True)
class Column:
    """A column of a table: what it is called, the unit of its figures, a cell for each row; words: read from the
    left, as names are."""

    name: str
    unit: str
    cells: tuple[str, ...]
    words: bool = False

    @property
    def heading(self) -> str:
        """Name and unit in one line."""
        return f"{self.name} {self.unit}".rstrip()


def length(metres: float) -> str:
    """ "0.83 mm", "12.3 mm", "0.30 m": two to three digits that matter; "unknown" where it is."""
    if not np.isfinite(metres):
        return "unknown"
    if abs(metres) < 1e-3:
        return f"{1e3 * metres:#.2g} mm"
    return f"{1e3 * metres:.1f} mm" if abs(metres) < 0.1 else f"{metres:.2f} m"


def read_length(text: str, bare_below: float = 1.0) -> float:
    """Metres of "80mm", "8 cm", "0.08 m", "3in", "0.08".

    A bare number is metres where it is below `bare_below`: so few millimetres nobody means. Others may be a
    thousandfold wrong. Raises QuadrigError where it is one of those, or no length above zero.
    """
    metres = read_coordinate(text, bare_below)
    if not metres > 0:
        raise QuadrigError(f"{text!r} is no length above zero; give one such as 1mm, 80mm or 3in")
    return metres


def read_coordinate(text: str, bare_below: float = 1.0) -> float:
    """Metres of a length that may be zero or below, by the rules of read_length."""
    match = _QUANTITY.fullmatch(text.lower())
    if match is None or (match[2] and match[2] not in _METRES):
        raise QuadrigError(f"{text!r} is no length; give one such as 80mm, 8cm, 0.08m or 3in")
    number = float(match[1])
    if not match[2] and not abs(number) < bare_below:
        raise QuadrigError(f"{text!r} has no unit: give {match[1]}mm or {match[1]}m, whichever is meant")
    # To the picometre: 3in is 0.0762.
    return round(number * _METRES[match[2] or "m"], 12)


def read_time(text: str) -> float:
    """Seconds of "20us", "0.02 ms", "2e-5 s". Raises QuadrigError where it is no time, or has no unit."""
    match = _QUANTITY.fullmatch(text.lower())
    if match is None or match[2] not in _SECONDS:
        raise QuadrigError(f"{text!r} is no time with its unit; give one such as 20us, 33ms or 2e-5s")
    # To the femtosecond, as lengths.
    return round(float(match[1]) * _SECONDS[match[2]], 15)


def pixels(value: float) -> str:
    """ "0.412 px"; "not known" where it is not."""
    return f"{value:.3f} px" if np.isfinite(value) else "not known"


def with_sigma(value: float, sigma: float, signed: bool = False) -> str:
    """ "535.92 \u00b1 0.41": as many decimals as the sigma's second digit needs; "\u00b1 0" where it is given, and
    "\u00b1 unknown" where it is. signed: with "+" where it is above zero."""
    sign = "+" if signed else ""
    if not np.isfinite(sigma):
        return f"{value:{sign}.2f} \u00b1 unknown"
    if not sigma > 0:
        return f"{value:{sign}.2f} \u00b1 0"
    decimals = _sigma_decimals(sigma)
    return f"{value:{sign}.{decimals}f} \u00b1 {sigma:.{decimals}f}"


def sigma_figure(sigma: float) -> str:
    """ "0.41", "12", "0.0031": two digits that matter, and no less than whole numbers; "unknown" where it is."""
    return f"{sigma:.{_sigma_decimals(sigma)}f}" if np.isfinite(sigma) else "unknown"


def _sigma_decimals(sigma: float) -> int:
    # Of what is rounded to two digits: 0.0996 is 0.10.
    return int(np.clip(1 - np.floor(np.log10(float(f"{sigma:.1e}"))), 0, 6)) if sigma > 0 else 0


def counted(number: int, word: str) -> str:
    """ "1 View", "2 Views"."""
    return f"{number} {word}" if number == 1 else f"{number} {word}s"


def listed(parts: Sequence[str]) -> str:
    """ "a", "a and b", "a, b and c"."""
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)
