"""Focal and pose of rectangles at the statistical limit: closed form, then maximum likelihood, in batches."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose, inverse_jacobian
from quadrig.single.rectangle import rectangle_corners
from quadrig.single.solve.closed_form import ClosedForm, closed_form
from quadrig.single.solve.corners import Reason, check_centre, check_shape
from quadrig.single.solve.homography import homographies
from quadrig.single.solve.pinhole_fit import Guess, PinholeFit, fit_pinhole
from quadrig.single.solve.twin import mirrored

# Half the width of a 95 % interval in sigmas.
NORMAL_95 = 1.959964
_FEWEST_POINTS = 4
# A chi2 this many of its own standard deviations above its mean is not what noise does: another optimum may be lower.
_SURPRISE = 5.0
# Sums of squares nearer than this are one optimum, found twice.
_SAME_CHI2 = 1e-5
# Focals, as shares of the picture's half width, to start from where the corners alone give none: from a wide lens
# to a long one.
_FOCAL_LADDER = (1.0, 3.0, 10.0)


@dataclass(frozen=True, eq=False)
class Solution:
    """Focal and pose of each member of a batch (...), with what is known of their errors.

    focal (...) px; principal_point (..., 2) px; camera_from_rect; covariance (..., 9, 9) of (focal, cx, cy, rotation
    step, translation step of camera_from_rect), px, radians, metres, zero for what was given as known;
    chi2 (...) over sigma^2 and its degrees of freedom dof (...); reason (...) int8, a Reason.
    Bad members are nan. Where the reason is FOCAL_UNKNOWABLE the most likely values stand, with their large sigmas.
    """

    focal: Floats
    principal_point: Floats
    camera_from_rect: Pose
    covariance: Floats
    chi2: Floats
    dof: Ints
    reason: NDArray[np.int8]

    @property
    def focal_sigma(self) -> Floats:
        """Standard deviation (...) of the focal, px."""
        return np.sqrt(self.covariance[..., 0, 0])

    @property
    def focal_interval(self) -> tuple[Floats, Floats]:
        """The 95 % interval (...) of the focal, px: symmetric in 1/f, in which a weak view is nearly linear, so that
        it may reach infinity."""
        inverse = 1 / self.focal
        # Corners of an exactly frontal sheet leave no sigma at all: any focal shows them.
        sigma = np.where(np.isnan(self.focal_sigma) & np.isfinite(self.focal), np.inf, self.focal_sigma)
        spread = NORMAL_95 * sigma * inverse**2
        with np.errstate(divide="ignore"):
            return 1 / (inverse + spread), 1 / np.maximum(inverse - spread, 0)

    @property
    def pose_covariance(self) -> Floats:
        """Covariance (..., 6, 6) of the step of camera_from_rect (camera's frame)."""
        return self.covariance[..., 3:, 3:]

    @property
    def rect_from_camera(self) -> Pose:
        """The camera in the rectangle's frame: the paper's [R T]."""
        return self.camera_from_rect.inverse()

    @property
    def rect_from_camera_covariance(self) -> Floats:
        """Covariance (..., 9, 9) of (focal, cx, cy, step of rect_from_camera): rectangle's frame."""
        jacobian = np.zeros(self.covariance.shape)
        jacobian[..., :3, :3] = np.eye(3)
        jacobian[..., 3:, 3:] = inverse_jacobian(self.camera_from_rect)
        return jacobian @ self.covariance @ np.swapaxes(jacobian, -1, -2)


def solve_rectangles(
    corners: Floats,
    width: Floats | float,
    height: Floats | float,
    principal_point: Floats,
    *,
    focal: Floats | float | None = None,
    sigma: float = 0.3,
    principal_point_sigma: float = 0.0,
) -> Solution:
    """Most likely focal and pose of rectangles from their four corners.

    corners (..., 4, 2) pixels in the order of Eq. 4 (bottom right, bottom left, top left, top right); width,
    height (...) metres; principal_point (..., 2) px and the standard deviation of its prior, per axis (0: known);
    focal: where known (...) px; sigma: standard deviation of a pixel coordinate.
    Raises QuadrigError for arrays of the wrong shape; bad members come back nan with their reason.
    """
    corners, centre = check_shape(corners), check_centre(principal_point, sigma)
    batch = corners.shape[:-2]
    members = int(np.prod(batch))
    size = np.stack(np.broadcast_arrays(np.asarray(width, float), np.asarray(height, float)), axis=-1)
    task = _Task(
        points=_flat(rectangle_corners(width, height)[..., :2], batch, 2),
        pixels=corners.reshape(members, 4, 2),
        corners=corners.reshape(members, 4, 2),
        size=_flat(size, batch, 1),
        middle=np.zeros((1, 2)),
        centre=_flat(centre, batch, 1),
        focal=None if focal is None else _flat(focal, batch, 0),
        sigma=sigma,
        centre_sigma=principal_point_sigma,
    )
    return _solution(task, batch)


def solve_points(
    points: Floats,
    pixels: Floats,
    principal_point: Floats,
    *,
    focal: Floats | float | None = None,
    sigma: float = 0.3,
    principal_point_sigma: float = 0.0,
    photographed: bool = True,
) -> Solution:
    """Most likely focal and pose from any number of points on a plane, four or more.

    points (..., P, 2 or 3) metres in the rectangle's frame, on its plane; pixels (..., P, 2), nan where unseen; the
    rest as in solve_rectangles. photographed: False accepts points behind the camera, as formal projections.
    Raises QuadrigError for arrays of the wrong shape; bad members come back nan with their reason.
    """
    points, pixels = np.asarray(points, float)[..., :2], np.asarray(pixels, float)
    centre = check_centre(principal_point, sigma)
    if pixels.ndim < 2 or pixels.shape[-1] != 2 or points.shape[-2:] != pixels.shape[-2:] or pixels.shape[-2] < 4:
        raise QuadrigError(
            f"points have the shape {points.shape} and pixels {pixels.shape}; give as many of each, four or more"
        )
    batch, count = pixels.shape[:-2], pixels.shape[-2]
    flat = pixels.reshape(-1, count, 2)
    seen = np.all(np.isfinite(flat), axis=-1)
    everywhere = np.broadcast_to(_flat(points, batch, 2), flat.shape)
    corners, size, middle = _frame(everywhere, flat, seen)
    task = _Task(
        points=_flat(points, batch, 2),
        pixels=np.where(seen[..., None], flat, np.nan),
        corners=corners,
        size=size,
        middle=middle,
        centre=_flat(centre, batch, 1),
        focal=None if focal is None else _flat(focal, batch, 0),
        sigma=sigma,
        centre_sigma=principal_point_sigma,
        photographed=photographed,
    )
    return _solution(task, batch)


def _flat(value: Floats | float, batch: tuple[int, ...], tail: int) -> Floats:
    """The value as (members, ...), or (1, ...) where every member shares it."""
    value = np.asarray(value, float)
    own = value.shape[value.ndim - tail :]
    try:
        return (value if value.ndim == tail else np.broadcast_to(value, (*batch, *own))).reshape(-1, *own)
    except ValueError:
        raise QuadrigError(f"an array of the shape {value.shape} does not fit a batch of {batch} views") from None


def _frame(points: Floats, pixels: Floats, seen: Mask) -> tuple[Floats, Floats, Floats]:
    """The rectangle around the points of each member: where its corners lie in the image by the homography of all
    points (N, 4, 2), its size (N, 2) and its middle (N, 2)."""
    with np.errstate(all="ignore"):
        low = np.where(seen[..., None], points, np.inf).min(axis=-2)
        high = np.where(seen[..., None], points, -np.inf).max(axis=-2)
        size, middle = high - low, (high + low) / 2
        H = homographies(points, np.where(seen[..., None], pixels, 0.0), seen.astype(float))
        frame = rectangle_corners(size[..., 0], size[..., 1])[..., :2] + middle[..., None, :]
        mapped = frame @ np.swapaxes(H[..., :2], -1, -2) + H[..., None, :, 2]
        return mapped[..., :2] / mapped[..., 2:], size, middle


@dataclass(frozen=True, eq=False)
class _Task:
    """Members to solve: points (1 or N, P, 2), pixels (N, P, 2) with nan where unseen; the rectangle whose corners
    (N, 4, 2) px start them, its size and middle (1 or N, 2); centre (1 or N, 2); focal (1 or N) where known."""

    points: Floats
    pixels: Floats
    corners: Floats
    size: Floats
    middle: Floats
    centre: Floats
    focal: Floats | None
    sigma: float
    centre_sigma: float
    photographed: bool = True

    def members(self, index: Ints) -> "_Task":
        def some(value):
            return value[index] if isinstance(value, np.ndarray) and len(value) > 1 else value

        changed = {name: some(getattr(self, name)) for name in ("points", "size", "middle", "centre", "focal")}
        return replace(self, pixels=self.pixels[index], corners=self.corners[index], **changed)

    def start(self, focal: Floats | None) -> ClosedForm:
        size = self.size
        closed = closed_form(self.corners, size[:, 0], size[:, 1], self.centre, focal, self.sigma, self.photographed)
        if not self.middle.any():
            return closed
        offset = np.concatenate([-self.middle, np.zeros((len(self.middle), 1))], axis=-1)
        pose = closed.camera_from_rect
        return replace(closed, camera_from_rect=Pose(pose.rotation, pose.transform(offset)))

    def fit(self, focal: Floats, start: Pose) -> PinholeFit:
        return fit_pinhole(
            self.points,
            self.pixels,
            Guess(focal, start),
            self.centre,
            self.sigma,
            self.centre_sigma,
            focal_known=self.focal is not None,
            photographed=self.photographed,
        )

    @property
    def dof(self) -> Ints:
        seen = np.isfinite(self.pixels).all(axis=-1).sum(axis=-1)
        return 2 * seen - (7 if self.focal is None else 6)

    @property
    def reach(self) -> Floats:
        """Half the width of the picture (N), estimated from the principal point and the corners."""
        return np.maximum(self.centre.max(axis=-1), np.abs(self.corners - self.centre[:, None]).max(axis=(-1, -2)))


def _solution(task: _Task, batch: tuple[int, ...]) -> Solution:
    start = task.start(task.focal)
    reason = start.reason.copy()
    # Finite pixels without a homography: the points lie on one line.
    finite = np.isfinite(task.pixels).all(axis=-1).sum(axis=-1) >= _FEWEST_POINTS
    reason[(reason == Reason.NOT_FINITE) & finite] = Reason.COLLINEAR
    if task.focal is not None:
        reason[reason == Reason.FOCAL_UNKNOWABLE] = Reason.OK
    usable = (reason == Reason.OK) | (reason == Reason.FOCAL_UNKNOWABLE)
    fit = task.fit(start.focal, start.camera_from_rect)
    fit = _with_other_starts(task, fit, usable)
    if task.focal is None:
        reason[usable] = np.where(_weak(fit)[usable], np.int8(Reason.FOCAL_UNKNOWABLE), np.int8(Reason.OK))
    reason[(reason == Reason.OK) & ~(fit.converged & np.isfinite(fit.chi2))] = Reason.NO_CONVERGENCE
    lost = ~usable | ~np.isfinite(fit.chi2)
    for values in (fit.focal, fit.principal_point, fit.camera_from_rect.rotation, fit.camera_from_rect.translation):
        values[lost] = np.nan
    fit.covariance[lost] = np.nan
    return Solution(
        fit.focal.reshape(batch),
        fit.principal_point.reshape(*batch, 2),
        Pose(
            fit.camera_from_rect.rotation.reshape(*batch, 3, 3), fit.camera_from_rect.translation.reshape(*batch, 3)
        ),
        fit.covariance.reshape(*batch, 9, 9),
        np.where(lost, np.nan, fit.chi2).reshape(batch),
        task.dof.reshape(batch),
        reason.reshape(batch),
    )


def _weak(fit: PinholeFit) -> Mask:
    """Where the 95 % interval of the focal reaches infinity."""
    return ~(NORMAL_95 * np.sqrt(fit.covariance[:, 0, 0]) < fit.focal)


def _with_other_starts(task: _Task, fit: PinholeFit, usable: Mask) -> PinholeFit:
    """The fit, replaced by a better one where it is in doubt: not converged, or worse than noise explains.

    Tried are other focals with the tilt of the corners, and each with the mirrored tilt.
    """
    surprising = task.dof + _SURPRISE * np.sqrt(2 * np.maximum(task.dof, 1))
    doubtful = np.flatnonzero(usable & ~(fit.converged & (fit.chi2 < surprising)))
    if not len(doubtful):
        return fit
    focals, poses = [], []
    part = task.members(doubtful)
    for rung in _FOCAL_LADDER if part.focal is None else (1.0,):
        focal = np.broadcast_to(part.reach * rung if part.focal is None else part.focal, len(doubtful))
        pose = part.start(focal).camera_from_rect
        focals += [focal, focal]
        poses += [pose, mirrored(pose)]
    # All candidates in one batch: a search of few members costs as much as one of many.
    tried = task.members(np.tile(doubtful, len(poses)))
    if tried.focal is not None:
        tried = replace(tried, focal=np.concatenate(focals))
    start = Pose(
        np.concatenate([pose.rotation for pose in poses]), np.concatenate([pose.translation for pose in poses])
    )
    other = tried.fit(np.concatenate(focals), start)
    for k in range(len(poses)):
        _take_better(fit, other, slice(k * len(doubtful), (k + 1) * len(doubtful)), doubtful)
    return fit


def _take_better(fit: PinholeFit, other: PinholeFit, part: slice, index: Ints) -> None:
    """Put those of the members `part` of `other` that have a smaller chi2 into `fit` at the index."""
    chi2, converged = other.chi2[part], other.converged[part]
    # By more than the convergence leaves open, so that equal answers stay as they are.
    better = np.isfinite(chi2) & ~(fit.chi2[index] <= chi2 + _SAME_CHI2)
    better |= ~fit.converged[index] & converged & (chi2 <= fit.chi2[index] + _SAME_CHI2)
    to = index[better]
    for name in ("focal", "principal_point", "covariance", "chi2", "steps", "converged"):
        getattr(fit, name)[to] = getattr(other, name)[part][better]
    fit.camera_from_rect.rotation[to] = other.camera_from_rect.rotation[part][better]
    fit.camera_from_rect.translation[to] = other.camera_from_rect.translation[part][better]
