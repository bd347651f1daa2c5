"""Lenses: from a point in the camera frame to a pixel, back again, and the derivatives of both.

A lens is nine numbers in the order of LENS_PARAMETERS. Two models share them: "pinhole" with radial-tangential
distortion (Brown 1966, OpenCV's order k1 k2 p1 p2 k3) and "fisheye", the equidistant model of Kannala and Brandt
(2006) with k1 k2 k3 k4 in the same five places (the last unused).
Pixels: the centre of the top-left pixel is (0, 0). Camera axes: x right, y down, z forward.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from quadrig.single.arrays import Floats

LensModel = Literal["pinhole", "fisheye"]
_Coefficients = tuple[Floats, ...]

LENS_PARAMETERS = ("focal", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "aspect")
"""Names of the lens parameters in the order of every parameter vector and lens covariance."""

DISTORTION_NAMES: dict[LensModel, tuple[str, ...]] = {
    "pinhole": ("k1", "k2", "p1", "p2", "k3"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
"""What each model calls its distortion, in the order of Intrinsics.distortion."""

# Newton's method for the inverse lens: convergence is quadratic, so ten steps from the undistorted guess are
# twice what a lens of any use needs; a pixel that is not back to 1e-9 by then has no ray in front of the lens.
_NEWTON_STEPS = 20
_NEWTON_TOLERANCE = 1e-9
# Pixels of one lens that are worked on together: they fit a processor's cache.
_AT_ONCE = 1 << 14
# Where all are this near they are as near as rounding lets them come.
_CONVERGED = 1e-4 * _NEWTON_TOLERANCE


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """What a lens and sensor do to rays: image size, focal, principal point, distortion.

    focal: pixels, along x; aspect: focal along y over focal along x. principal_point (2,) pixels.
    distortion (5,): k1 k2 p1 p2 k3 (pinhole) or k1 k2 k3 k4 0 (fisheye).
    """

    width: int
    height: int
    focal: float
    principal_point: Floats
    distortion: Floats = field(default_factory=lambda: np.zeros(5))
    aspect: float = 1.0
    model: LensModel = "pinhole"

    @staticmethod
    def centred(width: int, height: int, focal: float, model: LensModel = "pinhole") -> "Intrinsics":
        """A lens without distortion whose axis meets the middle of the image."""
        return Intrinsics(width, height, float(focal), image_middle(width, height), model=model)

    @property
    def parameters(self) -> Floats:
        """The nine numbers (9,) in the order of LENS_PARAMETERS."""
        return np.array([self.focal, *self.principal_point, *self.distortion, self.aspect])

    def with_parameters(self, parameters: Floats) -> "Intrinsics":
        """The same image and model with other numbers (9,)."""
        p = np.asarray(parameters, float)
        return replace(
            self,
            focal=float(p[0]),
            principal_point=p[1:3].copy(),
            distortion=p[3:8].copy(),
            aspect=float(p[8]),
        )

    @property
    def camera_matrix(self) -> Floats:
        """K (3, 3) of x = K X."""
        return np.array(
            [
                [self.focal, 0.0, self.principal_point[0]],
                [0.0, self.focal * self.aspect, self.principal_point[1]],
                [0.0, 0.0, 1.0],
            ]
        )

    def project(self, points: Floats) -> Floats:
        """Pixels (..., 2) of points (..., 3) in the camera frame; nan where the lens cannot see the point."""
        return project(self.parameters, points, self.model)

    def unproject(self, pixels: Floats) -> Floats:
        """Unit rays (..., 3) of pixels (..., 2); nan where the lens has no ray for the pixel."""
        return unproject(self.parameters, pixels, self.model)


def image_middle(width: int, height: int) -> Floats:
    """The middle (2,) of a picture, where a principal point is expected: whole coordinates are centres of pixels."""
    return np.array([(width - 1) / 2, (height - 1) / 2])


def project(parameters: Floats, points: Floats, model: LensModel = "pinhole") -> Floats:
    """Pixels (..., 2) of points (..., 3) in the camera frame, for lenses (..., 9) that broadcast against them.

    nan where a point lies behind a pinhole, or on the axis behind a fisheye lens.
    """
    parameters, points = np.asarray(parameters, float), np.asarray(points, float)
    plane = _plane_from_point(points) if model == "pinhole" else points
    distort = _distort_radial_tangential if model == "pinhole" else _distort_equidistant
    return _pixels(parameters, distort(parameters, plane))


def project_with_derivatives(
    parameters: Floats, points: Floats, model: LensModel = "pinhole"
) -> tuple[Floats, Floats, Floats]:
    """Pixels (..., 2) with their derivatives by the lens (..., 2, 9) and by the point (..., 2, 3)."""
    parameters, points = np.asarray(parameters, float), np.asarray(points, float)
    shape = np.broadcast_shapes(parameters.shape[:-1], points.shape[:-1])
    by_lens, by_point = np.zeros((*shape, 2, 9)), np.zeros((*shape, 2, 3))
    pixels = fill_projection_rows(
        np.moveaxis(parameters, -1, 0),
        np.moveaxis(points, -1, 0),
        list(np.moveaxis(by_lens, (-1, -2), (0, 1))),
        np.moveaxis(by_point, (-1, -2), (0, 1)),
        model,
    )
    return np.moveaxis(pixels, 0, -1), by_lens, by_point


def fill_projection_rows(
    parameters: Floats,
    points: Floats,
    by_lens: Sequence[Floats | None],
    by_point: Floats,
    model: LensModel = "pinhole",
) -> Floats:
    """Pixels (2, ...) and, written in place, their derivatives: the same projection with components first.

    parameters (9, ...) and points (3, ...) broadcast. by_lens: nine arrays (2, ...) that come as zeros, or None for
    parameters whose derivative is not wanted; by_point (3, 2, ...). They may be views of any memory order, so that a
    caller lays them out as its next product wants them.
    """
    fill = _fill_radial_tangential if model == "pinhole" else _fill_equidistant
    focal, aspect = parameters[0], parameters[8]
    focal_y = focal * aspect
    x, y = fill(parameters, points, by_lens[3:8], by_point, focal, focal_y)
    by_focal, by_cx, by_cy, by_aspect = by_lens[0], by_lens[1], by_lens[2], by_lens[8]
    if by_focal is not None:
        by_focal[0] = x
        by_focal[1] = aspect * y
    if by_cx is not None:
        by_cx[0] = 1
    if by_cy is not None:
        by_cy[1] = 1
    if by_aspect is not None:
        by_aspect[1] = focal * y
    return np.stack([focal * x + parameters[1], focal_y * y + parameters[2]])


def unproject(parameters: Floats, pixels: Floats, model: LensModel = "pinhole") -> Floats:
    """Unit rays (..., 3) of pixels (..., 2) by Newton's method; nan where no ray leads to the pixel."""
    parameters, pixels = np.asarray(parameters, float), np.asarray(pixels, float)
    if parameters.ndim == 1 and pixels.size > 2 * _AT_ONCE:
        flat = pixels.reshape(-1, 2)
        parts = [_unproject(parameters, flat[k : k + _AT_ONCE], model) for k in range(0, len(flat), _AT_ONCE)]
        return np.concatenate(parts).reshape(*pixels.shape[:-1], 3)
    return _unproject(parameters, pixels, model)


