"""Plots as SVG text: a frame with ticks, marks in data coordinates. Enough for a report, and nothing to install.

Colours of lines and text come from the page (currentColor), so that it can be dark or light.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from quadrig.single.arrays import Floats

_LEFT, _RIGHT, _TOP, _BOTTOM = 54, 10, 8, 30
# A letter's width and a line's height of the page's 11 px text.
_LETTER, _LINE = 6.2, 11.5
# A plot lower than this shows no ticks.
_LOWEST = 120


@dataclass
class Plot:
    """A plot of a range of x and y, y upwards, or downwards where `down`.

    equal: one unit is as long along y as along x, and the height no more than that needs. labels: what stands at the
    axes.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    width: int = 420
    height: int = 240
    xlabel: str = ""
    ylabel: str = ""
    down: bool = False
    equal: bool = False
    ticks: bool = True
    parts: list[str] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    words: list[tuple[float, float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.x, self.y = _wide(self.x), _wide(self.y)
        if self.equal:
            inner = (self.width - _LEFT - _RIGHT, self.height - _TOP - _BOTTOM)
            unit = max((self.x[1] - self.x[0]) / inner[0], (self.y[1] - self.y[0]) / inner[1])
            needed = max((self.y[1] - self.y[0]) / unit, _LOWEST)
            self.x, self.y = _grown(self.x, unit * inner[0]), _grown(self.y, unit * needed)
            self.height = round(needed) + _TOP + _BOTTOM

    def to_picture(self, points: Floats) -> Floats:
        """Positions (..., 2) in the picture of points (..., 2) in data coordinates."""
        points = np.asarray(points, float)
        across = (points[..., 0] - self.x[0]) / (self.x[1] - self.x[0])
        up = (points[..., 1] - self.y[0]) / (self.y[1] - self.y[0])
        inner_width, inner_height = self.width - _LEFT - _RIGHT, self.height - _TOP - _BOTTOM
        down = up if self.down else 1 - up
        return np.stack([_LEFT + across * inner_width, _TOP + down * inner_height], axis=-1)

    def line(self, points: Floats, colour: str, width: float = 1.5, closed: bool = False, fill: str = "none") -> None:
        """A line through points (N, 2)."""
        shape = "polygon" if closed else "polyline"
        corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in self.to_picture(points))
        self.parts.append(
            f'<{shape} points="{corners}" fill="{fill}" stroke="{colour}" stroke-width="{width:.1f}" '
            'stroke-linejoin="round"/>'
        )

    def segments(self, starts: Floats, ends: Floats, colour: str, width: float = 0.8) -> None:
        """Many short lines from starts (N, 2) to ends (N, 2), as one path."""
        pairs = zip(self.to_picture(starts), self.to_picture(ends), strict=True)
        path = "".join(f"M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}" for a, b in pairs)
        self.parts.append(f'<path d="{path}" stroke="{colour}" stroke-width="{width}" fill="none"/>')

    def dots(self, points: Floats, colour: str, radius: float = 3) -> None:
        """Round marks at points (N, 2)."""
        self.parts += [
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{colour}"/>' for x, y in self.to_picture(points)
        ]

    def box(self, low: Sequence[float], high: Sequence[float], colour: str, opacity: float = 1.0) -> None:
        """A filled box between two corners."""
        (x0, y0), (x1, y1) = self.to_picture(np.array([low, high], float))
        self.parts.append(
            f'<rect x="{min(x0, x1):.1f}" y="{min(y0, y1):.1f}" width="{abs(x1 - x0):.1f}" '
            f'height="{abs(y1 - y0):.1f}" fill="{colour}" fill-opacity="{opacity:.2f}"/>'
        )

    def text(
        self, point: Sequence[float] | Floats, words: str, colour: str = "currentColor", anchor: str = "middle"
    ) -> None:
        """Words at a point, a little above it and before all marks; higher where other words stand already."""
        x, y = self.to_picture(np.asarray(point, float))
        half = _LETTER * len(words) / 2
        middle = x + {"start": half, "middle": 0.0, "end": -half}[anchor]
        while any(abs(middle - m) < half + h and abs(y - other) < _LINE for m, h, other in self.words):
            y -= 1.0
        self.words.append((float(middle), half, float(y)))
        self.names.append(
            f'<text class="name" x="{x:.1f}" y="{y - 6:.1f}" text-anchor="{anchor}" fill="{colour}">'
            f"{escape(words)}</text>"
        )

    def svg(self, title: str) -> str:
        """The plot; title: what it shows, for those who cannot see it."""
        inner_width, inner_height = self.width - _LEFT - _RIGHT, self.height - _TOP - _BOTTOM
        frame = (
            f'<rect x="{_LEFT}" y="{_TOP}" width="{inner_width}" height="{inner_height}" '
            'fill="none" stroke="currentColor" stroke-opacity="0.4"/>'
        )
        ticks = [*self._ticks(0), *self._ticks(1)] if self.ticks else []
        labels = [
            f'<text x="{_LEFT + inner_width / 2:.0f}" y="{self.height - 3}" text-anchor="middle">'
            f"{escape(self.xlabel)}</text>",
            f'<text x="11" y="{_TOP + inner_height / 2:.0f}" text-anchor="middle" '
            f'transform="rotate(-90 11 {_TOP + inner_height / 2:.0f})">{escape(self.ylabel)}</text>',
        ]
        body = "".join([frame, *ticks, *self.parts, *self.names, *labels])
        return (
            f'<svg role="img" aria-label="{escape(title)}" viewBox="0 0 {self.width} {self.height}" '
            f'width="{self.width}" height="{self.height}">{body}</svg>'
        )

    def _ticks(self, axis: int) -> list[str]:
        low, high = (self.x, self.y)[axis]
        marks = []
        for value in round_values(low, high):
            x, y = self.to_picture(np.array([value, self.y[0]] if axis == 0 else [self.x[0], value]))
            if axis == 0:
                marks.append(f'<text x="{x:.1f}" y="{self.height - 17}" text-anchor="middle">{value:g}</text>')
            else:
                marks.append(f'<text x="{_LEFT - 4}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>')
        return marks


def round_values(low: float, high: float, most: int = 6) -> list[float]:
    """Round numbers between two, at most so many, evenly apart."""
    rough = (high - low) / most
    size = 10.0 ** np.floor(np.log10(rough))
    step = size * next(digit for digit in (1, 2, 5, 10) if digit * size >= rough * (1 - 1e-9))
    first = int(np.ceil(low / step - 1e-9))
    last = int(np.floor(high / step + 1e-9))
    return [float(f"{index * step:.12g}") for index in range(first, last + 1)]


def _wide(bounds: tuple[float, float]) -> tuple[float, float]:
    low, high = float(bounds[0]), float(bounds[1])
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def _grown(bounds: tuple[float, float], size: float) -> tuple[float, float]:
    middle = (bounds[0] + bounds[1]) / 2
    return middle - size / 2, middle + size / 2
