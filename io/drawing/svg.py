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
# Where words have no room at their point: in so many directions and at these distances from it, px.
_WAYS, _AWAY = 16, (0, 8, 16, 26, 38, 52, 70, 92)
# Words this far from their point are joined to it.
_APART = 20
# Marks stand in the way of words at points this far apart, px.
_SPACING = 4.0
# ... and so many of each short line.
_OF_SEGMENT = 9
# A plot lower than this shows no ticks.
_LOWEST = 120


@dataclass(frozen=True, eq=False)
class _Words:
    """Words that want to stand at a point of the picture (2,), above or below it."""

    at: Floats
    words: str
    colour: str
    below: bool


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
    wanted: list[_Words] = field(default_factory=list)
    marks: list[Floats] = field(default_factory=list)

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
        drawn = self.to_picture(points)
        self.marks.append(_along(np.concatenate([drawn, drawn[:1]]) if closed else drawn))
        corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in drawn)
        self.parts.append(
            f'<{shape} points="{corners}" fill="{fill}" stroke="{colour}" stroke-width="{width:.1f}" '
            'stroke-linejoin="round"/>'
        )

    def segments(self, starts: Floats, ends: Floats, colour: str, width: float = 0.8) -> None:
        """Many short lines from starts (N, 2) to ends (N, 2), as one path."""
        first, last = self.to_picture(starts), self.to_picture(ends)
        self.marks += [first + share * (last - first) for share in np.linspace(0, 1, _OF_SEGMENT)]
        pairs = zip(first, last, strict=True)
        path = "".join(f"M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}" for a, b in pairs)
        self.parts.append(f'<path d="{path}" stroke="{colour}" stroke-width="{width}" fill="none"/>')

    def dots(self, points: Floats, colour: str, radius: float = 3) -> None:
        """Round marks at points (N, 2)."""
        self.marks.append(self.to_picture(points).reshape(-1, 2))
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
        """Words above a point, or below it: inside the plot, before all marks, and where neither other words nor, as
        far as there is room, marks are; joined to their point where that is far."""
        self.wanted.append(_Words(self.to_picture(np.asarray(point, float)), words, colour, below))

    def _write(self, x: float, y: float, words: str, colour: str, anchor: str) -> None:
        self.names.append(
            f'<text class="name" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">'
            f"{escape(one_line(words))}</text>"
        )

    def _place_words(self) -> None:
        marks, taken = np.concatenate([np.zeros((0, 2)), *self.marks]), np.zeros((0, 4))
        for each in self.wanted:
            half = LETTER * len(each.words) / 2
            bases = self._candidates(each, half)
            boxes = np.column_stack([bases[:, 0] - half, bases[:, 1] - _LINE, bases[:, 0] + half, bases[:, 1] + 2])
            over = (boxes[:, None, :2] < taken[:, 2:]) & (taken[:, :2] < boxes[:, None, 2:])
            hidden = (boxes[:, None, :2] < marks) & (marks < boxes[:, None, 2:])
            away = np.linalg.norm(bases - bases[0], axis=1)
            # Words over words cannot be read at all; over marks they can, and far away nobody knows whose they are.
            cost = 1e4 * over.all(-1).sum(1) + 12.0 * hidden.all(-1).sum(1) + away
            best = int(np.argmin(cost))
            base = bases[best]
            taken = np.concatenate([taken, boxes[best : best + 1]])
            if away[best] > _APART:
                end = np.clip(each.at, boxes[best, :2], boxes[best, 2:])
                self.parts.append(
                    f'<path d="M{each.at[0]:.1f} {each.at[1]:.1f}L{end[0]:.1f} {end[1]:.1f}" '
                    f'stroke="{each.colour}" stroke-width="0.6" opacity="0.7"/>'
                )
            self._write(float(base[0]), float(base[1]), each.words, each.colour, "middle")

    def _candidates(self, each: _Words, half: float) -> Floats:
        """Middles of base lines (K, 2) where words so wide may stand, inside the plot; the first is the nearest."""
        first = each.at + np.array([0, _BELOW if each.below else -_ABOVE])
        angles = np.linspace(0, 2 * np.pi, _WAYS, endpoint=False)
        # Beside their point words stand further away than above it.
        ways = np.column_stack([np.sin(angles), np.cos(angles)])
        bases = np.concatenate([first + away * ways + np.sign(ways) * [half * (away > 0), 0] for away in _AWAY])
        low = [min(half, self.width / 2), _TOP + _LINE]
        high = [max(self.width - half, self.width / 2), self.height - (_BOTTOM if self.axes else 0) - 3]
        return np.clip(bases, low, high)

    def svg(self, title: str) -> str:
        """The plot; title: what it shows, for those who cannot see it."""
        self._place_words()
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


def _along(points: Floats) -> Floats:
    """Points (M, 2) along a line through points (N, 2) of the picture, close enough for words to meet one."""
    counts = np.maximum(np.ceil(np.linalg.norm(np.diff(points, axis=0), axis=1) / _SPACING), 1).astype(int)
    ends = zip(points[:-1], points[1:], counts, strict=True)
    return np.concatenate([np.zeros((0, 2)), *(np.linspace(a, b, n, endpoint=False) for a, b, n in ends)])


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