def _unproject(parameters: Floats, pixels: Floats, model: LensModel) -> Floats:
    focal, aspect = parameters[..., 0], parameters[..., 8]
    distorted = (pixels - parameters[..., 1:3]) / np.stack([focal, focal * aspect], axis=-1)
    with np.errstate(all="ignore"):
        if model == "pinhole":
            plane = _undistort_radial_tangential(parameters, distorted)
            ray = np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)
        else:
            ray = _ray_equidistant(parameters, distorted)
        return ray / np.linalg.norm(ray, axis=-1, keepdims=True)


def _pixels(parameters: Floats, distorted: Floats) -> Floats:
    focal, aspect = parameters[..., 0], parameters[..., 8]
    return distorted * np.stack([focal, focal * aspect], axis=-1) + parameters[..., 1:3]


def _plane_from_point(points: Floats) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(points[..., 2:] > 0, points[..., 2:], np.nan)
        return points[..., :2] / depth


def _distort_radial_tangential(parameters: Floats, plane: Floats) -> Floats:
    return np.stack(_distorted(_coefficients(parameters), plane[..., 0], plane[..., 1]), axis=-1)


def _coefficients(parameters: Floats) -> _Coefficients:
    """k1, k2, p1, p2, k3, each of which broadcasts against coordinates."""
    return tuple(parameters[..., place] for place in range(3, 8))


