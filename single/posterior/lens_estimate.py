"""What Views of one camera say of its lens and of their poses, in the mean over all that they leave open.

The focal, along which a weak View's likelihood is no parabola, is a grid; at each of its nodes lens and poses are
fitted, and around each fit the classes of lenses, the noise, and the mirrored tilts are averaged over by their
evidence (Laplace's method; MacKay, Information Theory, 27 and 28).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import LensModel, unproject
from quadrig.single.lens_prior import LensClasses, lens_classes, usual_focal
from quadrig.single.pose import Pose
from quadrig.single.posterior.lens_fit import (
    LensFits,
    LensLikelihood,
    LensViews,
    fit_lenses,
    fits_at,
    joined,
    residuals_of,
)
from quadrig.single.posterior.noise import EXPECTED_WEIGHT, noise_of
from quadrig.single.posterior.tilt_prior import log_tilt_density
from quadrig.single.solve.corners import REASON_WORDS, Reason
from quadrig.single.solve.planar_pose import planar_poses

# Focals to begin from beside those of the corners, as shares of the usual one: from a wide lens to a long one.
_FIRST_FOCALS = np.array([0.5, 1.0, 2.0])
# Nodes of the focal around each mode, in its sigmas, and over all that lenses have, in theirs.
_NODES = np.array([-4.5, -3.5, -2.75, -2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 2.75, 3.5, 4.5])
_COARSE_NODES = 0.44 * np.arange(-3.0, 3.5, 0.5)
# Nodes nearer than this share of a mode's sigma are one.
_SAME_NODE = 0.2
# Modes this much less likely (ln of the ratio) are none.
_IMPROBABLE = 15.0
# Nodes of the logarithm of the noise, in its own sigmas, and their weights: Gauss and Hermite's of five.
_QUANTILES = np.array([0.025, 0.5, 0.975])
# A density that rises by less than this share from node to node is flat, to the last bits that its integral needs.
_FLAT = 1e-4
_NOISE_NODES, _NOISE_WEIGHTS = np.polynomial.hermite_e.hermegauss(5)


@dataclass(frozen=True, eq=False)
class LensPrior:
    """What is known of a lens before its Views: size of its pictures, px; focal where it is given; held (9,): which
    parameters are known to be those of lens (9,), to a sigma (9,); its model."""

    image_size: tuple[int, int]
    focal: float | None
    held: Mask
    lens: Floats
    sigma: Floats
    model: LensModel = "pinhole"

    @property
    def fixed(self) -> Mask:
        """Which parameters (9,) are known exactly."""
        return (self.held & (self.sigma == 0)) | np.array([self.focal is not None, *[False] * 8])

    @property
    def side(self) -> float:
        """Of the picture, the larger one, px."""
        return float(max(self.image_size))

    def classes(self, focal: Floats) -> LensClasses:
        """The mixture for lenses of these focals (C,) px."""
        every = lens_classes(
            [self.image_size] * len(focal),
            focal,
            [self.model for _ in focal],
            own_focals=True,
            cropped=not self.held[1],
        )
        return every.held(self.held, self.lens, self.sigma)


@dataclass(frozen=True, eq=False)
class LensEstimate:
    """A lens (9,) and the poses camera_from_rects, a batch (V), of its Views, and the doubt of both.

    lens_covariance (9, 9), pose_covariance (V, 6, 6) of the poses' steps, lens_pose_covariance (V, 9, 6): second
    moments about them. focal_interval: the 95 % interval, px. residuals (V, P, 2) px; noise: by how much it exceeds
    the Views' own sigma; chi2 over that sigma, and freedom, the degrees of freedom it has. classes: of lenses, as the
    Views weigh them; shape (S,): as LensViews has it.
    """

    lens: Floats
    camera_from_rects: Pose
    lens_covariance: Floats
    pose_covariance: Floats
    lens_pose_covariance: Floats
    focal_interval: tuple[float, float]
    residuals: Floats
    noise: float
    chi2: float
    freedom: float
    classes: LensClasses
    shape: Floats

    @property
    def unusual(self) -> float:
        """How likely it is a lens of no usual kind, or a part of another picture."""
        return float(self.classes.unusual()[0])


def estimate_lens(views: LensViews, prior: LensPrior, first_focals: Sequence[float] = ()) -> LensEstimate:
    """The posterior of a lens and of the poses of its Views. first_focals: px, to begin from beside the usual ones.

    Raises QuadrigError where no lens and poses fit at all.
    """
    modes, noise, freedom = _modes(views, prior, first_focals)
    views = views.noisier(noise)
    modes = _fitted(views, prior, modes, prior.classes(modes.lens[:, 0]))
    weighed = _weighed(prior, modes)
    modes = _fitted(views, prior, modes, weighed)
    rows = _likely(modes, weighed)
    focals = _nodes(prior, modes[rows], weighed.gaussian()[1][rows])
    fits, apart = _components(views, prior, modes[rows], focals)
    after = _posterior(views, prior, fits, apart, focals, noise, freedom)
    return _summary(views, prior, fits, after, noise, freedom)


def expected_sigma(
    views: LensViews,
    found: LensEstimate,
    prior: LensPrior,
    camera_from_rects: Pose,
    *,
    centre_known: bool = False,
    distortion_known: bool = False,
) -> float:
    """The sigma of the focal, px, that the same points would leave at other poses (V)."""
    fits = fits_at(views.noisier(found.noise), found.lens[None], found.shape[None], camera_from_rects[None])
    classes = replace(prior.classes(found.lens[:1]), weight=found.classes.weight)
    whole = fits.likelihood().information[0] + classes.gaussian()[1][0]
    open_ = np.array([True, *[not centre_known] * 2, *[not distortion_known] * 5, True])
    return float(np.sqrt(np.linalg.inv(whole[np.ix_(open_, open_)])[0, 0]))


def _fitted(views: LensViews, prior: LensPrior, start: LensFits, classes: LensClasses) -> LensFits:
    return fit_lenses(views, start.lens, start.shape, start.camera_from_rects, ~prior.fixed, *classes.gaussian())


def _modes(views: LensViews, prior: LensPrior, first_focals: Sequence[float]) -> tuple[LensFits, float, float]:
    """Fits from several focals and both tilts of a single View; by how much the noise exceeds the Views' sigma, of
    the best of them; and its degrees of freedom."""
    focals = np.array([prior.focal])
    if prior.focal is None:
        usual = usual_focal(np.array([prior.side]), [prior.model])
        focals = np.concatenate([usual * _FIRST_FOCALS, np.asarray(first_focals, float)])
    mean, information = prior.classes(focals).gaussian()
    lens = mean.copy()
    lens[:, 3:8] = 0.0
    lens = np.where(prior.fixed, prior.lens, lens)
    lens[:, 0] = focals
    poses, _ = _both_poses(views, lens)
    tilts = 2 if len(views.sigma) == 1 else 1
    lens, mean, information = (np.repeat(values, tilts, axis=0) for values in (lens, mean, information))
    rotation = np.swapaxes(poses.rotation[:, :, :tilts], 1, 2).reshape(len(lens), -1, 3, 3)
    start = Pose(rotation, np.swapaxes(poses.translation[:, :, :tilts], 1, 2).reshape(len(lens), -1, 3))
    shape = np.zeros((len(lens), views.shapes))
    fits = fit_lenses(views, lens, shape, start, ~prior.fixed, mean, information)
    off = fits.lens - mean
    cost = fits.chi2 + np.einsum("mi,mij,mj->m", off, information, off)
    best = int(np.argmin(np.where(np.isfinite(cost), cost, np.inf)))
    if not np.isfinite(cost[best]):
        raise QuadrigError(REASON_WORDS[Reason.NO_CONVERGENCE])
    own = fits.likelihood().information[best]
    shown = float(np.trace(np.linalg.solve(own + information[best], own)))
    freedom = max(views.coordinates - 6 * len(views.sigma) - shown, 0.0)
    return fits, noise_of(float(fits.chi2[best]), freedom, 1.0), freedom


def _both_poses(views: LensViews, lens: Floats) -> tuple[Pose, Floats]:
    """Both tilts (M, V, 2) of every View under each lens (M, 9), the better first, and their errors (M, V, 2) as
    PlanarPoses has them."""
    # A pixel past the fold of a lens has no ray: one without distortion is near enough to begin from.
    undistorted = np.where(np.arange(9) < 3, lens, np.arange(9) == 8)
    rays, plain = (unproject(at[:, None, None], views.pixels, views.model) for at in (lens, undistorted))
    found = planar_poses(views.points, np.where(np.isfinite(rays), rays, plain), views.seen.astype(float))
    return found.camera_from_rect, found.errors


def _weighed(prior: LensPrior, fits: LensFits) -> LensClasses:
    """The classes as the data at each fit weigh them."""
    classes = prior.classes(fits.lens[:, 0])
    seen = fits.likelihood()
    return replace(classes, weight=classes.posterior(fits.lens, seen.pull, seen.information).weight)


def _likely(modes: LensFits, classes: LensClasses) -> Ints:
    """Which modes are not out of the question, each once, the likeliest first."""
    mean, information = classes.gaussian()
    off = modes.lens - mean
    cost = modes.chi2 + np.einsum("mi,mij,mj->m", off, information, off)
    kept: list[int] = []
    for m in np.argsort(cost):
        # To a thousandth one focal is another's: a fit stops nearer to its end than that.
        known = any(abs(modes.lens[m, 0] / modes.lens[k, 0] - 1) < 1e-3 for k in kept)
        if cost[m] - np.nanmin(cost) < 2 * _IMPROBABLE and not known:
            kept.append(int(m))
    return np.array(kept)


def _nodes(prior: LensPrior, modes: LensFits, information: Floats) -> Floats:
    """Focals (G,) px that resolve every mode, and cover what lenses have."""
    if prior.focal is not None:
        return np.array([prior.focal])
    focal = modes.lens[:, 0]
    sigma = np.sqrt(np.linalg.inv(modes.likelihood().information + information)[:, 0, 0]) / focal
    usual = np.log(usual_focal(np.array([prior.side]), [prior.model])[0])
    nodes = list(usual + _COARSE_NODES)
    # The sharpest mode's nodes are not to be crowded out by those of another.
    for m in np.argsort(-sigma):
        around = np.log(focal[m]) + sigma[m] * _NODES
        nodes = [n for n in nodes if np.abs(around - n).min() > _SAME_NODE * sigma[m]] + list(around)
    return np.exp(np.sort([n for n in nodes if n > min(usual + _COARSE_NODES[0], np.log(focal.min())) - 1e-9]))


def _components(views: LensViews, prior: LensPrior, modes: LensFits, focals: Floats) -> tuple[LensFits, Floats]:
    """Fits of (1 + F) G components: at each of G focals one, and F with the tilt of one View mirrored; and the share
    (1 + F, G) of each of the latter that is no second count of the first."""
    nearest = np.abs(np.log(focals)[:, None] - np.log(modes.lens[:, 0])).argmin(axis=1)
    start = modes.lens[nearest].copy()
    if views.model == "pinhole":
        # The same bend in the picture; a fisheye's is one of angles.
        start[:, [3, 4, 7]] *= (focals / start[:, 0])[:, None] ** np.array([2.0, 4.0, 6.0])
    start[:, 0] = focals
    free = ~prior.fixed & (np.arange(9) > 0)
    classes, start_poses = prior.classes(focals).at_focals(focals)[1], _both_poses(views, start)[0][:, :, 0]
    base = fit_lenses(views, start, modes.shape[nearest], start_poses, free, *classes.gaussian())
    seen = base.likelihood()
    weight = classes.posterior(base.lens, *_without_focal(seen)).weight
    mean, information = replace(classes, weight=weight).gaussian()
    base = fit_lenses(views, base.lens, base.shape, base.camera_from_rects, free, mean, information)
    poses, errors = _both_poses(views, base.lens)
    with np.errstate(invalid="ignore"):
        errors = errors[..., 1] ** 2 - errors[..., 0] ** 2
    gap = views.seen.sum(axis=1) * (focals[:, None] / views.sigma) ** 2 * errors
    # The closed form's own error overstates what a twin costs.
    views_with_twin = np.flatnonzero((gap < 8 * _IMPROBABLE).any(axis=0))
    parts, apart = [base], [np.ones(len(focals))]
    for view in views_with_twin:
        rotation, translation = base.camera_from_rects.rotation.copy(), base.camera_from_rects.translation.copy()
        turned = np.abs(poses.rotation[:, view] - rotation[:, view, None]).max(axis=(-1, -2)).argmax(axis=1)
        rows = np.arange(len(focals))
        rotation[:, view], translation[:, view] = (
            poses.rotation[rows, view, turned],
            poses.translation[rows, view, turned],
        )
        turned_poses = Pose(rotation, translation)
        parts.append(fit_lenses(views, base.lens, base.shape, turned_poses, free, mean, information))
        step = base.camera_from_rects[:, view].step_to(parts[-1].camera_from_rects[:, view])
        far = np.einsum("gi,gij,gj->g", step, np.linalg.inv(base.pose_covariance[:, view]), step)
        # Gaussians that overlap are one optimum, which Laplace's method would count twice.
        apart.append(-np.expm1(-far / 8))
    return joined(parts), np.array(apart)


@dataclass(frozen=True, eq=False)
class _Posterior:
    """C components under J noises: weight (C, J) of each, mean (C, J, 9) and covariance (C, J, 9, 9) of its lens.

    node (C,): whose focal it has; noise (J,): over that of the fits; kinds (K,): weights of the classes of lenses;
    quantiles (3,) of the focal, px: 2.5, 50 and 97.5 %.
    """

    weight: Floats
    mean: Floats
    covariance: Floats
    pose_gain: Floats
    pose_covariance: Floats
    node: Ints
    noise: Floats
    kinds: Floats
    quantiles: Floats


def _posterior(
    views: LensViews, prior: LensPrior, fits: LensFits, apart: Floats, focals: Floats, noise: float, freedom: float
) -> _Posterior:
    """noise: that of the fits over the Views' own sigma, known from so many degrees of freedom."""
    node = np.tile(np.arange(len(focals)), len(apart))
    log_density, classes = prior.classes(focals[node]).at_focals(focals[node])
    # The logarithm of a noise known from so many degrees of freedom has nearly this sigma.
    scales = np.exp(_NOISE_NODES / np.sqrt(2 * (freedom + EXPECTED_WEIGHT)))
    seen = [fits.likelihood(float(scale)) for scale in scales]
    parts = [classes.posterior(fits.lens, *_without_focal(one)) for one in seen]
    log = np.stack([part.log for part in parts], axis=1) + log_density[:, None]
    with np.errstate(divide="ignore"):
        log += np.log(apart.ravel())[:, None]
    evidence = [_log_evidence(views, fits, one, noise, float(scale)) for one, scale in zip(seen, scales, strict=True)]
    log += np.stack(evidence, axis=1) + np.log(_NOISE_WEIGHTS) + _NOISE_NODES**2 / 2
    log = np.where(np.isfinite(log), log, -np.inf)
    if not np.isfinite(log).any():
        raise QuadrigError(REASON_WORDS[Reason.NO_CONVERGENCE])
    weight = np.exp(log - log.max())
    density = np.asarray(np.bincount(node, weight.sum(axis=1), len(focals)), float)
    quantiles, width = _quantiles(focals, density)
    weight = weight * width[node][:, None]
    weight = weight / weight.sum()
    mean = np.stack([part.mean for part in parts], axis=1)
    covariance = np.stack([part.covariance for part in parts], axis=1)
    mean = np.where(prior.fixed, prior.lens, mean)
    mean[..., 0] = focals[node][:, None]
    known = prior.fixed | (np.arange(9) == 0)
    covariance[..., known, :], covariance[..., :, known] = 0, 0
    kinds = np.einsum("cj,cjk->k", weight, np.stack([part.weight for part in parts], axis=1))
    pose_gain = np.stack([one.pose_gain for one in seen], axis=1)
    pose_covariance = np.stack([one.pose_covariance for one in seen], axis=1)
    return _Posterior(weight, mean, covariance, pose_gain, pose_covariance, node, scales, kinds, quantiles)


