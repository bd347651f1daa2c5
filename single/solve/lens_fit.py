"""Maximum likelihood of one lens and the poses of the Views it took: any lens model, analytic derivatives."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.common_error import stacked_common, whitened
from quadrig.single.damping import MOST_DAMPING, Damping, gain
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import LENS_PARAMETERS, Intrinsics, project_with_derivatives
from quadrig.single.pose import Pose
from quadrig.single.rotation import cross_matrix

_MOST_STEPS = 100
# A step that promises less than this (in units of sigma^2) moves the answer by a ten-thousandth of its own sigma.
_CONVERGED = 1e-8
_FIRST_DAMPING = 1e-4


@dataclass(frozen=True, eq=False)
class LensFit:
    """One lens and the poses of V Views at their maximum of likelihood.

    lens_covariance (9, 9) in the order of LENS_PARAMETERS, zero for what was not free; camera_from_rects: a batch
    (V); pose_covariance (V, 6, 6) of their steps and lens_pose_covariance (V, 9, 6), for noise of the sigma given;
    residuals: (P, 2) px of each View; chi2 over sigma^2, the priors' included; dof; converged.
    """

    intrinsics: Intrinsics
    lens_covariance: Floats
    camera_from_rects: Pose
    pose_covariance: Floats
    lens_pose_covariance: Floats
    residuals: tuple[Floats, ...]
    chi2: float
    dof: int
    converged: bool


def fit_lens(
    points: Sequence[Floats],
    pixels: Sequence[Floats],
    intrinsics: Intrinsics,
    camera_from_rects: Pose,
    free: Sequence[str],
    sigma: Sequence[float] | float = 1.0,
    prior_sigma: Mapping[str, float] | None = None,
    common: Sequence[Floats | None] | None = None,
) -> LensFit:
    """Least squares over all points of all Views, from a start.

    points: for each of V Views (P, 3) metres in the rectangle's frame; pixels: (P, 2); intrinsics and
    camera_from_rects (a batch (V)): the start; free: names of LENS_PARAMETERS to estimate, the others stay; sigma:
    standard deviation of a pixel coordinate, one for all Views or one for each; prior_sigma: standard deviations of
    priors on free parameters, about the start; common: for each View the error (P, 2) px that its pixels share beside
    sigma, or None.
    Raises QuadrigError where a name is unknown or there are fewer coordinates than unknowns.
    """
    prior = dict(prior_sigma or {})
    for name in (*free, *prior):
        if name not in LENS_PARAMETERS:
            raise QuadrigError(f"no lens parameter is called {name!r}; choose among {', '.join(LENS_PARAMETERS)}")
    problem = _problem(points, pixels, intrinsics, free, sigma, prior)
    if common is not None:
        shared = stacked_common(common, problem.sigma, problem.seen.shape[1]) * problem.seen[..., None]
        problem = replace(problem, common=shared)
    dof = 2 * int(problem.seen.sum()) + len(prior) - len(free) - 6 * len(points)
    if dof < 0:
        raise QuadrigError(
            f"{int(problem.seen.sum())} points cannot determine {len(free)} lens parameters and {len(points)} poses; "
            "free fewer parameters, or give more points"
        )
    with np.errstate(all="ignore"):
        lens, poses, chi2, converged = _search(problem, intrinsics.parameters, camera_from_rects)
        lens_covariance, pose_covariance, cross = _covariances(problem, lens, poses)
        residuals, *_ = _linearised(replace(problem, common=np.zeros_like(problem.common)), lens, poses)
    unscaled = residuals * problem.sigma[:, None, None]
    return LensFit(
        intrinsics.with_parameters(lens),
        lens_covariance,
        poses,
        pose_covariance,
        cross,
        tuple(unscaled[i, : len(p)] for i, p in enumerate(pixels)),
        chi2,
        dof,
        converged,
    )


@dataclass(frozen=True, eq=False)
class _LensViews:
    """points (V, P, 3) and pixels (V, P, 2), seen (V, P) where they are no padding, sigma (V), free: indices of the
    lens parameters; common (V, P, 2): what the pixels of a View share, over sigma; prior_mean and prior_weight (9):
    one over the variance, zero where there is no prior."""

    points: Floats
    pixels: Floats
    seen: Mask
    sigma: Floats
    common: Floats
    free: Ints
    prior_mean: Floats
    prior_weight: Floats
    intrinsics: Intrinsics


def _problem(
    points: Sequence[Floats],
    pixels: Sequence[Floats],
    intrinsics: Intrinsics,
    free: Sequence[str],
    sigma: Sequence[float] | float,
    prior: Mapping[str, float],
) -> _LensViews:
    most = max((len(p) for p in pixels), default=0)
    padded_points, padded_pixels = np.zeros((len(points), most, 3)), np.zeros((len(points), most, 2))
    seen = np.zeros((len(points), most), bool)
    for i, (p, x) in enumerate(zip(points, pixels, strict=True)):
        known = np.all(np.isfinite(x), axis=-1)
        padded_points[i, : len(p)], padded_pixels[i, : len(x)] = p, np.where(known[:, None], x, 0.0)
        seen[i, : len(x)] = known
    weight = np.zeros(9)
    for name, value in prior.items():
        weight[LENS_PARAMETERS.index(name)] = value**-2
    return _LensViews(
        padded_points,
        padded_pixels,
        seen,
        np.broadcast_to(np.asarray(sigma, float), (len(points),)),
        np.zeros_like(padded_pixels),
        np.array([LENS_PARAMETERS.index(name) for name in free], int),
        intrinsics.parameters,
        weight,
        intrinsics,
    )


def _linearised(problem: _LensViews, lens: Floats, poses: Pose) -> tuple[Floats, Floats, Floats]:
    """Residuals (V, P, 2), derivatives of the pixels by the free lens parameters (V, P, 2, n) and by the pose steps
    (V, P, 2, 6), all over sigma and freed of what a View's pixels share; zero where unseen."""
    rotated = problem.points @ np.swapaxes(poses.rotation, -1, -2)
    seen, by_lens, by_point = project_with_derivatives(
        lens, rotated + poses.translation[:, None], problem.intrinsics.model
    )
    by_pose = np.concatenate([-by_point @ cross_matrix(rotated), by_point], axis=-1)
    scale = 1 / problem.sigma[:, None, None]
    unseen = ~problem.seen
    residuals = (problem.pixels - seen) * scale
    lens_rows, pose_rows = by_lens[..., problem.free] * scale[..., None], by_pose * scale[..., None]
    residuals[unseen], lens_rows[unseen], pose_rows[unseen] = 0, 0, 0
    if not problem.common.any():
        return residuals, lens_rows, pose_rows
    common = problem.common
    return whitened(residuals, common), whitened(lens_rows, common), whitened(pose_rows, common)


