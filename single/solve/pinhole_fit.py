"""Maximum likelihood for many Views of one rectangle each, under a pinhole without distortion.

Levenberg and Marquardt's method in the coordinates of pinhole_model.py.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quadrig.single.arrays import Floats, Mask
from quadrig.single.damping import MOST_DAMPING, Damping, gain
from quadrig.single.pose import Pose
from quadrig.single.solve import batched_cholesky as triangular
from quadrig.single.solve.pinhole_model import (
    BLOCK,
    PinholeViews,
    covariances,
    derivatives,
    gradient_of,
    mirror_to_front,
    moved,
    normal_matrix,
    projection_of,
    rows,
    state_of,
)

# Most members are done within the first number; the few that are not go on together, up to the second, so that a
# block does not wait for its slowest member.
_FIRST_STEPS, _MOST_STEPS = 6, 60
# A step that promises to lower the sum of squares by less than this (in units of sigma^2) moves the answer by less
# than a thousandth of its own sigma; it is still taken.
_CONVERGED = 1e-6
_FIRST_DAMPING = 1e-6


@dataclass(frozen=True, eq=False)
class PinholeFit:
    """The most likely focal, principal point and pose of each member of a batch (...).

    focal (...) px, principal_point (..., 2) px, camera_from_rect, covariance (..., 9, 9) of (focal, cx, cy, step of
    camera_from_rect), zero for what was given as known; chi2 (...): sum of squares over sigma^2, that of the prior
    included; steps (...): iterations used; converged (...).
    """

    focal: Floats
    principal_point: Floats
    camera_from_rect: Pose
    covariance: Floats
    chi2: Floats
    steps: NDArray[np.int16]
    converged: Mask


@dataclass(frozen=True, eq=False)
class Guess:
    """Where a search starts: focal (...) px and camera_from_rect (...)."""

    focal: Floats
    camera_from_rect: Pose


def fit_pinhole(
    points: Floats,
    pixels: Floats,
    guess: Guess,
    principal_point: Floats,
    sigma: Floats | float = 1.0,
    principal_point_sigma: float = 0.0,
    focal_known: bool = False,
    photographed: bool = True,
) -> PinholeFit:
    """Least squares over all points from a guess.

    points (..., P, 2 or 3) metres in the rectangle's frame, on its plane; pixels (..., P, 2), nan where unseen;
    principal_point (..., 2) px with its prior standard deviation (0: known); sigma (...) px of a pixel coordinate;
    focal_known: keep the guess's focal. photographed: every point must stay in front of the camera.
    """
    pixels = np.asarray(pixels, float)
    batch, count = pixels.shape[:-2], pixels.shape[-2]
    members = int(np.prod(batch))
    start_focal = rows(guess.focal, batch, ())
    problem = PinholeViews(
        rows(np.asarray(points, float)[..., :2], batch, (count, 2)),
        rows(pixels, batch, (count, 2)),
        rows(principal_point, batch, (2,)),
        rows(sigma, batch, ()),
        principal_point_sigma,
        start_focal if focal_known else None,
        photographed,
    )
    state = state_of(start_focal, guess.camera_from_rect, problem.centre, batch)
    chi2, steps = np.full(members, np.nan), np.zeros(members, np.int16)
    waiting = np.arange(members)
    with np.errstate(all="ignore"):
        for limit in (_FIRST_STEPS, _MOST_STEPS - _FIRST_STEPS):
            for first in range(0, len(waiting), BLOCK):
                part = waiting[first : first + BLOCK]
                state[:, part], chi2[part], used = _search(problem.members(part), state[:, part], limit)
                steps[part] += used
                waiting[first : first + BLOCK] = np.where(used == limit, part, -1)
            waiting = waiting[waiting >= 0]
        mirror_to_front(state)
        covariance = covariances(problem, state)
    converged = np.isfinite(chi2)
    converged[waiting] = False
    return _fit_of(problem, state, covariance, chi2, steps, converged, batch)


def _fit_of(
    problem: PinholeViews,
    state: Floats,
    covariance: Floats,
    chi2: Floats,
    steps: NDArray[np.int16],
    converged: Mask,
    batch: tuple[int, ...],
) -> PinholeFit:
    u0, v0, s, kappa, cx, cy = state[:6]
    x, y = state[6:9].T, state[9:12].T
    rotation = np.stack([x, y, np.cross(x, y)], axis=-1)
    translation = np.stack([u0 / s, v0 / s, 1 / kappa], axis=-1)
    found = s / kappa if problem.focal is None else np.broadcast_to(problem.focal, s.shape).copy()
    return PinholeFit(
        found.reshape(batch),
        np.stack([cx, cy], axis=-1).reshape(*batch, 2),
        Pose(rotation.reshape(*batch, 3, 3), translation.reshape(*batch, 3)),
        covariance.reshape(*batch, 9, 9),
        chi2.reshape(batch),
        steps.reshape(batch),
        converged.reshape(batch),
    )


def _search(problem: PinholeViews, state: Floats, limit: int) -> tuple[Floats, Floats, NDArray[np.int16]]:
    """Levenberg and Marquardt's method, each member with its own damping; members leave as they converge.

    Returns states, chi2 and steps used: `limit` for those that have not converged (chi2 nan where nothing fits).
    """
    members = state.shape[1]
    chi2, steps = np.full(members, np.nan), np.full(members, limit, np.int16)
    final, active = state.copy(), np.arange(members)
    damping = Damping.of(np.full(members, _FIRST_DAMPING))
    projection = projection_of(problem, state)
    for used in range(1, limit + 1):
        J = derivatives(problem, state, projection)
        normal, gradient = normal_matrix(problem, J), gradient_of(problem, state, J, projection.residuals)
        diagonal = np.arange(len(J))
        normal[diagonal, diagonal] *= 1 + damping.value
        step = triangular.solve(triangular.cholesky(normal), gradient)
        promised = (step * gradient).sum(axis=0)
        small = promised < _CONVERGED
        new = moved(problem, state, step)
        new_projection = projection_of(problem, new)
        gained = gain(projection.chi2, new_projection.chi2, promised)
        better, damping = (gained > 0) | small, damping.after(gained)
        if better.all():
            state, projection = new, new_projection
        else:
            state = np.where(better, new, state)
            projection = projection_of(problem, state)
        leaving = small | ~(damping.value < MOST_DAMPING) | ~np.isfinite(projection.chi2)
        if leaving.any():
            gone = active[leaving]
            final[:, gone], chi2[gone], steps[gone] = state[:, leaving], projection.chi2[leaving], used
            stay = np.flatnonzero(~leaving)
            active, state = active[stay], state[:, stay]
            damping = Damping(damping.value[stay], damping.raised[stay])
            problem, projection = problem.members(stay), projection.members(stay)
            if not len(stay):
                break
    final[:, active], chi2[active], steps[active] = state, projection.chi2, limit
    return final, chi2, steps
