"""One rectangle, one image: focal and pose in closed form, from both constraints of the rectangle, in batches.

The production solver: the arithmetic and its source are in quadrilateral.py. The paper's own closed form, which uses
one constraint of the two, is in paper_form.py.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose
from quadrig.single.solve.corners import Reason, check_centre, check_shape, reasons_of_areas
from quadrig.single.solve.quadrilateral import Quadrilateral, Row, inverse_square_focal, pose_at, quadrilateral

# Members solved at a time: long rows hide numpy's cost per call, and these stay in a core's own cache.
_BLOCK = 5000
# A focal whose sigma exceeds this share of itself has an interval (in 1/f, 95 %) that reaches infinity.
_UNKNOWABLE = 0.5


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """Focal and pose of each member of a batch (...).

    focal (...) px; focal_sigma (...) px for the noise the call was given; camera_from_rect with rotation
    (..., 3, 3) and translation (..., 3) metres; reason (...) int8, a Reason. A member of bad input is nan
    throughout. Where the reason is FOCAL_UNKNOWABLE the pose holds for the focal, as far as there is one (nan where
    noise left none).
    """

    focal: Floats
    focal_sigma: Floats
    camera_from_rect: Pose
    reason: NDArray[np.int8]


def closed_form(
    corners: Floats,
    width: Floats | float,
    height: Floats | float,
    principal_point: Floats,
    focal: Floats | float | None = None,
    sigma: float = 0.3,
    photographed: bool = True,
) -> ClosedForm:
    """Focal and pose of rectangles from their four corners.

    corners (..., 4, 2) pixels in the order of Eq. 4, that is bottom right, bottom left, top left, top right of
    the upright sheet; width, height (...) metres; principal_point (..., 2) pixels. focal: where it is known (...) px:
    the pose is for it, and focal_sigma 0. sigma: standard deviation of a pixel coordinate, px; it decides what is
    FOCAL_UNKNOWABLE (focal sigma above half the focal) and scales focal_sigma, and does not change the estimate.
    photographed: False accepts corners behind the camera too, as a formal projection puts them in the image.
    Raises QuadrigError for arrays of the wrong shape; bad members come back nan with their reason.
    """
    corners, centre = check_shape(corners), check_centre(principal_point, sigma)
    batch = corners.shape[:-2]
    rows = [_row(width, batch, "width"), _row(height, batch, "height")]
    rows += [_row(centre[..., axis], batch, "principal_point") for axis in (0, 1)]
    known = None if focal is None else _row(focal, batch, "focal")
    flat = corners.reshape(-1, 8)
    count = len(flat)
    answer = _Answer(
        np.empty(count), np.empty(count), np.empty((count, 3, 3)), np.empty((count, 3)), np.empty(count, np.int8)
    )
    with np.errstate(all="ignore"):
        for start in range(0, count, _BLOCK):
            part = slice(start, start + _BLOCK)
            given = [row[0] if len(row) == 1 else row[part] for row in (*rows, *([] if known is None else [known]))]
            columns = flat[0] if count == 1 else np.ascontiguousarray(flat[part].T)
            _solve(columns, given, sigma, photographed, answer, part)
    pose = Pose(answer.rotation.reshape(*batch, 3, 3), answer.translation.reshape(*batch, 3))
    return ClosedForm(answer.focal.reshape(batch), answer.sigma.reshape(batch), pose, answer.reason.reshape(batch))


def _row(value: Floats | float, batch: tuple[int, ...], name: str) -> Floats:
    """The value as one row: a single number stays one, anything else is spread over the batch."""
    value = np.asarray(value, float)
    if value.size == 1:
        return value.reshape(1)
    try:
        return np.broadcast_to(value, batch).reshape(-1)
    except ValueError:
        raise QuadrigError(f"{name} has the shape {value.shape}; it does not fit a batch of {batch} views") from None


@dataclass(frozen=True, eq=False)
class _Answer:
    """Where the blocks write: focal, sigma, reason (N), rotation (N, 3, 3), translation (N, 3)."""

    focal: Floats
    sigma: Floats
    rotation: Floats
    translation: Floats
    reason: NDArray[np.int8]


def _solve(corners: Floats, given: list[Row], sigma: float, photographed: bool, answer: _Answer, part: slice) -> None:
    """One block: corners (8, B) or (8), given: width, height, principal point's u and v, and a focal if known."""
    width, height, centre_u, centre_v = given[:4]
    per_width, per_height = 1 / width, 1 / height
    u, v = [corners[k] - centre_u for k in (0, 2, 4, 6)], [corners[k] - centre_v for k in (1, 3, 5, 7)]
    quad = quadrilateral(u, v, per_width, per_height)
    if not photographed:
        quad = _towards_camera(quad)
    g, sigma_g = inverse_square_focal(quad, per_width, per_height)
    focal = 1 / g**0.5
    relative = 0.5 * sigma * sigma_g / g
    answer.focal[part], answer.sigma[part] = focal, relative * focal
    if len(given) == 5:
        focal = given[4]
        answer.focal[part], answer.sigma[part] = focal, 0.0
    columns, translation = pose_at(quad, focal)
    for k in range(9):
        answer.rotation[part, k % 3, k // 3] = columns[k]
    for k in range(3):
        answer.translation[part, k] = translation[k]
    reason = answer.reason[part]
    reason[...] = _reasons(quad, width, height, photographed)
    bad = np.flatnonzero(reason)
    if bad.size:
        for values in (answer.focal, answer.sigma, answer.rotation, answer.translation):
            values[part][bad] = np.nan
    reason[~((g > 0) & (relative < _UNKNOWABLE)) & (reason == Reason.OK)] = Reason.FOCAL_UNKNOWABLE


def _reasons(quad: Quadrilateral, width: Row, height: Row, photographed: bool) -> NDArray[np.int8]:
    triangles = np.array(quad.triangles).reshape(4, -1)
    if photographed:
        reason = reasons_of_areas(triangles)
    else:
        reason = np.where(np.isfinite(triangles).all(axis=0), np.int8(Reason.OK), np.int8(Reason.NOT_FINITE))
    sized = (width > 0) & (height > 0) & np.isfinite(width + height)
    if not np.all(sized):
        reason[~sized & (reason != Reason.NOT_FINITE)] = Reason.NO_SIZE
    return reason


def _towards_camera(quad: Quadrilateral) -> Quadrilateral:
    """With the common sign of all depths chosen so that most corners lie in front of the camera."""
    in_front = np.array(quad.triangles) > 0
    sign = np.where(in_front.sum(axis=0) < 2, -1.0, 1.0)
    triangles, x, y = ([sign * row for row in rows] for rows in (quad.triangles, quad.x, quad.y))
    return quad._replace(triangles=triangles, x=x, y=y)
