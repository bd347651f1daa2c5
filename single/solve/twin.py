"""The mirror twin of a planar pose: the other tilt that shows nearly the same picture where the view is weak."""

from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats, Mask
from quadrig.single.pose import Pose
from quadrig.single.solve.pinhole_fit import Guess, fit_pinhole

# Rotations nearer than this (rad) are one optimum: searches stop a ten-thousandth of a sigma from it, and two optima
# that close would be one under any noise.
_SAME = 1e-3


@dataclass(frozen=True, eq=False)
class Twins:
    """Both candidates of a planar pose for a given focal, the likelier first.

    camera_from_rect: a batch (..., 2); chi2 (..., 2): sums of squares over sigma^2; covariance (..., 2, 6, 6) of the
    step of camera_from_rect; converged (..., 2). Where perspective is so strong that the other tilt is no optimum at
    all, there is no twin: both poses are the one there is and the second chi2 is infinite.
    """

    camera_from_rect: Pose
    chi2: Floats
    covariance: Floats
    converged: Mask

    @property
    def exists(self) -> Mask:
        """Whether there is a twin (...)."""
        return np.isfinite(self.chi2[..., 1])

    @property
    def log_likelihood_ratio(self) -> Floats:
        """By how much (...) the first is preferred: ln of its likelihood over its twin's."""
        # Where neither is a pose at all, nothing is preferred.
        with np.errstate(invalid="ignore"):
            return 0.5 * (self.chi2[..., 1] - self.chi2[..., 0])

    @property
    def certainty(self) -> Floats:
        """Probability (...) of the first, both tilts being equally likely beforehand."""
        return 1 / (1 + np.exp(-self.log_likelihood_ratio))


def mirrored(camera_from_rect: Pose) -> Pose:
    """The pose (...) whose tilt is mirrored about the line of sight to the rectangle's middle.

    Exact where there is no perspective within the rectangle (Schweighofer and Pinz, PAMI 2006); elsewhere the start
    from which the twin is found.
    """
    sight = camera_from_rect.translation / np.linalg.norm(camera_from_rect.translation, axis=-1, keepdims=True)
    reflect = np.eye(3) - 2 * sight[..., :, None] * sight[..., None, :]
    return Pose(reflect @ camera_from_rect.rotation @ np.diag([1.0, 1.0, -1.0]), camera_from_rect.translation)


def twin_poses(
    points: Floats,
    pixels: Floats,
    focal: Floats | float,
    principal_point: Floats,
    start: Pose,
    sigma: Floats | float = 1.0,
    principal_point_sigma: float = 0.0,
) -> Twins:
    """Both local optima of the pose for a known focal, each at its maximum of likelihood.

    points (..., P, 2 or 3) metres, pixels (..., P, 2) nan where unseen, focal (...) px, principal_point (..., 2) px,
    start: either pose, a batch (...).
    """
    pixels = np.asarray(pixels, float)
    batch = pixels.shape[:-2]
    other = mirrored(start)
    both = Pose(
        np.stack(np.broadcast_arrays(start.rotation, other.rotation), axis=-3),
        np.stack(np.broadcast_arrays(start.translation, other.translation), axis=-2),
    )
    fit = fit_pinhole(
        _twice(points, batch, 2),
        np.broadcast_to(pixels[..., None, :, :], (*batch, 2, *pixels.shape[-2:])),
        Guess(_twice(focal, batch, 0), both),
        _twice(principal_point, batch, 1),
        _twice(sigma, batch, 0),
        principal_point_sigma,
        focal_known=True,
    )
    chi2 = np.where(np.isfinite(fit.chi2), fit.chi2, np.inf)
    rotation = fit.camera_from_rect.rotation
    apart = np.abs(rotation[..., 0, :, :] - rotation[..., 1, :, :]).max(axis=(-1, -2)) > _SAME
    chi2[..., 1] = np.where(apart, chi2[..., 1], np.inf)
    order = np.argsort(chi2, axis=-1, kind="stable")
    return Twins(
        Pose(
            np.take_along_axis(fit.camera_from_rect.rotation, order[..., None, None], axis=-3),
            np.take_along_axis(fit.camera_from_rect.translation, order[..., None], axis=-2),
        ),
        np.take_along_axis(chi2, order, axis=-1),
        np.take_along_axis(fit.covariance[..., 3:, 3:], order[..., None, None], axis=-3),
        np.take_along_axis(fit.converged, order, axis=-1),
    )


def _twice(value: Floats | float, batch: tuple[int, ...], tail: int) -> Floats:
    """The value with an axis of its two candidates after its batch; what all members share stays as it is."""
    value = np.asarray(value, float)
    if value.ndim <= tail:
        return value
    value = np.broadcast_to(value, (*batch, *value.shape[value.ndim - tail :]))
    return np.expand_dims(value, len(batch))
