"""What a marking looks like: patches of ink and paper in the rectangle's frame, and their picture.

The patches serve the printed sheet, where they stay exact, and the renderer, which needs pixels.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from quadrig.single.arrays import Singles
from quadrig.single.detect.dictionaries import check_tag_id, tag_dictionary
from quadrig.single.marking import CharucoMarking, ChessboardMarking, TagMarking, charuco_tag_squares, starts_with_tag
from quadrig.single.rectangle import Rectangle

INK, PAPER = 0.0, 1.0


@dataclass(frozen=True)
class Patch:
    """An upright rectangle of one tone, 0 ink to 1 paper; edges in metres in the frame of the marked rectangle."""

    left: float
    top: float
    right: float
    bottom: float
    tone: float


def quiet_zone(rectangle: Rectangle) -> float:
    """Width in metres of the empty border that the marking needs around it to be found; 0 for a blank sheet."""
    marking = rectangle.marking
    if isinstance(marking, TagMarking):
        # One cell is what detectors ask for; half a cell more survives blur and a crooked cut.
        return 1.5 * max(rectangle.width, rectangle.height) / _cells(marking.dictionary)
    if isinstance(marking, ChessboardMarking | CharucoMarking):
        return 0.5 * marking.square
    return 0.0


def marking_patches(rectangle: Rectangle, margin: float | None = None) -> list[Patch]:
    """The marking in the order in which its patches are painted, the sheet of paper first.

    margin: metres of sheet around the rectangle; the quiet zone where None.
    Raises QuadrigError where the marking names a dictionary or a tag that does not exist.
    """
    marking = rectangle.marking
    grown = quiet_zone(rectangle) if margin is None else margin
    x, y = rectangle.width / 2 + grown, rectangle.height / 2 + grown
    sheet = Patch(-x, -y, x, y, PAPER)
    if isinstance(marking, TagMarking):
        check_tag_id(marking.dictionary, marking.id, f"rectangle {rectangle.name!r}")
        return [sheet, *_tag_patches(marking.dictionary, marking.id, 0, 0, rectangle.width, rectangle.height)]
    if isinstance(marking, ChessboardMarking):
        return [sheet, *_square_patches(marking, first_ink=0)]
    if isinstance(marking, CharucoMarking):
        return _charuco_patches(rectangle.name, marking, sheet)
    return [sheet]


def _charuco_patches(name: str, marking: CharucoMarking, sheet: Patch) -> list[Patch]:
    squares = charuco_tag_squares(marking)
    first = marking.first_id
    check_tag_id(marking.dictionary, first, f"rectangle {name!r}")
    check_tag_id(marking.dictionary, first + len(squares) - 1, f"rectangle {name!r}")
    patches = [sheet, *_square_patches(marking, first_ink=int(starts_with_tag(marking)))]
    for offset, (column, row) in enumerate(squares):
        x = (column + 0.5 - marking.columns / 2) * marking.square
        y = (row + 0.5 - marking.rows / 2) * marking.square
        patches += _tag_patches(marking.dictionary, first + offset, x, y, marking.marker, marking.marker)
    if not marking.inverted:
        return patches
    return [Patch(p.left, p.top, p.right, p.bottom, INK + PAPER - p.tone) for p in patches]


def _square_patches(marking: ChessboardMarking | CharucoMarking, first_ink: int) -> list[Patch]:
    side = marking.square
    left, top = -marking.columns / 2 * side, -marking.rows / 2 * side
    return [
        Patch(left + c * side, top + r * side, left + (c + 1) * side, top + (r + 1) * side, INK)
        for r in range(marking.rows)
        for c in range(marking.columns)
        if (c + r) % 2 == first_ink
    ]


def _cells(dictionary: str) -> int:
    return tag_dictionary(dictionary).markerSize + 2


def _tag_patches(dictionary: str, tag_id: int, x: float, y: float, width: float, height: float) -> list[Patch]:
    """Runs of white cells on one black square with its middle at (x, y)."""
    cells = cv2.aruco.generateImageMarker(tag_dictionary(dictionary), tag_id, _cells(dictionary)) > 127
    edges_x = (x + width * (np.arange(len(cells) + 1) / len(cells) - 0.5)).tolist()
    edges_y = (y + height * (np.arange(len(cells) + 1) / len(cells) - 0.5)).tolist()
    patches = [Patch(edges_x[0], edges_y[0], edges_x[-1], edges_y[-1], INK)]
    for row, line in enumerate(cells):
        changes = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(int)))
        for start, stop in changes.reshape(-1, 2):
            patches.append(Patch(edges_x[start], edges_y[row], edges_x[stop], edges_y[row + 1], PAPER))
    return patches


def marking_image(rectangle: Rectangle, pixels_per_metre: float, margin: float | None = None) -> Singles:
    """The sheet's picture (h, w) float32 in [0, 1], each pixel the mean tone over its area.

    The picture spans the sheet with its margin exactly, in at least pixels_per_metre along both of its sides.
    Raises QuadrigError as marking_patches does.
    """
    patches = marking_patches(rectangle, margin)
    sheet = patches[0]
    size_x, size_y = sheet.right - sheet.left, sheet.bottom - sheet.top
    width = max(1, int(np.ceil(size_x * pixels_per_metre - 1e-6)))
    height = max(1, int(np.ceil(size_y * pixels_per_metre - 1e-6)))
    image = np.full((height, width), sheet.tone, np.float32)
    for patch in patches[1:]:
        columns, cover_x = _cover(patch.left - sheet.left, patch.right - sheet.left, width / size_x, width)
        rows, cover_y = _cover(patch.top - sheet.top, patch.bottom - sheet.top, height / size_y, height)
        area = image[rows, columns]
        area += np.outer(cover_y, cover_x) * (patch.tone - area)
    return image


def _cover(start: float, stop: float, pixels_per_metre: float, size: int) -> tuple[slice, Singles]:
    """The pixels of a line of `size` that a span in metres touches, and the share of each that it covers."""
    a, b = start * pixels_per_metre, stop * pixels_per_metre
    first, last = max(0, int(np.floor(a))), min(size, int(np.ceil(b)))
    edges = np.clip(np.arange(first, last + 1, dtype=np.float32), a, b)
    return slice(first, last), np.diff(edges)
