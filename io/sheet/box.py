"""A cube of tags to fold from one sheet: its faces as rectangles of a body, and its net as a page."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quadrig.io.sheet.layout import BORDER, Paper, draw_foot, draw_patches, sheet_size, whole_mm
from quadrig.io.sheet.pdf import PdfPage, pdf_bytes
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.rotation import rotation_from_vector

# The net is a cross: column and row of each face, in the order front, right, back, left, top, bottom.
_NET = ((1, 1), (2, 1), (1, 3), (0, 1), (1, 0), (1, 2))
BOX_FACES = len(_NET)
"""How many tags a box takes."""

# Folds that lead from the front to each face: directions on the paper, x right and y down.
_LEFT, _RIGHT, _UP, _DOWN = (-1, 0), (1, 0), (0, -1), (0, 1)
_FOLDS = ((), (_RIGHT,), (_DOWN, _DOWN), (_LEFT,), (_UP,), (_DOWN,))
# Faces and the edges of theirs that bear a flap to glue: one of the two that meet at each open edge.
_FLAPS = {3: (_UP, _LEFT, _DOWN), 1: (_UP, _RIGHT, _DOWN), 4: (_UP,)}
# mm: the width of a flap, and by how much its sides lean so that neighbours do not meet.
_FLAP = 8.0
# What a cube folded of card by hand differs by from one: how well a face's pose on it is known, rad and m.
_FOLDED_SIGMA = (float(np.radians(2.0)), 1e-3)


def largest_box_tag(paper: Paper, cells: int) -> float:
    """Side in metres, whole mm, of the largest tags whose cube, with its flaps, the paper holds."""
    width, height = paper.room
    return whole_mm(min((width - 2 * _FLAP) / 3, (height - _FLAP) / 4) / (1 + 3 / cells), paper)


def on_box(rectangles: Sequence[Rectangle], name: str) -> list[Rectangle]:
    """Six rectangles of one size as the faces of a cube, with their white borders: one body, its frame in the cube's
    middle and turned as the front face, with the poses that folding gives and how well it does."""
    face = max(sheet_size(rectangles[0])) * 1e-3
    poses = [Pose(rotation, -face / 2 * rotation[:, 2] + 0.0) for rotation in map(_folded, _FOLDS)]
    return [
        replace(rectangle, body=name, body_from_rect=pose, layout_sigma=_FOLDED_SIGMA)
        for rectangle, pose in zip(rectangles, poses, strict=True)
    ]


def _folded(folds: tuple[tuple[int, int], ...]) -> Floats:
    """body_from_rect's rotation (3, 3) of a face: each fold turns a direction on the paper into the cube, z."""
    rotation = np.eye(3)
    for x, y in folds:
        rotation = rotation @ rotation_from_vector(np.pi / 2 * np.cross([x, y, 0.0], [0.0, 0.0, 1.0]))
    # Quarter turns are whole numbers, and zeros without a sign read better.
    return np.rint(rotation) + 0.0


def box_pdf(rectangles: Sequence[Rectangle], paper: Paper) -> bytes:
    """A page with the net of the cube of `on_box`, printed side out. Raises QuadrigError where it does not fit."""
    side = max(sheet_size(rectangles[0]))
    width, height = paper.room
    if 3 * side + 2 * _FLAP > width + 0.05 or 4 * side + _FLAP > height + 0.05:
        raise QuadrigError(
            f"the net of a cube of {side:.0f} mm does not fit on {paper.name}; take a smaller size or larger paper"
        )
    page = PdfPage(paper.width, paper.height)
    left, top = (paper.width - 3 * side) / 2, BORDER + _FLAP
    for index, (rectangle, (column, row)) in enumerate(zip(rectangles, _NET, strict=True)):
        x, y = left + (column + 0.5) * side, top + (row + 0.5) * side
        draw_patches(page, rectangle, x, y)
        page.text(x - side / 2 + 1, y + side / 2 - 1, rectangle.name, 1.8)
        _draw_edges(page, (x, y), side, (column, row), _FLAPS.get(index, ()))
    advice = "Cut along the lines, fold back along the dashes, glue the flaps inside; stiff card keeps its shape."
    draw_foot(page, [advice, "Its lines for rig.toml: those that rig target has printed."])
    return pdf_bytes([page], "quadrig target")


def _draw_edges(
    page: PdfPage,
    middle: tuple[float, float],
    side: float,
    place: tuple[int, int],
    flaps: tuple[tuple[int, int], ...],
) -> None:
    """The edges of a face: dashed to fold along, whole to cut along, with flaps to glue."""
    for direction in (_LEFT, _RIGHT, _UP, _DOWN):
        out, along = np.array(direction, float), np.array([-direction[1], direction[0]], float)
        start, end = (middle + side / 2 * (out + sign * along) for sign in (-1, 1))
        if direction in flaps:
            tips = start + _FLAP * (out + along), end + _FLAP * (out - along)
            for one, two in ((start, tips[0]), tips, (tips[1], end)):
                page.line(_xy(one), _xy(two))
        if direction in flaps or (place[0] + direction[0], place[1] + direction[1]) in _NET:
            _dash(page, start, end)
        else:
            page.line(_xy(start), _xy(end))


def _dash(page: PdfPage, start: Floats, end: Floats) -> None:
    """Dashes of 2 mm."""
    length = float(np.linalg.norm(end - start))
    for begin in np.arange(0.0, length, 4.0):
        near, far = (start + (end - start) * min(at / length, 1.0) for at in (begin, begin + 2.0))
        page.line(_xy(near), _xy(far))


def _xy(point: Floats) -> tuple[float, float]:
    return float(point[0]), float(point[1])