def _without_focal(seen: LensLikelihood) -> tuple[Floats, Floats]:
    """Slope and information of a likelihood, the focal being known."""
    pull, information = seen.pull.copy(), seen.information.copy()
    pull[:, 0], information[:, 0], information[:, :, 0] = 0, 0, 0
    return pull, information


def _log_evidence(views: LensViews, fits: LensFits, seen: LensLikelihood, noise: float, scale: float) -> Floats:
    """Logarithm (C,) of the likelihood of each fit with its poses averaged over, where the noise is that of the fits
    times a scale, and of the density of the noise's logarithm."""
    count = len(views.sigma)
    log = seen.log - (views.coordinates - 6 * count) * np.log(scale)
    log = log + 0.5 * np.linalg.slogdet(fits.pose_covariance)[1].sum(axis=1)
    # A sheet may be anywhere in the picture and of any size in it, whatever the focal.
    place = fits.camera_from_rects.translation
    depth = place[..., 2] if views.model == "pinhole" else np.linalg.norm(place, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        log -= 3 * np.log(depth).sum(axis=1) - 2 * count * np.log(fits.lens[:, 0])
    log += log_tilt_density(fits.camera_from_rects, scale**2 * fits.pose_covariance[..., :3, :3])
    # Scaled inverse chi-square about the sigma that the Views claim.
    return log - EXPECTED_WEIGHT * (np.log(scale) + 0.5 / (noise * scale) ** 2)


def _quantiles(focals: Floats, density: Floats) -> tuple[Floats, Floats]:
    """Quantiles (3,), px, of a density of the focal's logarithm that is given at nodes (G), and what width (G) each
    node stands for. Between nodes the density is an exponential."""
    if len(focals) == 1:
        return np.repeat(focals, 3), np.ones(1)
    log, height = np.log(focals), np.log(np.maximum(density, 1e-300))
    step, rise = np.diff(log), np.diff(height)
    rise = np.where(np.abs(rise) < _FLAT, _FLAT, rise)
    # Integrals of exp(r t) (1 - t) and exp(r t) t, each over what the density is at the end where that is 1.
    left = step * (np.expm1(rise) - rise) / rise**2
    right = step * (np.expm1(-rise) + rise) / rise**2
    width = np.append(left, 0.0) + np.insert(right, 0, 0.0)
    mass = left * np.exp(height[:-1]) + right * np.exp(height[1:])
    total = np.insert(np.cumsum(mass), 0, 0.0)
    wanted = _QUANTILES * total[-1]
    piece = np.clip(np.searchsorted(total, wanted, side="right") - 1, 0, len(mass) - 1)
    part = (wanted - total[piece]) / np.maximum(mass[piece], 1e-300)
    along = np.log1p(part * np.expm1(rise[piece])) / rise[piece]
    return np.exp(log[piece] + along * step[piece]), width


def _summary(
    views: LensViews, prior: LensPrior, fits: LensFits, after: _Posterior, noise: float, freedom: float
) -> LensEstimate:
    low, focal, high = after.quantiles
    nodes = int(after.node.max()) + 1
    share = after.weight.sum(axis=1).reshape(-1, nodes)
    # The likelier tilt of each View, where it is nearest to the focal that is reported.
    row = int(share.sum(axis=1).argmax()) * nodes
    row += int(np.abs(np.log(fits.lens[:nodes, 0] / focal)).argmin())
    start, classes = fits.lens[row].copy(), prior.classes(np.array([focal])).at_focals(np.array([focal]))[1]
    start[0] = focal
    classes = replace(classes, weight=after.kinds[None])
    mean, information = classes.gaussian()
    rows = slice(row, row + 1)
    final = fit_lenses(
        views,
        start[None],
        fits.shape[rows],
        fits.camera_from_rects[rows],
        ~prior.fixed & (np.arange(9) > 0),
        mean,
        information,
    )
    lens, poses = final.lens[0], final.camera_from_rects[0]
    off = after.mean - lens
    step = poses.step_to(fits.camera_from_rects)[:, None] + np.einsum(
        "cjvpi,cji->cjvp", after.pose_gain, after.mean - fits.lens[:, None]
    )
    by_lens = after.pose_gain @ after.covariance[:, :, None]
    own = after.pose_covariance + by_lens @ np.swapaxes(after.pose_gain, -1, -2)
    own = own + step[..., :, None] * step[..., None, :]
    cross = np.swapaxes(by_lens, -1, -2) + off[:, :, None, :, None] * step[..., None, :]
    weight = after.weight
    # What is no fit at all has no weight, and may be no number.
    keep = weight.sum(axis=1) > 0
    weight, own, cross, off, spread = weight[keep], own[keep], cross[keep], off[keep], after.covariance[keep]
    lens_covariance = np.einsum("cj,cjik->ik", weight, spread + off[..., :, None] * off[..., None, :])
    scale = noise * float(np.sqrt((weight.sum(axis=0) * after.noise**2).sum()))
    return LensEstimate(
        lens,
        poses,
        lens_covariance,
        np.einsum("cj,cjvpq->vpq", weight, own),
        np.einsum("cj,cjviq->viq", weight, cross),
        (float(low), float(high)),
        residuals_of(views, lens, final.shape[0], poses),
        scale,
        float(final.chi2[0]) * noise**2,
        freedom,
        classes,
        final.shape[0],
    )
