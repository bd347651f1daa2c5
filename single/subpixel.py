"""Where an edge, and where a corner of a board, lies to a fraction of a pixel.

Both are least-squares fits of a blurred step to the grey values themselves, at the centres of their pixels: nothing
is interpolated, so nothing is biased towards the pixel grid. Both fit many places of one image at once.
"""

from dataclasses import dataclass, fields

import numpy as np

from .rotation import Array

# Blur (px) that lenses and demosaicing leave, as logarithm with its spread: only where one row of pixels says
# nothing of the blur (an edge along a pixel row) does this prior decide.
_USUAL_BLUR, _BLUR_SPREAD = np.log(0.5), 0.7
# Bounds of the blur in px, which keep a failing fit from running off.
_SHARPEST, _SOFTEST = 0.1, 6.0
# Bow (px over half a side of 50 px) that a strong wide-angle lens gives a straight edge; it grows with the square.
_BOW = 0.5
# What has not come to rest by then is no edge and no corner; nearly all do in four.
_ITERATIONS = 8
# Blur (px) from which the pixel's square is as good as a little more blur of the same variance (to 0.002 px).
_PIXEL_IS_SMALL = 0.8
# Gauss-Newton ends when no place moved by more than this (px): what is then left is less by half or more, a tenth of
# what the best picture can tell.
_SETTLED = 3e-3
_BLUR_SETTLED = 0.05
# Grey levels: white that may have been cut off, and ink that at a good exposure is darker even in a gamma curve.
# Where both are passed, an unknown part of the step is missing, and its middle with it.
_CLIPPED, _LIGHT_INK = 252.0, 90.0
# Grey levels of noise below which residuals are those of the model: rounding to whole levels alone leaves 0.29.
_LEAST_NOISE = 0.3


@dataclass(frozen=True, eq=False)
class EdgeFit:
    """Sides of outlines: offset c0 + c1 u + c2 u^2 (px, along the normal) over u in [-1, 1] from start to end.

    coefficients (N, 3), covariance (N, 3, 3), noise (N,) grey levels, contrast (N,) grey levels from inside to
    outside, blur (N,) px, dark (N,) grey level of the inner side.
    """

    coefficients: Array
    covariance: Array
    noise: Array
    contrast: Array
    blur: Array
    dark: Array

    @property
    def washed_out(self) -> Array:
        """Which (N,) edges run between white that is clipped and a dark side that is light: they lie elsewhere."""
        lighter, darker = (
            np.maximum(self.dark, self.dark + self.contrast),
            np.minimum(self.dark, self.dark + self.contrast),
        )
        return (lighter > _CLIPPED) & (darker > _LIGHT_INK)


@dataclass(frozen=True, eq=False)
class CornerFit:
    """Board corners: pixels (N, 2), sigma (N,) px a coordinate, noise and contrast (N,) in grey levels, blur px."""

    pixels: Array
    sigma: Array
    noise: Array
    contrast: Array
    blur: Array

    def changed(self, index: Array, other: "CornerFit") -> "CornerFit":
        """The same with the corners of these indices taken from another fit."""
        parts = [(getattr(self, one.name).copy(), getattr(other, one.name)) for one in fields(self)]
        for whole, part in parts:
            whole[index] = part
        return CornerFit(*(whole for whole, _ in parts))


def _step(distance: Array, blur: Array) -> tuple[Array, Array, Array]:
    """A step from 0 to 1 under a Gaussian blur and the square of a pixel, with its slopes by distance and blur."""
    from scipy.special import ndtr

    if np.min(blur, initial=np.inf) > _PIXEL_IS_SMALL:
        wide = np.sqrt(blur * blur + np.float32(1 / 12))
        scaled = distance / wide
        slope = _bell(scaled) / wide
        return ndtr(scaled), slope, -scaled * slope * (blur / wide)
    upper, lower = (distance + 0.5) / blur, (distance - 0.5) / blur
    cdf_upper, cdf_lower = ndtr(upper), ndtr(lower)
    pdf_upper, pdf_lower = _bell(upper), _bell(lower)
    value = blur * (upper * cdf_upper + pdf_upper - lower * cdf_lower - pdf_lower)
    return value, cdf_upper - cdf_lower, pdf_upper - pdf_lower