def _chi2(problem: _LensViews, lens: Floats, residuals: Floats) -> float:
    prior = float((problem.prior_weight * (lens - problem.prior_mean) ** 2).sum())
    return float((residuals * residuals).sum()) + prior


def _blocks(problem: _LensViews, lens_rows: Floats, pose_rows: Floats) -> tuple[Floats, Floats, Floats]:
    """Blocks of the normal matrix: lens (n, n) with its priors, mixed (V, n, 6), poses (V, 6, 6)."""
    views = len(lens_rows)
    A = lens_rows.reshape(views, 2 * lens_rows.shape[1], len(problem.free))
    B = pose_rows.reshape(views, 2 * pose_rows.shape[1], 6)
    A_t = np.swapaxes(A, -1, -2)
    own = (A_t @ A).sum(axis=0) + np.diag(problem.prior_weight[problem.free])
    return own, A_t @ B, np.swapaxes(B, -1, -2) @ B


def _search(problem: _LensViews, lens: Floats, poses: Pose) -> tuple[Floats, Pose, float, bool]:
    residuals, lens_rows, pose_rows = _linearised(problem, lens, poses)
    chi2, damping = _chi2(problem, lens, residuals), Damping.of(_FIRST_DAMPING)
    for _ in range(_MOST_STEPS):
        own, mixed, pose_blocks = _blocks(problem, lens_rows, pose_rows)
        flat = residuals.reshape(len(residuals), -1, 1)
        pull = problem.prior_weight * (problem.prior_mean - lens)
        lens_gradient = np.einsum("vpci,vpc->i", lens_rows, residuals) + pull[problem.free]
        pose_gradient = (np.swapaxes(pose_rows.reshape(*flat.shape[:2], 6), -1, -2) @ flat)[..., 0]
        lens_step, pose_step = _step(own, mixed, pose_blocks, lens_gradient, pose_gradient, float(damping.value))
        promised = float(lens_gradient @ lens_step + (pose_gradient * pose_step).sum())
        new_lens = lens.copy()
        new_lens[problem.free] += lens_step
        new_poses = poses.retract(pose_step)
        candidate = _linearised(problem, new_lens, new_poses)
        new_chi2 = _chi2(problem, new_lens, candidate[0])
        gained = gain(chi2, new_chi2, promised)
        if gained > 0 and new_lens[0] > 0:
            lens, poses, chi2 = new_lens, new_poses, new_chi2
            residuals, lens_rows, pose_rows = candidate
        if 0 <= promised < _CONVERGED:
            return lens, poses, chi2, True
        damping = damping.after(gained)
        if damping.value > MOST_DAMPING or not np.isfinite(chi2):
            break
    return lens, poses, chi2, False


def _step(
    own: Floats, mixed: Floats, pose_blocks: Floats, lens_gradient: Floats, pose_gradient: Floats, damping: float
) -> tuple[Floats, Floats]:
    """Step of the lens (n) and of the poses (V, 6), the poses eliminated first (Schur complement)."""
    damped = pose_blocks + damping * pose_blocks * np.eye(6)
    solved = np.linalg.solve(damped, np.concatenate([np.swapaxes(mixed, -1, -2), pose_gradient[..., None]], axis=-1))
    reduced = own + damping * np.diag(np.diag(own)) - (mixed @ solved[..., :-1]).sum(axis=0)
    right = lens_gradient - (mixed @ solved[..., -1:])[..., 0].sum(axis=0)
    lens_step = np.linalg.solve(reduced, right) if len(own) else right
    return lens_step, solved[..., -1] - solved[..., :-1] @ lens_step


def _covariances(problem: _LensViews, lens: Floats, poses: Pose) -> tuple[Floats, Floats, Floats]:
    """Of the lens (9, 9), of each pose (V, 6, 6), and between lens and pose (V, 9, 6)."""
    _, lens_rows, pose_rows = _linearised(problem, lens, poses)
    own, mixed, pose_blocks = _blocks(problem, lens_rows, pose_rows)
    inverse = np.linalg.inv(pose_blocks)
    gain = inverse @ np.swapaxes(mixed, -1, -2)
    lens_inner = np.linalg.inv(own - (mixed @ gain).sum(axis=0)) if len(own) else own
    gain_t = np.swapaxes(gain, -1, -2)
    lens_covariance, cross = np.zeros((9, 9)), np.zeros((len(mixed), 9, 6))
    lens_covariance[np.ix_(problem.free, problem.free)] = lens_inner
    cross[:, problem.free] = -lens_inner @ gain_t
    return lens_covariance, inverse + gain @ lens_inner @ gain_t, cross
