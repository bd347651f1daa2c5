"""What edges and corners look like through a blurred lens, and the damped steps that fit them."""

import numpy as np

from quadrig.single.arrays import Floats, Mask, Reals, Singles

# Blur (px) that lenses and demosaicing leave, as logarithm with its spread: only where one row of pixels says
# nothing of the blur (an edge along a pixel row) does this prior decide.
USUAL_BLUR, BLUR_SPREAD = np.log(0.5), 0.7
# Bounds of the blur in px, which keep a failing fit from running off.
SHARPEST, SOFTEST = 0.1, 6.0
# What has not come to rest by then is no edge and no corner; nearly all do in four.
ITERATIONS = 8
# Blur (px) from which the pixel's square is as good as a little more blur of the same variance (to 0.002 px).
_PIXEL_IS_SMALL = 0.8
# Gauss-Newton ends when no place moved by more than this (px): what is then left is less by half or more, a tenth of
# the sigma of the best picture.
_SETTLED = 3e-3
_BLUR_SETTLED = 0.05
# The same where a finer fit follows.
_ROUGHLY_SETTLED = 0.1
# Grey levels of noise below which residuals are those of the model: rounding to whole levels alone leaves 0.29.
LEAST_NOISE = 0.3
# Coefficients of the tail of the normal distribution, the highest power first.
_TAIL = np.array([1.330274429, -1.821255978, 1.781477937, -0.356563782, 0.319381530], np.float32)
# Parts of an edge or a window that are taken as independent of each other: grain and JPEG tie neighbours together.
BLOCKS = 12
# Least share of one side's variance that the other has.
_UNEQUAL = 0.05


def soft_step(distance: Singles, blur: Singles) -> tuple[Singles, Singles, Singles]:
    """A step from 0 to 1 under a Gaussian blur and the square of a pixel, with its slopes by distance and blur."""
    if np.min(blur, initial=np.inf) > _PIXEL_IS_SMALL:
        wide: Singles = np.sqrt(blur * blur + np.float32(1 / 12))
        scaled = distance / wide
        value, density = standard_normal(scaled)
        slope: Singles = density / wide
        share: Singles = blur / wide
        return value, slope, -scaled * slope * share
    upper, lower = (distance + 0.5) / blur, (distance - 0.5) / blur
    (cdf_upper, pdf_upper), (cdf_lower, pdf_lower) = standard_normal(upper), standard_normal(lower)
    by_blur = pdf_upper - pdf_lower
    value = blur * (upper * cdf_upper - lower * cdf_lower + by_blur)
    return value.astype(np.float32, copy=False), cdf_upper - cdf_lower, by_blur


def standard_normal(x: Singles) -> tuple[Singles, Singles]:
    """Distribution and density of the standard normal, to 1e-7 (Abramowitz and Stegun 26.2.17): with one exponential
    for both, three times faster than scipy's distribution alone."""
    density = np.exp(np.float32(-0.5) * x * x)
    density *= np.float32(0.3989422804014327)
    t = np.abs(x)
    t *= np.float32(0.2316419)
    t += np.float32(1)
    np.reciprocal(t, out=t)
    beyond = np.full_like(t, _TAIL[0])
    for coefficient in _TAIL[1:]:
        beyond *= t
        beyond += coefficient
    beyond *= t
    beyond *= density
    return np.float32(0.5) + np.copysign(np.float32(0.5) - beyond, x), density


def damped_step(
    jacobian: Singles, residual: Singles, weight: Singles, prior: Floats, pull: Floats
) -> tuple[Floats, Floats]:
    """Step (N, K) and inverse normal matrix (N, K, K) of weighted least squares with prior precisions (N, K).

    jacobian (N, K, P), residual and weight (N, P).
    """
    weighted = jacobian * weight[:, None]
    normal = (weighted @ np.swapaxes(jacobian, -1, -2)).astype(float)
    index = np.arange(normal.shape[-1])
    normal[:, index, index] += prior + 1e-9 * normal[:, index, index] + 1e-12
    gradient = (weighted @ residual[..., None])[..., 0] + prior * pull
    inverse = np.linalg.pinv(normal, hermitian=True) if not np.isfinite(normal).all() else np.linalg.inv(normal)
    return (inverse @ gradient[..., None])[..., 0], inverse


def variance_of_sides(residual: Reals, share: Reals, weight: Reals, least: Reals, unknowns: int) -> Singles:
    """Variance (N, P) of light that runs from one side's to the other's with the share (N, P) of the other, 0 to 1.

    Ground with a grain, ink that a curve makes noisy: the two sides of an edge are seldom equally sure. least (N, 2):
    standard deviation of either that rounding alone leaves. residual, weight (N, P); unknowns: of the fit.
    """
    share = np.clip(share, 0, 1)
    used = np.sum(weight, axis=1)
    # What the fit has taken away of the residuals.
    lost = used / np.maximum(used - unknowns, 1)
    weighted, sides = weight * residual * residual, []
    for k, part in enumerate((1 - share, share)):
        part *= part
        mean = np.sum(part * weighted, axis=1) / np.maximum(np.sum(part * weight, axis=1), 1e-9)
        sides.append((np.sqrt(mean * lost) + least[:, k]) ** 2)
    low, high = (side[:, None].astype(np.float32) for side in sides)
    # A side of no noise at all would leave nothing to the other.
    low, high = np.maximum(low, _UNEQUAL * high), np.maximum(high, _UNEQUAL * low)
    return low + share * (high - low)


def block_sums(scores: Reals) -> Reals:
    """Sums (..., BLOCKS) of scores (..., P) over runs of neighbours."""
    return np.add.reduceat(scores, np.linspace(0, scores.shape[-1], BLOCKS, endpoint=False).astype(int), axis=-1)


def place_excess(jacobian: Singles, scores: Reals, inverse: Floats, places: slice) -> Floats:
    """Variance of fitted places (N,) over that which independent pixels would leave (White, 1980; by blocks).

    jacobian (N, K, P), scores (N, P): weight times residual, inverse normal matrix (N, K, K); places: among the K.
    """
    moved = inverse[:, places] @ block_sums(jacobian * scores[:, None])
    own = np.trace(inverse[:, places, places], axis1=1, axis2=2)
    # The fit itself has taken some of the blocks' freedom.
    return np.sum(moved**2, axis=(1, 2)) / own * (BLOCKS / (BLOCKS - moved.shape[1]))


def settled(places: Floats, log_blur: Floats, rough: bool = False) -> Mask:
    """Which fits have come to rest, in place and, roughly, in blur: their noise is judged later. rough: a finer fit
    follows."""
    rest = _ROUGHLY_SETTLED if rough else _SETTLED
    return (np.max(np.abs(places), axis=1) < rest) & (np.abs(log_blur) < _BLUR_SETTLED)


def weighted_mean(values: Singles, weight: Singles) -> Singles:
    """Mean (N,) of values (N, P)."""
    return np.sum(values * weight, axis=1) / np.maximum(weight.sum(axis=1), 1e-9)
