"""What edges and corners look like through a blurred lens, and the damped steps that fit them."""

import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask, Picture, Singles

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
# what the best picture can tell.
_SETTLED = 3e-3
_BLUR_SETTLED = 0.05
# Grey levels of noise below which residuals are those of the model: rounding to whole levels alone leaves 0.29.
LEAST_NOISE = 0.3


def soft_step(distance: Singles, blur: Singles) -> tuple[Singles, Singles, Singles]:
    """A step from 0 to 1 under a Gaussian blur and the square of a pixel, with its slopes by distance and blur."""
    from scipy.special import ndtr

    if np.min(blur, initial=np.inf) > _PIXEL_IS_SMALL:
        wide: Singles = np.sqrt(blur * blur + np.float32(1 / 12))
        scaled = distance / wide
        slope: Singles = _bell(scaled) / wide
        share: Singles = blur / wide
        return ndtr(scaled), slope, -scaled * slope * share
    upper, lower = (distance + 0.5) / blur, (distance - 0.5) / blur
    cdf_upper, cdf_lower = ndtr(upper), ndtr(lower)
    pdf_upper, pdf_lower = _bell(upper), _bell(lower)
    value = blur * (upper * cdf_upper + pdf_upper - lower * cdf_lower - pdf_lower)
    return value, cdf_upper - cdf_lower, pdf_upper - pdf_lower


def _bell(x: Singles) -> Singles:
    return np.exp(-0.5 * x * x) * np.float32(0.3989422804014327)


def grey_at(image: Picture, columns: Ints, rows: Ints) -> tuple[Singles, Mask]:
    """Grey values at whole pixels, and which of them lie in the image."""
    height, width = image.shape
    inside = (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
    return image[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)].astype(np.float32), inside


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


def settled(places: Floats, log_blur: Floats) -> Mask:
    """Which fits have come to rest, in place and, roughly, in blur: their noise is judged later."""
    return (np.max(np.abs(places), axis=1) < _SETTLED) & (np.abs(log_blur) < _BLUR_SETTLED)


def weighted_mean(values: Singles, weight: Singles) -> Singles:
    """Mean (N,) of values (N, P)."""
    return np.sum(values * weight, axis=1) / np.maximum(weight.sum(axis=1), 1e-9)
