"""What corners may come in, and the reason codes of those that cannot be solved."""

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError

# Twice a triangle's area over the largest of the four: corners so nearly in one line would lie a billion times
# nearer to the camera than their neighbours, which no picture shows.
_COLLINEAR = 1e-9


class Reason(IntEnum):
    """Why a member of a batch has no answer, or only a part of one."""

    OK = 0
    NOT_FINITE = 1
    NO_SIZE = 2
    COLLINEAR = 3
    CROSSING = 4
    NOT_CONVEX = 5
    REVERSED = 6
    FOCAL_UNKNOWABLE = 7
    NO_CONVERGENCE = 8


REASON_WORDS = {
    Reason.OK: "solved",
    Reason.NOT_FINITE: "a coordinate is nan or infinite; leave the view out or measure it again",
    Reason.NO_SIZE: "a side of the rectangle is not a positive length; give its width and height in metres",
    Reason.COLLINEAR: "three corners lie on one line; the corners of a rectangle never do, so measure them again",
    Reason.CROSSING: "the sides cross each other; give the corners in turn around the rectangle",
    Reason.NOT_CONVEX: "one corner lies inside the triangle of the others; no picture of a rectangle looks so",
    Reason.REVERSED: "the corners turn the wrong way; give them as bottom right, bottom left, top left, top right",
    Reason.FOCAL_UNKNOWABLE: "focal length and distance cannot be separated; tilt the sheet more, or give the focal",
    Reason.NO_CONVERGENCE: "no camera fits these points; check that they belong to this rectangle",
}
"""What each reason means and what to do, for people."""


def corner_reasons(corners: Floats, width: Floats | float = 1.0, height: Floats | float = 1.0) -> NDArray[np.int8]:
    """The Reason (as int8) of each quadrilateral. Corners (..., 4, 2) pixels in the order of Eq. 4, sides metres."""
    corners = check_shape(corners)
    areas = triangle_areas(np.moveaxis(corners, (-2, -1), (0, 1)))
    reasons = reasons_of_areas(areas)
    sides = np.broadcast_arrays(np.asarray(width, float), np.asarray(height, float))
    no_size = ~((sides[0] > 0) & (sides[1] > 0) & np.isfinite(sides[0] + sides[1]))
    return np.where(no_size & (reasons != Reason.NOT_FINITE), np.int8(Reason.NO_SIZE), reasons)


def check_shape(corners: Floats) -> Floats:
    """Corners as floats (..., 4, 2). Raises QuadrigError where the shape is another."""
    corners = np.asarray(corners, float)
    if corners.ndim < 2 or corners.shape[-2:] != (4, 2):
        raise QuadrigError(
            f"corners have the shape {corners.shape}; give four corners of two pixels each, (..., 4, 2)"
        )
    return corners


def check_centre(principal_point: Floats, sigma: float) -> Floats:
    """The principal point as floats (..., 2). Raises QuadrigError where it or the noise is none."""
    centre = np.asarray(principal_point, float)
    if centre.ndim < 1 or centre.shape[-1] != 2:
        raise QuadrigError(f"the principal point has the shape {centre.shape}; give its u and v in pixels, (..., 2)")
    if not sigma > 0:
        raise QuadrigError(f"the noise sigma is {sigma} px; give a standard deviation above zero")
    return centre


def triangle_areas(corners: Floats) -> Floats:
    """Twice the signed areas (4, ...) of the triangles that leave out P1, P2, P3, P4. Corners come as (4, 2, ...).

    They are also the depths of the four corners, up to one common scale.
    """
    u, v = corners[:, 0], corners[:, 1]
    edge_u, edge_v = np.roll(u, -1, axis=0) - u, np.roll(v, -1, axis=0) - v
    # Edge k runs from corner k to k+1: edges k+1 and k+2 span the triangle without corner k.
    turn = edge_u * np.roll(edge_v, -1, axis=0) - edge_v * np.roll(edge_u, -1, axis=0)
    return np.roll(turn, -1, axis=0)


def reasons_of_areas(areas: Floats) -> NDArray[np.int8]:
    """Reasons (...) of the four signed areas (4, ...): what their signs say of the quadrilateral."""
    smallest, largest = areas.min(axis=0), areas.max(axis=0)
    reasons = np.zeros(smallest.shape, np.int8)
    good = smallest > _COLLINEAR * largest
    if good.all():
        return reasons
    negative = (areas < 0).sum(axis=0)
    reasons[(negative == 1) | (negative == 3)] = Reason.NOT_CONVEX
    reasons[negative == 2] = Reason.CROSSING
    reasons[negative == 4] = Reason.REVERSED
    size = np.abs(areas)
    reasons[~(size.min(axis=0) > _COLLINEAR * size.max(axis=0))] = Reason.COLLINEAR
    reasons[~np.isfinite(areas).all(axis=0)] = Reason.NOT_FINITE
    return np.where(good, np.int8(Reason.OK), reasons)


def in_turn(corners: Floats) -> tuple[Floats, bool]:
    """Four corners (4, 2) in the turn of Eq. 4, and whether they had to be changed.

    Corners that turn the wrong way are read as by someone whose y axis points up, (+,+) being the top right: so P1
    changes places with P4 and P2 with P3, and the side P1 P2 stays the width.
    Raises QuadrigError, saying what is wrong, where the four are no picture of a rectangle.
    """
    corners = check_shape(corners)
    reason = Reason(int(corner_reasons(corners)))
    if reason == Reason.REVERSED:
        return corners[::-1].copy(), True
    if reason != Reason.OK:
        given = ", ".join(f"({u:g}, {v:g})" for u, v in corners)
        raise QuadrigError(f"corners {given}: {REASON_WORDS[reason]}")
    return corners, False
