"""What a printed sheet is beside the rectangle it was meant to be: a little too large, longer one way, and not flat.

A sheet's points move by a sum of seven shapes, each with a prior of real prints. No picture shows the scale that all
sheets have in common: it stays in the doubt of every length.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.rectangle import Rectangle

SHAPE_PARAMETERS = ("scale", "stretch", "bend_x", "twist", "bend_y", "curl_x", "curl_y")
"""Share by which a sheet is too large, and by which it is longer along x and shorter along y; then how far its rim
stands off its plane, as a share of its longer side (of a metre at most): u^2, 2uv, v^2, u^4 and v^4, with u and v 1
at the ends of that side."""

AXES_OF_SHAPES = ((0, 1), (0, 1), (2,), (2,), (2,), (2,), (2,))
"""Along which axes of the rectangle each of these moves points: in its plane or out of it."""

STRETCH_SIGMA = 0.00075
"""Office printers keep each direction to about a tenth of a per cent, of which the ratio is half."""
# Half a millimetre over the length of an A4 sheet: paper on cardboard, or a panel. Its rim alone curls by about half
# of it. All are the same for a sheet turned by half a turn: which end of a chessboard is which, no picture shows.
_BEND_SIGMA, _CURL_SIGMA = 0.0017, 0.0008
# Larger than this (m) it is no sheet but a wall or a floor, which stand off no further.
_LARGEST_SHEET = 1.0
# Sheets of a rig mostly come from one printer: so much of the variance of their scales is common.
_COMMON_SCALE = 0.5
# Points over a sheet that say how far it stands off its plane.
_GRID = 9


def shape_basis(rectangle: Rectangle, points: Floats) -> Floats:
    """By how much points (..., 3) m of a sheet move for one unit of each shape: (..., 7, 3) m, rectangle's frame."""
    half = max(rectangle.width, rectangle.height) / 2
    u, v = points[..., 0] / half, points[..., 1] / half
    basis = np.zeros((*points.shape[:-1], len(SHAPE_PARAMETERS), 3))
    basis[..., 0, :2] = points[..., :2]
    basis[..., 1, :2] = points[..., :2] * [1.0, -1.0]
    basis[..., 2:, 2] = min(2 * half, _LARGEST_SHEET) * np.stack([u * u, 2 * u * v, v * v, u**4, v**4], axis=-1)
    return basis


def shape_information(rectangles: Sequence[Rectangle]) -> tuple[Floats, Floats]:
    """The information of the shapes of sheets before any picture, sheet by sheet: diag(own) - common common^T, own
    and common (7 R,)."""
    covariance = np.tile([0.0, STRETCH_SIGMA, *[_BEND_SIGMA] * 3, *[_CURL_SIGMA] * 2], len(rectangles)) ** 2
    scale, rest = np.array([rectangle.scale_sigma for rectangle in rectangles]), 1 - _COMMON_SCALE
    count, common = len(SHAPE_PARAMETERS), np.zeros_like(covariance)
    covariance[::count] = rest * scale**2
    # Of a diagonal and one common part (Sherman and Morrison 1950).
    common[::count] = np.sqrt(_COMMON_SCALE / (1 + _COMMON_SCALE / rest * len(scale))) / (rest * scale)
    return 1 / covariance, common


@dataclass(frozen=True, eq=False)
class SheetShape:
    """The shape of a sheet as its Views show it: values (7,) of SHAPE_PARAMETERS, with their covariance (7, 7)."""

    values: Floats
    covariance: Floats

    def off_plane(self, rectangle: Rectangle) -> tuple[float, float]:
        """How far the sheet reaches from its mean plane, highest to lowest point (m), and the sigma of that."""
        side = np.linspace(-0.5, 0.5, _GRID)
        x, y = (axis.ravel() for axis in np.meshgrid(side * rectangle.width, side * rectangle.height))
        basis = shape_basis(rectangle, np.stack([x, y, np.zeros_like(x)], axis=1))[:, :, 2]
        plane = np.stack([x, y, np.ones_like(x)], axis=1)
        basis = basis - plane @ np.linalg.lstsq(plane, basis, rcond=None)[0]
        height = basis @ self.values
        across = basis[height.argmax()] - basis[height.argmin()]
        return float(np.ptp(height)), float(np.sqrt(across @ self.covariance @ across))