def _bell(x: Array) -> Array:
    return np.exp(-0.5 * x * x) * np.float32(0.3989422804014327)


def _grey(image: Array, columns: Array, rows: Array) -> tuple[Array, Array]:
    """Grey values at whole pixels, and which of them lie in the image."""
    height, width = image.shape
    inside = (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
    return image[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)].astype(np.float32), inside


def _solve_damped(jacobian: Array, residual: Array, weight: Array, prior: Array, pull: Array):
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


def fit_edges(
    image: Array,
    start: Array,
    end: Array,
    inside: Array,
    reach: Array,
    margin: Array,
    bow: Array | None = None,
    most: int = 96,
) -> EdgeFit:
    """Fit the edges near the lines from start to end (N, 2) px in a grey image (h, w).

    inside (N, 2): a point on the darker or lighter inner side, which gives the normal its sense (it points away).
    reach (N,): px to either side that belong to this edge alone. margin (N,): px at both ends to leave out.
    bow (N,): px by which the edge is known to bulge inwards between its ends (c2); straight where None.
    most: lines of pixels across an edge that are looked at; more tell little more of a straight edge.
    """
    along = end - start
    length = np.linalg.norm(along, axis=1)
    tangent = along / length[:, None]
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    middle = (start + end) / 2
    normal *= -np.sign(np.sum((inside - middle) * normal, axis=1))[:, None]
    bow = np.zeros(len(start)) if bow is None else bow
    u, offset, grey, valid = _edge_samples(image, middle, tangent, normal, length, reach, margin, bow, most)
    return _edge_iterations(u, offset, grey, valid, length, reach, bow)


def _edge_samples(image, middle, tangent, normal, length, reach, margin, bow, most):
    """Pixels in the bands along the edges, with their exact places: u along in [-1, 1], offset across in px."""
    free = np.maximum(length - 2 * margin, 1.0)
    many = int(np.clip(np.max(free), 8, most))
    wide = int(np.ceil(np.max(reach)))
    s = (np.linspace(-0.5, 0.5, many)[None, :, None]) * free[:, None, None]
    bulge = bow[:, None, None] * ((2 * s / length[:, None, None]) ** 2 - 1)
    n = np.arange(-wide, wide + 1)[None, None, :] + bulge
    points = middle[:, None, None] + s[..., None] * tangent[:, None, None] + n[..., None] * normal[:, None, None]
    whole = np.rint(points).astype(int)
    grey, valid = _grey(image, whole[..., 0], whole[..., 1])
    shift = whole - middle[:, None, None]
    u = np.sum(shift * tangent[:, None, None], axis=-1) / (length[:, None, None] / 2)
    offset = np.sum(shift * normal[:, None, None], axis=-1)
    valid &= np.abs(offset - bow[:, None, None] * (u**2 - 1)) <= reach[:, None, None] + 0.5
    flat = len(length), -1
    # A pixel of a short side is met several times; its weight is that of one pixel.
    repeat = np.minimum(1.0, free / many)[:, None]
    parts = u, offset, grey, valid * repeat[..., None]
    return tuple(part.reshape(flat).astype(np.float32) for part in parts)