def _distorted(coefficients: _Coefficients, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Where the lens takes a point of the plane."""
    k1, k2, p1, p2, k3 = coefficients
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    product = 2 * x * y
    return (
        x * radial + p1 * product + p2 * (square + 2 * x * x),
        y * radial + p2 * product + p1 * (square + 2 * y * y),
    )


def _fill_radial_tangential(
    parameters: Floats,
    points: Floats,
    by_distortion: Sequence[Floats | None],
    by_point: Floats,
    focal_x: Floats,
    focal_y: Floats,
) -> tuple[Floats, Floats]:
    k1, k2, p1, p2, k3 = parameters[3:8]
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse_depth = 1 / np.where(points[2] > 0, points[2], np.nan)
        x, y = points[0] * inverse_depth, points[1] * inverse_depth
    xx, yy, xy = x * x, y * y, x * y
    square = xx + yy
    distorted_x, distorted_y, x_by_x, y_by_y, mixed = x, y, np.ones_like(x), np.ones_like(x), np.zeros_like(x)
    if np.any(k1) or np.any(k2) or np.any(k3):
        higher = k2 + square * k3
        linear = k1 + square * higher
        radial = 1 + square * linear
        slope = 2 * (linear + square * (higher + square * k3))
        distorted_x, distorted_y = x * radial, y * radial
        x_by_x, y_by_y, mixed = radial + xx * slope, radial + yy * slope, xy * slope
    if any(by_distortion[place] is not None for place in (0, 1, 4)):
        power_x, power_y = focal_x * square * x, focal_y * square * y
        for row in (by_distortion[0], by_distortion[1], by_distortion[4]):
            if row is not None:
                row[0], row[1] = power_x, power_y
            power_x, power_y = power_x * square, power_y * square
    by_p1, by_p2 = by_distortion[2], by_distortion[3]
    if by_p1 is not None or by_p2 is not None or np.any(p1) or np.any(p2):
        tangential_x, tangential_y = square + 2 * xx, square + 2 * yy
        distorted_x = distorted_x + 2 * p1 * xy + p2 * tangential_x
        distorted_y = distorted_y + 2 * p2 * xy + p1 * tangential_y
        mixed = mixed + 2 * p1 * x + 2 * p2 * y
        x_by_x, y_by_y = x_by_x + 2 * p1 * y + 6 * p2 * x, y_by_y + 2 * p2 * x + 6 * p1 * y
        if by_p1 is not None:
            by_p1[0], by_p1[1] = 2 * focal_x * xy, focal_y * tangential_y
        if by_p2 is not None:
            by_p2[0], by_p2[1] = focal_x * tangential_x, 2 * focal_y * xy
    for side, (scale, by_x, by_y) in enumerate(((focal_x, x_by_x, mixed), (focal_y, mixed, y_by_y))):
        scaled = scale * inverse_depth
        across, down = scaled * by_x, scaled * by_y
        by_point[0, side], by_point[1, side] = across, down
        by_point[2, side] = -(across * x + down * y)
    return distorted_x, distorted_y


def _slopes(coefficients: _Coefficients, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Derivatives of `_distorted`: of x by x, of y by y, and of either by the other."""
    k1, k2, p1, p2, k3 = coefficients
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    slope = 2 * (k1 + square * (2 * k2 + square * 3 * k3))
    return (
        radial + x * x * slope + 2 * p1 * y + 6 * p2 * x,
        radial + y * y * slope + 2 * p2 * x + 6 * p1 * y,
        x * y * slope + 2 * p1 * x + 2 * p2 * y,
    )


def _undistort_radial_tangential(parameters: Floats, distorted: Floats) -> Floats:
    coefficients = _coefficients(parameters)
    # Of the pixels of a picture each coordinate is worked on as one piece of memory.
    aim_x, aim_y = np.array(distorted[..., 0]), np.array(distorted[..., 1])
    x, y = aim_x, aim_y
    for _ in range(_NEWTON_STEPS):
        error_x, error_y = _errors(coefficients, x, y, aim_x, aim_y)
        if max(np.nanmax(np.abs(error), initial=0.0) for error in (error_x, error_y)) < _CONVERGED:
            break
        by_x, by_y, mixed = _slopes(coefficients, x, y)
        determinant = by_x * by_y - mixed * mixed
        x = x - (by_y * error_x - mixed * error_y) / determinant
        y = y - (by_x * error_y - mixed * error_x) / determinant
    error_x, error_y = _errors(coefficients, x, y, aim_x, aim_y)
    by_x, by_y, mixed = _slopes(coefficients, x, y)
    # A folded lens maps two radii to one pixel: the ray is the one before the fold, where the map keeps sense.
    unfolded = by_x * by_y - mixed * mixed > 0
    found = (np.maximum(np.abs(error_x), np.abs(error_y)) < _NEWTON_TOLERANCE) & unfolded
    return np.where(found[..., None], np.stack([x, y], axis=-1), np.nan)


def _errors(coefficients: _Coefficients, x: Floats, y: Floats, aim_x: Floats, aim_y: Floats) -> tuple[Floats, Floats]:
    distorted_x, distorted_y = _distorted(coefficients, x, y)
    return distorted_x - aim_x, distorted_y - aim_y


def _equidistant_radius(parameters: Floats, angle: Floats) -> tuple[Floats, Floats]:
    """Distorted angle theta_d of the angle from the axis, and its slope."""
    k1, k2, k3, k4 = np.moveaxis(parameters[..., 3:7], -1, 0)
    s = angle * angle
    radius = angle * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
    slope = 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)))
    return radius, slope


