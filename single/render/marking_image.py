"""The picture of a marking: its patches of ink and paper as pixels."""

import numpy as np

from quadrig.single.arrays import Singles
from quadrig.single.patch import PAPER, Patch
from quadrig.single.rectangle import Rectangle


def marking_patches(rectangle: Rectangle, margin: float | None = None) -> list[Patch]:
    """The marking in the order in which its patches are painted, the sheet of paper first.

    margin: metres of sheet around the rectangle; the marking's quiet zone where None.
    """
    grown = rectangle.marking.quiet_zone(rectangle) if margin is None else margin
    x, y = rectangle.width / 2 + grown, rectangle.height / 2 + grown
    return rectangle.marking.patches(rectangle, Patch(-x, -y, x, y, PAPER))


def marking_image(rectangle: Rectangle, pixels_per_metre: float, margin: float | None = None) -> Singles:
    """The sheet's picture (h, w) float32 in [0, 1], each pixel the mean tone over its area.

    The picture spans the sheet with its margin exactly, in at least pixels_per_metre along both of its sides.
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
        cover = np.outer(cover_y, cover_x)
        if patch.round:
            # Pixels that the outline crosses are covered as by a straight edge.
            radii = (patch.right - patch.left) / 2 * width / size_x, (patch.bottom - patch.top) / 2 * height / size_y
            x = np.arange(columns.start, columns.stop) + 0.5 - (patch.left - sheet.left) * width / size_x - radii[0]
            y = np.arange(rows.start, rows.stop) + 0.5 - (patch.top - sheet.top) * height / size_y - radii[1]
            distance = np.hypot(x / radii[0], (y / radii[1])[:, None])
            cover = np.clip((1 - distance) * min(radii) + 0.5, 0, 1).astype(np.float32)
        area += cover * (patch.tone - area)
    return image


def _cover(start: float, stop: float, pixels_per_metre: float, size: int) -> tuple[slice, Singles]:
    """The pixels of a line of `size` that a span in metres touches, and the share of each that it covers."""
    a, b = start * pixels_per_metre, stop * pixels_per_metre
    first, last = max(0, int(np.floor(a))), min(size, int(np.ceil(b)))
    edges = np.clip(np.arange(first, last + 1, dtype=np.float32), a, b)
    return slice(first, last), np.diff(edges)