def _edge_iterations(u, offset, grey, weight, length, reach, start_bow) -> EdgeFit:
    count = len(length)
    parameters = np.zeros((count, 8))  # dark, its slope, contrast, its slope, c0, c1, c2, log blur
    total = np.maximum(weight.sum(axis=1), 1e-9)
    across = offset - start_bow[:, None] * (u**2 - 1)
    bright = _mean(grey, weight * (across > 0.4 * reach[:, None]))
    dark = _mean(grey, weight * (across < -0.4 * reach[:, None]))
    parameters[:, 4], parameters[:, 6] = -start_bow, start_bow
    parameters[:, 0], parameters[:, 2] = dark, bright - dark
    # A step as soft as the band is wide feels the edge from afar; it sharpens as it comes nearer.
    parameters[:, 7] = np.log(np.maximum(0.5, reach / 4))
    farthest = np.maximum(1.0, reach / 4)[:, None]
    noise = np.full(count, 4.0)
    bow = _BOW * (length / 100) ** 2
    inverse = np.zeros((count, 8, 8))
    active = np.arange(count)
    for _ in range(_ITERATIONS):
        now, w = parameters[active], weight[active]
        residual, jacobian = _edge_model(now, u[active], offset[active], grey[active])
        level = np.sqrt(np.sum(w * residual**2, axis=1) / np.maximum(total[active] - 7, 1)) + _LEAST_NOISE
        prior = np.zeros((len(active), 8))
        prior[:, [1, 3]] = (level / (0.5 * np.abs(now[:, 2]) + 1))[:, None] ** 2
        prior[:, 6] = (level / bow[active]) ** 2
        prior[:, 7] = (level / _BLUR_SPREAD) ** 2
        pull = -now
        pull[:, 7] += _USUAL_BLUR
        step, inverse[active] = _solve_damped(jacobian, residual, w, prior, pull)
        step[:, 4:7] = np.clip(step[:, 4:7], -farthest[active], farthest[active])
        step[:, 7] = np.clip(step[:, 7], -0.5, 0.5)
        parameters[active] = now + step
        parameters[:, 7] = np.clip(parameters[:, 7], np.log(_SHARPEST), np.log(_SOFTEST))
        noise[active] = level
        active = active[~_settled(step[:, 4:7], step[:, 7])]
        if not len(active):
            break
    covariance = inverse[:, 4:7, 4:7] * (noise**2)[:, None, None]
    dark, contrast = parameters[:, 0].copy(), parameters[:, 2].copy()
    return EdgeFit(parameters[:, 4:7].copy(), covariance, noise, contrast, np.exp(parameters[:, 7]), dark)


def _settled(places: Array, log_blur: Array) -> Array:
    """Which fits have come to rest, in place and, roughly, in blur: their noise is judged later."""
    return (np.max(np.abs(places), axis=1) < _SETTLED) & (np.abs(log_blur) < _BLUR_SETTLED)


def _mean(values: Array, weight: Array) -> Array:
    return np.sum(values * weight, axis=1) / np.maximum(weight.sum(axis=1), 1e-9)


def _edge_model(parameters: Array, u: Array, offset: Array, grey: Array) -> tuple[Array, Array]:
    dark, dark_slope, contrast, contrast_slope, c0, c1, c2, log_blur = parameters.astype(np.float32).T[..., None]
    blur = np.exp(log_blur)
    value, slope, by_blur = _step(offset - (c0 + u * (c1 + u * c2)), blur)
    height = contrast + contrast_slope * u
    residual = grey - (dark + dark_slope * u + height * value)
    jacobian = np.empty((len(u), 8, u.shape[1]), np.float32)
    jacobian[:, 0], jacobian[:, 1] = 1, u
    jacobian[:, 2], jacobian[:, 3] = value, u * value
    jacobian[:, 4] = -height * slope
    jacobian[:, 5] = jacobian[:, 4] * u
    jacobian[:, 6] = jacobian[:, 5] * u
    jacobian[:, 7] = height * by_blur * blur
    return residual, jacobian


def fit_outline(
    image: Array, corners: Array, reach: Array, bow: Array | None = None, blur: Array | None = None, most: int = 96
) -> tuple[Array, Array, EdgeFit]:
    """Corners (N, 4, 2) px of quadrilaterals, from the four edges of each, with what the edges told.

    reach (N, 4): px to either side of the side from corner k to k + 1 that belong to that edge alone.
    bow (N, 4): how far each side is known to bulge (c2 of an earlier fit), px. blur (N, 4): px, where known.
    Returns corners (N, 4, 2), sigma (N, 4) px a coordinate, and the EdgeFit of all sides (4 N in order).
    """
    count = len(corners)
    start, end = corners.reshape(-1, 2), np.roll(corners, -1, axis=1).reshape(-1, 2)
    centre = np.repeat(corners.mean(axis=1), 4, axis=0)
    length = np.linalg.norm(end - start, axis=1)
    # Blur rounds a corner off: within some two pixels of it, or two and a half times a blur that is known.
    rounded = 2.0 if blur is None else np.maximum(2.0, 2.5 * blur.reshape(-1))
    margin = np.minimum(np.maximum(rounded, 0.06 * length), 0.3 * length)
    flat_bow = None if bow is None else bow.reshape(-1)
    fit = fit_edges(image, start, end, centre, reach.reshape(-1), margin, flat_bow, most)
    refined, sigma = _meet(corners, fit)
    return refined.reshape(count, 4, 2), sigma.reshape(count, 4), fit


