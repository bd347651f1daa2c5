"""One rectangle, one image: focal and pose in closed form, from both constraints of the rectangle.

The production solver. The paper's own closed form, which uses one constraint of the two, is in paper_form.py.

Method. With corners p_j = (u_j, v_j, 1) from the principal point, four coplanar corners of a parallelogram have
depths proportional to the areas of the triangles that the other three span, so the directions h1, h2 of the sides
follow without any decomposition. In the complex vector m = h1 + i h2 the two constraints (sides at right angles, and
in their known ratio) are the real and imaginary parts of one equation, linear in g = 1/f^2:

    e(g) = g (m_x^2 + m_y^2) + m_w^2 = 0

(the image of the circular points lies on the image of the absolute conic; Hartley and Zisserman, 2nd edition, 8.8).
The covariance of e under equal independent noise of the eight coordinates is a polynomial too; weighting by it makes
the estimate of g efficient to first order.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .corners import Reason, check_shape, reasons_of_areas
from .errors import QuadrigError
from .pose import Pose
from .rotation import Array

# Members solved at a time: some eighty rows of this length stay in a core's second-level cache.
_BLOCK = 4096
# The estimate of g that the first weights are taken at: not less than this share of |m_w^2| / |m_x^2 + m_y^2|, which
# is g itself for exact corners and stays positive under any noise.
_LEAST_SHARE = 0.1
# A focal whose sigma exceeds this share of itself has an interval (in 1/f, 95 %) that reaches infinity.
_UNKNOWABLE = 0.5
_TINY = np.finfo(float).tiny
# Pairs of corners as slices, so that they are views: P1 P3, P2 P4, and the same in the other order.
_P13, _P24, _P31, _P42 = slice(0, None, 2), slice(1, None, 2), slice(2, None, -2), slice(3, None, -2)


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """Focal and pose of each member of a batch (...).

    focal (...) px; focal_sigma (...) px for the noise the call was given; cam_from_rect with rotation (..., 3, 3) and
    translation (..., 3) metres; reason (...) int8, a Reason. A member of bad input is nan throughout. Where the
    reason is FOCAL_UNKNOWABLE the pose holds for the focal, as far as there is one (nan where noise left none).
    """

    focal: Array
    focal_sigma: Array
    cam_from_rect: Pose
    reason: NDArray[np.int8]


def closed_form(
    corners: Array,
    width: Array | float,
    height: Array | float,
    principal_point: Array,
    focal: Array | float | None = None,
    sigma: float = 0.3,
    photographed: bool = True,
) -> ClosedForm:
    """Focal and pose of rectangles from their four corners.

    corners (..., 4, 2) pixels in the order of Eq. 4, that is bottom right, bottom left, top left, top right of
    the upright sheet; width, height (...) metres; principal_point (..., 2) pixels. focal: where it is known (...) px:
    the pose is for it. sigma: standard deviation of a pixel coordinate, px; it decides what is FOCAL_UNKNOWABLE
    (focal sigma above half the focal) and scales focal_sigma, and does not change the estimate. photographed: False
    accepts corners behind the camera too, as a formal projection puts them in the image.
    Raises QuadrigError for arrays of the wrong shape; bad members come back nan with their reason.
    """
    corners = check_shape(corners)
    batch = corners.shape[:-2]
    rows = [_row(width, batch, "width"), _row(height, batch, "height")]
    rows += [_row(np.asarray(principal_point, float)[..., axis], batch, "principal_point") for axis in (0, 1)]
    known = None if focal is None else _row(focal, batch, "focal")
    flat = corners.reshape(-1, 8)
    count = len(flat)
    out_focal, out_sigma, out_reason = np.empty(count), np.empty(count), np.empty(count, np.int8)
    rotation, translation = np.empty((count, 3, 3)), np.empty((count, 3))
    with np.errstate(all="ignore"):
        for start in range(0, count, _BLOCK):
            part = slice(start, start + _BLOCK)
            w, h, cu, cv = (row if row.size == 1 else row[part] for row in rows)
            given = known if known is None or known.size == 1 else known[part]
            block = _solve_block(np.ascontiguousarray(flat[part].T), w, h, cu, cv, given, sigma, photographed)
            out_focal[part], out_sigma[part], columns, translation.T[:, part], out_reason[part] = block
            rotation[part].transpose(2, 1, 0)[...] = columns
    pose = Pose(rotation.reshape(*batch, 3, 3), translation.reshape(*batch, 3))
    return ClosedForm(out_focal.reshape(batch), out_sigma.reshape(batch), pose, out_reason.reshape(batch))


def _row(value: Array | float, batch: tuple[int, ...], name: str) -> Array:
    """The value as one row: a single number stays one, anything else is spread over the batch."""
    value = np.asarray(value, float)
    if value.size == 1:
        return value.reshape(1)
    try:
        return np.broadcast_to(value, batch).reshape(-1)
    except ValueError:
        raise QuadrigError(f"{name} has the shape {value.shape}; it does not fit a batch of {batch} views") from None


def _solve_block(
    flat: Array,
    width: Array,
    height: Array,
    centre_u: Array,
    centre_v: Array,
    known: Array | None,
    sigma: float,
    photographed: bool,
) -> tuple[Array, Array, Array, Array, NDArray[np.int8]]:
    """Focal, its sigma (B), columns of the rotation (3, 3, B), translation (3, B), reasons (B) of corners (8, B)."""
    u, v = flat[0::2] - centre_u, flat[1::2] - centre_v
    edge_u, edge_v = _next(u) - u, _next(v) - v
    depth = _depths(edge_u, edge_v)
    if photographed:
        reason = reasons_of_areas(depth)
    else:
        depth = depth * np.where((depth < 0).sum(axis=0) > 2, -1.0, 1.0)
        reason = np.where(np.isfinite(depth).all(axis=0), np.int8(Reason.OK), np.int8(Reason.NOT_FINITE))
    sized = (width > 0) & (height > 0) & np.isfinite(width + height)
    if not sized.all():
        reason[~sized & (reason != Reason.NOT_FINITE)] = Reason.NO_SIZE
    sides = _side_directions(u, v, edge_u, edge_v, depth, width, height)
    g, sigma_g = _inverse_square_focal(u, v, edge_u, edge_v, sides, 1 / width, 1 / height)
    focal = 1 / np.sqrt(g)
    focal_sigma = 0.5 * sigma * sigma_g * focal**3
    reason[~(focal_sigma < _UNKNOWABLE * focal) & (reason == Reason.OK)] = Reason.FOCAL_UNKNOWABLE
    if known is not None:
        focal = np.broadcast_to(known, focal.shape).copy()
    columns, translation = _pose(u, v, depth, sides, focal)
    bad = (reason != Reason.OK) & (reason != Reason.FOCAL_UNKNOWABLE)
    if bad.any():
        for answer in (focal, focal_sigma, columns, translation):
            answer[..., bad] = np.nan
    return focal, focal_sigma, columns, translation, reason


def _next(rows: Array) -> Array:
    """The rows (4, B) of the next corner in turn."""
    return rows[[1, 2, 3, 0]]


def _depths(edge_u: Array, edge_v: Array) -> Array:
    """Depths (4, B) of the corners up to scale: the triangles that leave out each of them."""
    turn = edge_u * _next(edge_v) - edge_v * _next(edge_u)
    return _next(turn)


def _side_directions(
    u: Array, v: Array, edge_u: Array, edge_v: Array, depth: Array, width: Array, height: Array
) -> Array:
    """Images (2, 3, B) of one metre along the rectangle's x and y, in the scale of the depths.

    The difference of two depths is taken as one cross product of opposite sides: it is small for a small tilt, and
    subtracting areas would lose it.
    """
    sides = np.empty((2, 3, *depth.shape[1:]))
    for row, (first, second, size, sign) in enumerate(((0, 1, width, 1.0), (0, 3, height, -1.0))):
        edge, opposite = (0, 2) if row == 0 else (3, 1)
        slope = sign * (edge_v[edge] * edge_u[opposite] - edge_u[edge] * edge_v[opposite])
        scale = 1 / size
        sides[row, 0] = (slope * u[second] - sign * depth[first] * edge_u[edge]) * scale
        sides[row, 1] = (slope * v[second] - sign * depth[first] * edge_v[edge]) * scale
        sides[row, 2] = slope * scale
    return sides


def _inverse_square_focal(
    u: Array, v: Array, edge_u: Array, edge_v: Array, sides: Array, w: Array, h: Array
) -> tuple[Array, Array]:
    """g = 1/f^2 (B) and its standard deviation (B) for a noise of one pixel; w, h are one over width and height."""
    (x1, y1, z1), (x2, y2, z2) = sides
    p_real, p_imag = x1 * x1 + y1 * y1 - x2 * x2 - y2 * y2, 2 * (x1 * x2 + y1 * y2)
    q_real, q_imag = z1 * z1 - z2 * z2, 2 * z1 * z2
    p_square = p_real * p_real + p_imag * p_imag + _TINY
    q_size = z1 * z1 + z2 * z2
    g = np.maximum(-(p_real * q_real + p_imag * q_imag) / p_square, _LEAST_SHARE * q_size / np.sqrt(p_square))
    lengths = edge_u * edge_u + edge_v * edge_v
    bends = edge_u * _next(edge_u) + edge_v * _next(edge_v)
    along1, along2 = x1 * u + y1 * v, x2 * u + y2 * v
    rr, ii, ri = _constraint_covariance(g * along1 + z1, g * along2 + z2, lengths, bends, w, h)
    # Rows of P^T adj(C): the determinant cancels in g.
    left, right = p_real * ii - p_imag * ri, p_imag * rr - p_real * ri
    information = left * p_real + right * p_imag
    g = -(left * q_real + right * q_imag) / information
    return g, 2 * np.sqrt((rr * ii - ri * ri) / information)


def _constraint_covariance(
    y1: Array, y2: Array, lengths: Array, bends: Array, w: Array, h: Array
) -> tuple[Array, Array, Array]:
    """Covariance (real-real, imag-imag, real-imag), each (B), of e/2 for unit noise.

    Moving corner k by dp moves e by 2 [A (p_o - p_l) + B (p_n - p_o)] x dp up to sign, where n, o, l are the corners
    next, opposite and last; A and B combine y_j = n . p_j, n = diag(g, g, 1) m. y1, y2 (4, B): its real and imaginary
    parts. P1 and P3 share one pair of coefficients, P2 and P4 another.
    """
    wy1, wy2, hy1, hy2 = w * y1, w * y2, h * y1, h * y2
    rr, ii, ri = 0.0, 0.0, 0.0
    for n, o, last, odd in ((_P24, _P31, _P42, False), (_P31, _P42, _P13, True)):
        if odd:
            mix_r, mix_i = wy1[o] + hy2[o], wy2[o] - hy1[o]
            a_r, a_i = wy1[n] - mix_r, wy2[n] - mix_i
            b_r, b_i = hy2[last] - mix_r, -hy1[last] - mix_i
        else:
            mix_r, mix_i = wy1[o] - hy2[o], wy2[o] + hy1[o]
            a_r, a_i = -hy2[n] - mix_r, hy1[n] - mix_i
            b_r, b_i = wy1[last] - mix_r, wy2[last] - mix_i
        aa, bb, ab = lengths[o], lengths[n], bends[n]
        left, right = aa * a_r + ab * b_r, ab * a_r + bb * b_r
        rr = rr + (a_r * left + b_r * right)
        ri = ri + (a_i * left + b_i * right)
        ii = ii + (a_i * (aa * a_i + 2 * ab * b_i) + bb * b_i * b_i)
    return np.add(*rr), np.add(*ii), np.add(*ri)


def _pose(u: Array, v: Array, depth: Array, sides: Array, focal: Array) -> tuple[Array, Array]:
    """Columns (3, 3, B) of the rotation and the translation (3, B) of cam_from_rect at a focal (B).

    The two side directions are made orthonormal alike: sum and difference of unit vectors are at right angles.
    """
    inverse = 1 / focal
    rays = sides.copy()
    rays[:, :2] *= inverse
    norms = np.sqrt(rays[:, 0] ** 2 + rays[:, 1] ** 2 + rays[:, 2] ** 2)
    rays /= norms[:, None]
    total, difference = rays[0] + rays[1], rays[0] - rays[1]
    total *= np.sqrt(0.5 / (total[0] ** 2 + total[1] ** 2 + total[2] ** 2))
    difference *= np.sqrt(0.5 / (difference[0] ** 2 + difference[1] ** 2 + difference[2] ** 2))
    columns = np.empty((3, *rays.shape[1:]))
    x, y = columns[0], columns[1]
    x[...], y[...] = total + difference, total - difference
    columns[2, 0] = x[1] * y[2] - x[2] * y[1]
    columns[2, 1] = x[2] * y[0] - x[0] * y[2]
    columns[2, 2] = x[0] * y[1] - x[1] * y[0]
    scale = 0.5 / (norms[0] + norms[1])
    translation = np.empty(rays.shape[1:])
    translation[0] = (u * depth).sum(axis=0) * scale * inverse
    translation[1] = (v * depth).sum(axis=0) * scale * inverse
    translation[2] = depth.sum(axis=0) * scale
    return columns, translation
