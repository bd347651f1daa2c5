"""The arithmetic of the closed form: focal and pose from four corners.

Every quantity is a row: one number for each member of a batch, or a single number; the same lines serve both, one
corner and one coordinate at a time, so that a row stays in the first-level cache until it is used.

Method. With corners p_j = (u_j, v_j, 1) from the principal point, the depths of the corners of a parallelogram are
in the ratio of the areas of the triangles that the other three span, so the directions h1, h2 of the sides follow
without any decomposition. In the complex vector m = h1 + i h2 the two constraints (sides at right angles, and in
their known ratio) are the real and imaginary parts of one equation, linear in g = 1/f^2:

    e(g) = g (m_x^2 + m_y^2) + m_w^2 = 0

(the image of the circular points lies on the image of the absolute conic; Hartley and Zisserman, 2nd edition, 8.8).
The covariance of e under equal independent noise of the eight coordinates is a polynomial too; weighting by it makes
the estimate of g efficient to first order.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

Row = Any
"""A float64 array (B,) or a float64 number."""

# The estimate of g that the first weights are taken at: not less than this share of |m_w^2| / |m_x^2 + m_y^2|, which
# is g itself for exact corners and stays positive under any noise.
_LEAST_SHARE = 0.1
_TINY = np.finfo(float).tiny


class Quadrilateral(NamedTuple):
    """Corners from the principal point with what follows before any focal is known.

    u, v: four rows each; edge_u, edge_v: side k runs from corner k to k + 1; triangles: twice the signed area of the
    triangle at each corner, which is the depth of the opposite one; x, y: images (u, v, w) of one metre along the
    rectangle's x and y, in the scale of those depths.
    """

    u: Sequence[Row]
    v: Sequence[Row]
    edge_u: Sequence[Row]
    edge_v: Sequence[Row]
    triangles: Sequence[Row]
    x: Sequence[Row]
    y: Sequence[Row]


def quadrilateral(u: Sequence[Row], v: Sequence[Row], per_width: Row, per_height: Row) -> Quadrilateral:
    """From corners (px, from the principal point) and one over the sides (1/m).

    The difference of two depths is taken as one cross product of opposite sides: it is small for a small tilt, and
    subtracting areas would lose it.
    """
    a = [u[1] - u[0], u[2] - u[1], u[3] - u[2], u[0] - u[3]]
    b = [v[1] - v[0], v[2] - v[1], v[3] - v[2], v[0] - v[3]]
    triangles = [_cross(a[k - 1], b[k - 1], a[k], b[k]) for k in range(4)]
    depth = triangles[2]
    slope_x, slope_y = _cross(a[2], b[2], a[0], b[0]), _cross(a[3], b[3], a[1], b[1])
    x = [slope_x * u[1], slope_x * v[1], slope_x]
    x[0] -= depth * a[0]
    x[1] -= depth * b[0]
    y = [slope_y * u[3], slope_y * v[3], slope_y]
    y[0] += depth * a[3]
    y[1] += depth * b[3]
    for k in range(3):
        x[k] *= per_width
        y[k] *= per_height
    return Quadrilateral(u, v, a, b, triangles, x, y)


def _cross(u1: Row, v1: Row, u2: Row, v2: Row) -> Row:
    area = u1 * v2
    area -= v1 * u2
    return area


def _dot(a: Sequence[Row], b: Sequence[Row]) -> Row:
    product = a[0] * b[0]
    product += a[1] * b[1]
    product += a[2] * b[2]
    return product


def inverse_square_focal(quad: Quadrilateral, per_width: Row, per_height: Row) -> tuple[Row, Row]:
    """g = 1/f^2 and its standard deviation for a noise of one pixel; g <= 0 or nan where no focal fits."""
    (x1, y1, z1), (x2, y2, z2) = quad.x, quad.y
    p_real, p_imag = x1 * x1 + y1 * y1 - x2 * x2 - y2 * y2, 2 * (x1 * x2 + y1 * y2)
    q1, q2 = z1 * z1, z2 * z2
    q_real, q_imag = q1 - q2, 2 * (z1 * z2)
    p_square = p_real * p_real + p_imag * p_imag + _TINY
    plain = -(p_real * q_real + p_imag * q_imag) / p_square
    least = _LEAST_SHARE * (q1 + q2) / p_square**0.5
    g = 0.5 * (plain + least + abs(plain - least))
    rr, ii, ri = _constraint_covariance(quad, g, per_width, per_height)
    # Rows of P^T adj(C): the determinant cancels in g.
    left, right = p_real * ii - p_imag * ri, p_imag * rr - p_real * ri
    information = left * p_real + right * p_imag
    g = -(left * q_real + right * q_imag) / information
    return g, 2 * ((rr * ii - ri * ri) / information) ** 0.5


def _constraint_covariance(quad: Quadrilateral, g: Row, w: Row, h: Row) -> tuple[Row, Row, Row]:
    """Covariance (real-real, imag-imag, real-imag) of e/2 for unit noise, with weights taken at g.

    With y_j = n . p_j, n = diag(g, g, 1) m, and w, h one over the sides: moving the corner opposite to corner o by dp
    moves e by 2 [A s_o + B s_(o-1)] x dp, up to sign, where s_k is side k and

        A = i a y_(o-1) - (b + i a) y_o,    B = b y_(o+1) - (b + i a) y_o,    a = h, b = w

    for P1 and P3; for P2 and P4 the same with a and b exchanged, times -i.
    """
    (x1, y1, z1), (x2, y2, z2) = quad.x, quad.y
    real = _plane(quad, g * x1, g * y1, z1)
    imag = _plane(quad, g * x2, g * y2, z2)
    side = (w, h, w, h)
    slope_r, slope_i = _slopes(real, side), _slopes(imag, side)
    sums: list[list[Row]] = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    for o in range(4):
        own, other = side[o], side[o - 1]
        a_real, b_real = slope_i[o - 1] - own * real[o], slope_r[o] + other * imag[o]
        a_imag, b_imag = slope_r[o - 1] + own * imag[o], other * real[o] - slope_i[o]
        part = sums[o % 2]
        for out, into in ((quad.edge_u[o], quad.edge_u[o - 1]), (quad.edge_v[o], quad.edge_v[o - 1])):
            moved_r, moved_i = a_real * out, a_imag * out
            moved_r += b_real * into
            moved_i += b_imag * into
            part[2] = part[2] + moved_r * moved_i
            moved_r *= moved_r
            moved_i *= moved_i
            part[0], part[1] = part[0] + moved_r, part[1] + moved_i
    (rr, ii, ri), (turned_ii, turned_rr, turned_ri) = sums
    return rr + turned_rr, ii + turned_ii, turned_ri - ri


def _plane(quad: Quadrilateral, x: Row, y: Row, z: Row) -> list[Row]:
    """x u + y v + z at the four corners."""
    values = []
    for u, v in zip(quad.u, quad.v, strict=True):
        value = x * u
        value += y * v
        value += z
        values.append(value)
    return values


def _slopes(values: list[Row], side: Sequence[Row]) -> list[Row]:
    """Differences of the values along the four sides, each over its length."""
    slopes = []
    for k in range(4):
        slope = values[(k + 1) % 4] - values[k]
        slope *= side[k]
        slopes.append(slope)
    return slopes


def pose_at(quad: Quadrilateral, focal: Row) -> tuple[list[Row], list[Row]]:
    """The nine numbers of camera_from_rect's rotation, column by column, and the three of its translation.

    The two side directions are made orthonormal alike: sum and difference of unit vectors are at right angles.
    """
    inverse = 1 / focal
    x = [quad.x[0] * inverse, quad.x[1] * inverse, quad.x[2]]
    y = [quad.y[0] * inverse, quad.y[1] * inverse, quad.y[2]]
    norm_x, norm_y = _dot(x, x) ** 0.5, _dot(y, y) ** 0.5
    over_x, over_y = 1 / norm_x, 1 / norm_y
    # For unit vectors |x + y|^2 = 2 + 2 x.y and |x - y|^2 = 2 - 2 x.y; sum and difference are at right angles, and
    # half their unit vectors' sum and difference are x and y made orthonormal.
    product = _dot(x, y)
    product *= over_x
    product *= over_y
    half_sum, half_difference = 0.5 / (1 + product) ** 0.5, 0.5 / (1 - product) ** 0.5
    near, far = half_sum + half_difference, half_sum - half_difference
    near_x, far_x, near_y, far_y = near * over_x, far * over_x, near * over_y, far * over_y
    first, second = [near_x * value for value in x], [far_x * value for value in x]
    for k in range(3):
        first[k] += far_y * y[k]
        second[k] += near_y * y[k]
    (a0, a1, a2), (b0, b1, b2) = first, second
    columns = [*first, *second, _cross(a1, a2, b1, b2), _cross(a2, a0, b2, b0), _cross(a0, a1, b0, b1)]
    # The middle is that of either diagonal: P1 and P3, whose depths are the triangles at P3 and P1.
    norm_x += norm_y
    scale = 1 / norm_x
    depth1, depth3 = quad.triangles[2], quad.triangles[0]
    translation = [depth1 * quad.u[0], depth1 * quad.v[0], depth1 + depth3]
    translation[0] += depth3 * quad.u[2]
    translation[1] += depth3 * quad.v[2]
    translation[2] *= scale
    scale *= inverse
    translation[0] *= scale
    translation[1] *= scale
    return columns, translation