def _meet(corners: Array, fit: EdgeFit) -> tuple[Array, Array]:
    """Where each side meets the one before it."""
    count = len(corners)
    end = np.roll(corners, -1, axis=1)
    along = end - corners
    length = np.linalg.norm(along, axis=2, keepdims=True)
    tangent = along / length
    normal = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)
    middle = (corners + end) / 2
    centre = corners.mean(axis=1, keepdims=True)
    normal = normal * -np.sign(np.sum((centre - middle) * normal, axis=-1, keepdims=True))
    # Of each corner (N, 4): its own side and the one before it (2).
    both = np.stack([np.arange(4), [3, 0, 1, 2]], axis=1)
    middle, tangent, normal = middle[:, both], tangent[:, both], normal[:, both]
    half = length[:, both, 0] / 2
    c = fit.coefficients.reshape(count, 4, 3)[:, both]
    points = corners.copy()
    for _ in range(3):
        shift = points[:, :, None] - middle
        u = np.sum(shift * tangent, axis=-1) / half
        powers = np.stack([np.ones_like(u), u, u * u], axis=-1)
        slope = (c[..., 1] + 2 * c[..., 2] * u) / half
        gaps = np.sum(shift * normal, axis=-1) - np.sum(c * powers, axis=-1)
        inverse = _inverse(normal - slope[..., None] * tangent)
        points = points - (inverse @ gaps[..., None])[..., 0]
    covariance = fit.covariance.reshape(count, 4, 3, 3)[:, both]
    variances = np.sum((covariance @ powers[..., None])[..., 0] * powers, axis=-1)
    variance = np.sum(inverse**2 * variances[..., None, :], axis=(-1, -2)) / 2
    return points, np.sqrt(np.maximum(variance, 0))


def _inverse(rows: Array) -> Array:
    """Of matrices (..., 2, 2), one of parallel rows taken as all but parallel."""
    (a, b), (c, d) = np.moveaxis(rows, (-2, -1), (0, 1))
    determinant = a * d - b * c
    determinant = np.where(np.abs(determinant) < 1e-6, 1e-6, determinant)
    return np.moveaxis(np.array([[d, -b], [-c, a]]) / determinant, (0, 1), (-2, -1))


def fit_corners(image: Array, pixels: Array, axes: Array, radius: Array, clear: float = np.inf) -> CornerFit:
    """Fit corners where four squares of a board meet, near pixels (N, 2), in a grey image (h, w).

    axes (N, 2, 2): px that one square's side spans along the board's columns and along its rows at each corner.
    radius (N,): px around the corner to use. clear: share of a square's side around each of the board's lines that is
    free of print (ChArUco boards have tags in the white squares).
    """
    wide = int(np.ceil(np.max(radius, initial=1.0))) + 1
    steps = np.arange(-wide, wide + 1)
    window = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    window = window[np.hypot(*window.T) < np.max(radius, initial=1.0) + 1.3][None]
    whole = np.rint(pixels).astype(int)[:, None] + window
    grey, valid = _grey(image, whole[..., 0], whole[..., 1])
    places = whole - pixels[:, None]
    square = np.linalg.inv(np.swapaxes(axes, 1, 2))
    board = places @ np.swapaxes(square, 1, 2)
    weight = valid * np.clip(radius[:, None] + 0.5 - np.linalg.norm(places, axis=-1), 0, 1)
    # One more pixel stays clear for the blur of the tags' edges.
    pixel = 1.2 / np.min(np.linalg.norm(axes, axis=2), axis=1)[:, None]
    weight = weight * ~((np.abs(board) > np.maximum(clear - pixel, pixel)[..., None]).all(axis=-1))
    return _corner_iterations(pixels, axes, places.astype(np.float32), grey, weight.astype(np.float32))


