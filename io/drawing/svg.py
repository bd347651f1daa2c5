"""Plots as SVG text: a frame with ticks, marks in data coordinates. Enough for a report, and nothing to install.

Colours of lines and text come from the page (currentColor), so that it can be dark or light.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from quadrig.io.plain_words import one_line
from quadrig.single.arrays import Floats

_RIGHT, _TOP, _BOTTOM = 12, 8, 34
# A letter's width and a line's height of the page's 10 px text.
LETTER, _LINE = 5.8, 11.0
# How far from their point the base line of words stands.
_ABOVE, _BELOW = 5, 14
# A plot lower than this shows no ticks.
_LOWEST = 120


@dataclass
class Plot:
    """A plot of a range of x and y, y upwards, or downwards where `down`.

    equal: one unit is as long along y as along x, and the height no more than that needs. labels: what stands at the
    axes. axes: which have ticks, "xy", "x" or "", and where none has there is no frame. left: room beside the y axis.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    width: int = 420
    height: int = 240
    xlabel: str = ""
    ylabel: str = ""
    down: bool = False
    equal: bool = False
    axes: str = "xy"
    left: int = 48
    parts: list[str] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    words: list[tuple[float, float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.x, self.y = _wide(self.x), _wide(self.y)
        if self.equal:
            inner = (self.width - self.left - _RIGHT, self.height - _TOP - _BOTTOM)
            unit = max((self.x[1] - self.x[0]) / inner[0], (self.y[1] - self.y[0]) / inner[1])
            needed = max((self.y[1] - self.y[0]) / unit, _LOWEST)
            self.x, self.y = _grown(self.x, unit * inner[0]), _grown(self.y, unit * needed)
            self.height = round(needed) + _TOP + _BOTTOM

    def to_picture(self, points: Floats) -> Floats:
        """Positions (..., 2) in the picture of points (..., 2) in data coordinates."""
        points = np.asarray(points, float)
        across = (points[..., 0] - self.x[0]) / (self.x[1] - self.x[0])
        up = (points[..., 1] - self.y[0]) / (self.y[1] - self.y[0])
        inner_width, inner_height = self.width - self.left - _RIGHT, self.height - _TOP - _BOTTOM
        down = up if self.down else 1 - up
        return np.stack([self.left + across * inner_width, _TOP + down * inner_height], axis=-1)

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

    def label(
        self, point: Sequence[float] | Floats, words: str, colour: str = "currentColor", anchor: str = "middle"
    ) -> None:
        """Words at the very height of a point."""
        x, y = self.to_picture(np.asarray(point, float))
        self._write(float(x), float(y) + 3.5, words, colour, anchor)

    def text(
        self, point: Sequence[float] | Floats, words: str, colour: str = "currentColor", below: bool = False
    ) -> None:
        """Words above a point, or below it, before all marks and inside the plot; higher or lower where other words
        stand already."""
        x, y = self.to_picture(np.asarray(point, float))
        half = LETTER * len(words) / 2
        middle = float(np.clip(x, half, max(self.width - half, half)))
        base = float(y) + (_BELOW if below else -_ABOVE)
        base += self._free(middle, half, base)
        self.words.append((middle, half, base))
        self._write(middle, base, words, colour, "middle")

    def _write(self, x: float, y: float, words: str, colour: str, anchor: str) -> None:
        self.names.append(
            f'<text class="name" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">'
            f"{escape(one_line(words))}</text>"
        )

    def _free(self, middle: float, half: float, base: float) -> float:
        """The least step up or down from a base line at which words so wide have room."""
        taken = [v for m, h, v in self.words if abs(middle - m) < half + h]
        highest, lowest = _TOP + _LINE, self.height - (_BOTTOM if self.axes else 0) - 3
        for size in range(self.height):
            for step in (-float(size), float(size)):
                at = base + step
                if highest <= at <= lowest and not any(abs(at - v) < _LINE for v in taken):
                    return step
        return 0.0

    def svg(self, title: str) -> str:
        """The plot; title: what it shows, for those who cannot see it."""
        inner_width, inner_height = self.width - self.left - _RIGHT, self.height - _TOP - _BOTTOM
        frame = (
            f'<rect x="{self.left}" y="{_TOP}" width="{inner_width}" height="{inner_height}" '
            'fill="none" stroke="currentColor" stroke-opacity="0.4"/>'
        )
        ticks = [tick for axis in self.axes for tick in self._ticks("xy".index(axis))]
        labels = [
            f'<text x="{self.left + inner_width / 2:.0f}" y="{self.height - 3}" text-anchor="middle">'
            f"{escape(self.xlabel)}</text>",
            f'<text x="11" y="{_TOP + inner_height / 2:.0f}" text-anchor="middle" '
            f'transform="rotate(-90 11 {_TOP + inner_height / 2:.0f})">{escape(self.ylabel)}</text>',
        ]
        body = "".join([frame if self.axes else "", *ticks, *self.parts, *self.names, *labels])
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
                marks.append(f'<path d="M{x:.1f} {self.height - _BOTTOM}v4" stroke="currentColor" opacity="0.5"/>')
                marks.append(f'<text x="{x:.1f}" y="{self.height - 19}" text-anchor="middle">{value:g}</text>')
            else:
                marks.append(f'<path d="M{self.left} {y:.1f}h-4" stroke="currentColor" opacity="0.5"/>')
                marks.append(f'<text x="{self.left - 7}" y="{y + 3.5:.1f}" text-anchor="end">{value:g}</text>')
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
