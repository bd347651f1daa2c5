"""One sentence as a picture, in letters that are read across a room; a viewer's own text is for the desk."""

import itertools
import textwrap

import cv2
import numpy as np

from quadrig.io.drawing.palette import Colour
from quadrig.single.arrays import Picture

WIDTH, HEIGHT = 1800, 180
_GROUND, _FAINT = (13, 13, 13), (150, 150, 150)
# Heights (px) of the letters, the largest at which the sentence fits in one line, or in two; and of the note.
_ONE_LINE, _TWO_LINES, _SMALLEST, _NOTE = 84, 54, 30, 30
_WEIGHT = 500
_MARGIN = 20


def banner(sentence: str, note: str, colour: Colour) -> bytes:
    """A PNG of the sentence in colour (red, green, blue) over the fainter note, WIDTH x HEIGHT."""
    image = np.full((HEIGHT, WIDTH, 3), _GROUND, np.uint8)
    lines, size = _fitted(sentence)
    # The lines stand in the middle of what the note leaves.
    top = (HEIGHT - _MARGIN - (_NOTE if note else 0) - round(1.15 * size * len(lines))) // 2
    for row, line in enumerate(lines, start=1):
        _write(image, line, top + round(1.15 * size * row - 0.15 * size), size, colour)
    _write(image, note, HEIGHT - _MARGIN, _NOTE, _FAINT)
    return cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1].tobytes()


def _fitted(sentence: str) -> tuple[list[str], int]:
    """One line where its letters are not smaller than those of two."""
    if _ONE_LINE * _room(sentence) >= _TWO_LINES:
        return [sentence], min(_ONE_LINE, int(_ONE_LINE * _room(sentence)))
    wrapped = (textwrap.wrap(sentence, len(sentence) // 2 + more) for more in itertools.count(2))
    half = next(lines for lines in wrapped if len(lines) <= 2)
    return half, max(_SMALLEST, min(_TWO_LINES, int(_ONE_LINE * min(_room(line) for line in half))))


def _room(line: str) -> float:
    """The picture's width over that of the line at _ONE_LINE."""
    return (WIDTH - 2 * _MARGIN) / max(_width(line, _ONE_LINE), 1)


def _width(line: str, size: int) -> int:
    return cv2.getTextSize((WIDTH, HEIGHT), line, (0, 0), _font(), size, _WEIGHT)[2]


def _write(image: Picture, line: str, baseline: int, size: int, colour: Colour) -> None:
    left = (WIDTH - _width(line, size)) // 2
    cv2.putText(image, line, (left, baseline), colour, _font(), size, _WEIGHT)


def _font() -> cv2.FontFace:
    return cv2.FontFace("sans")