def _corner_iterations(pixels, axes, places, grey, weight) -> CornerFit:
    count = len(pixels)
    parameters = np.zeros((count, 9))  # x, y, two angles, log blur, mean grey, its slopes, half contrast
    parameters[:, 2:4] = np.arctan2(axes[:, :, 1], axes[:, :, 0])
    parameters[:, 4] = _USUAL_BLUR
    total = np.maximum(weight.sum(axis=1), 1e-9)
    parameters[:, 5] = _mean(grey, weight)
    pattern = _corner_model(parameters, places, grey)[1][:, 8]
    parameters[:, 8] = np.sum(weight * pattern * (grey - parameters[:, 5:6]), axis=1) / np.maximum(
        np.sum(weight * pattern**2, axis=1), 1e-9
    )
    noise = np.full(count, 4.0)
    inverse = np.zeros((count, 9, 9))
    active = np.arange(count)
    for _ in range(_ITERATIONS):
        now, w = parameters[active], weight[active]
        residual, jacobian = _corner_model(now, places[active], grey[active])
        level = np.sqrt(np.sum(w * residual**2, axis=1) / np.maximum(total[active] - 8, 1)) + _LEAST_NOISE
        prior = np.zeros((len(active), 9))
        # The board's own lines are known to some degrees.
        prior[:, 2:4] = (level[:, None] / 0.15) ** 2
        prior[:, 4] = (level / _BLUR_SPREAD) ** 2
        prior[:, 6:8] = (level / (0.05 * np.abs(now[:, 8]) + 0.1))[:, None] ** 2
        pull = np.zeros((len(active), 9))
        pull[:, 4] = _USUAL_BLUR - now[:, 4]
        pull[:, 6:8] = -now[:, 6:8]
        step, inverse[active] = _solve_damped(jacobian, residual, w, prior, pull)
        step[:, :2] = np.clip(step[:, :2], -1.0, 1.0)
        step[:, 2:4] = np.clip(step[:, 2:4], -0.3, 0.3)
        step[:, 4] = np.clip(step[:, 4], -0.5, 0.5)
        parameters[active] = now + step
        parameters[:, 4] = np.clip(parameters[:, 4], np.log(_SHARPEST), np.log(_SOFTEST))
        noise[active] = level
        active = active[~_settled(step[:, :2], step[:, 4])]
        if not len(active):
            break
    sigma = noise * np.sqrt(np.maximum(inverse[:, 0, 0] + inverse[:, 1, 1], 0) / 2)
    return CornerFit(pixels + parameters[:, :2], sigma, noise, 2 * parameters[:, 8], np.exp(parameters[:, 4]))


def _corner_model(parameters: Array, places: Array, grey: Array) -> tuple[Array, Array]:
    x, y, first, second, log_blur, mean, slope_x, slope_y, half = parameters.astype(np.float32).T[..., None]
    blur = np.exp(log_blur)
    dx, dy = places[..., 0] - x, places[..., 1] - y
    signs, by_distance, by_blur, distance_along = [], [], [], []
    for angle in (first, second):
        cos, sin = np.cos(angle), np.sin(angle)
        value, slope, widen = _step(cos * dy - sin * dx, blur)
        signs.append(2 * value - 1)
        by_distance.append(2 * slope)
        by_blur.append(2 * widen)
        distance_along.append(cos * dx + sin * dy)
    product = signs[0] * signs[1]
    residual = grey - (mean + slope_x * places[..., 0] + slope_y * places[..., 1] + half * product)
    cross = [half * by_distance[0] * signs[1], half * by_distance[1] * signs[0]]
    jacobian = np.empty((len(x), 9, dx.shape[1]), np.float32)
    jacobian[:, 0] = cross[0] * np.sin(first) + cross[1] * np.sin(second)
    jacobian[:, 1] = -cross[0] * np.cos(first) - cross[1] * np.cos(second)
    jacobian[:, 2] = -cross[0] * distance_along[0]
    jacobian[:, 3] = -cross[1] * distance_along[1]
    jacobian[:, 4] = half * (by_blur[0] * signs[1] + by_blur[1] * signs[0]) * blur
    jacobian[:, 5] = 1
    jacobian[:, 6], jacobian[:, 7] = places[..., 0], places[..., 1]
    jacobian[:, 8] = product
    return residual, jacobian