# Nearer to the axis than this (as tan of the angle) the ratio theta_d / r equals its limit 1/z to the last bit.
_ON_AXIS = 1e-9


def _distort_equidistant(parameters: Floats, points: Floats) -> Floats:
    radius = np.hypot(points[..., 0], points[..., 1])
    theta_d, _ = _equidistant_radius(parameters, np.arctan2(radius, points[..., 2]))
    near = radius < _ON_AXIS * np.abs(points[..., 2])
    limit = np.where(points[..., 2] > 0, 1 / np.where(points[..., 2] == 0, 1, points[..., 2]), np.nan)
    ratio = np.where(near, limit, theta_d / np.where(near, 1.0, radius))
    return points[..., :2] * ratio[..., None]


def _fill_equidistant(
    parameters: Floats,
    points: Floats,
    by_distortion: Sequence[Floats | None],
    by_point: Floats,
    focal_x: Floats,
    focal_y: Floats,
) -> tuple[Floats, Floats]:
    x, y, z = points
    radius = np.hypot(x, y)
    near = radius < _ON_AXIS * np.abs(z)
    safe = np.where(near, 1.0, radius)
    angle = np.arctan2(radius, z)
    theta_d, slope = _equidistant_radius(np.moveaxis(parameters, 0, -1), angle)
    cosine, sine = np.where(near, 1.0, x / safe), np.where(near, 0.0, y / safe)
    norm_square = radius * radius + z * z
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(near, np.where(z > 0, 1 / z, np.nan), theta_d / safe)
    by_radius = slope * z / norm_square
    by_point[0, 0] = focal_x * (by_radius * cosine**2 + ratio * sine**2)
    by_point[1, 1] = focal_y * (by_radius * sine**2 + ratio * cosine**2)
    mixed = (by_radius - ratio) * cosine * sine
    by_point[1, 0], by_point[0, 1] = focal_x * mixed, focal_y * mixed
    by_point[2, 0] = -focal_x * slope * x / norm_square
    by_point[2, 1] = -focal_y * slope * y / norm_square
    power = np.where(near, 0.0, angle)
    for row in by_distortion[:4]:
        power = power * angle * angle
        if row is not None:
            row[0], row[1] = focal_x * cosine * power, focal_y * sine * power
    return x * ratio, y * ratio


def _ray_equidistant(parameters: Floats, distorted: Floats) -> Floats:
    radius = np.linalg.norm(distorted, axis=-1)
    angle = np.minimum(radius, np.pi)
    for _ in range(_NEWTON_STEPS):
        value, slope = _equidistant_radius(parameters, angle)
        error = value - radius
        if np.nanmax(np.abs(error), initial=0.0) < _CONVERGED:
            break
        angle = angle - error / slope
    value, slope = _equidistant_radius(parameters, angle)
    found = (np.abs(value - radius) < _NEWTON_TOLERANCE) & (slope > 0) & (angle >= 0) & (angle <= np.pi)
    angle = np.where(found, angle, np.nan)
    unit = distorted / np.where(radius == 0, 1.0, radius)[..., None]
    return np.concatenate([unit * np.sin(angle)[..., None], np.cos(angle)[..., None]], axis=-1)
