"""Where an edge, and where a corner of a board, lies to a fraction of a pixel.

Both are least-squares fits of a blurred step to the grey values themselves, at the centres of their pixels: nothing
is interpolated, so nothing is biased towards the pixel grid. Both fit many places of one image at once.
"""

from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats, Mask, Singles
from quadrig.single.subpixel.blurred_step import (
    BLUR_SPREAD,
    ITERATIONS,
    LEAST_NOISE,
    SHARPEST,
    SOFTEST,
    USUAL_BLUR,
    damped_step,
    place_excess,
    settled,
    soft_step,
    variance_of_sides,
    weighted_mean,
)
from quadrig.single.subpixel.tone import LightImage, Tone, tone_evidence

# Bow (px over half a side of 50 px) that a strong wide-angle lens gives a straight edge; it grows with the square.
_BOW = 0.5
# Share of that by which a lens or bent paper bows the two ends of an edge unlike each other.
_LOPSIDED = 0.3
# Where among an edge's parameters its place stands.
_PLACE = slice(5, 9)
CLIPPED, LIGHT_INK = 252.0, 90.0
"""Grey levels: white that may have been cut off, and ink that at a good exposure is darker even in a gamma curve.
Where both are passed, an unknown part of the step is missing, and its middle with it."""


@dataclass(frozen=True, eq=False)
class EdgeFit:
    """Sides of outlines: offset c0 + c1 u + c2 u^2 + c3 u^3 (px, along the normal), u in [-1, 1] from start to end.

    coefficients (N, 4), covariance (N, 4, 4); noise (N,), dark (N,) of the inner side and contrast (N,) from inside
    to outside in light as the tone reads it; blur (N,) px. by_tone (N, D, 4): how the coefficients change with the D
    unknowns of the tone; pull (N, D), weight (N, D, D), pull_excess (N,): what each edge says of them, see Evidence;
    excess (N,): by how much its covariance is too small, see place_excess.
    """

    coefficients: Floats
    covariance: Floats
    noise: Floats
    dark: Floats
    contrast: Floats
    blur: Floats
    by_tone: Floats
    pull: Floats
    weight: Floats
    pull_excess: Floats
    excess: Floats
    tone: Tone

    @property
    def grey_contrast(self) -> Floats:
        """Grey levels (N,) from inside to outside."""
        return self.tone.grey(self.dark + self.contrast) - self.tone.grey(self.dark)

    @property
    def clipped(self) -> Mask:
        """Which (N,) edges end in white that may have been cut off: by how much the light was more is unknown."""
        return self._sides.max(axis=0) > CLIPPED

    @property
    def washed_out(self) -> Mask:
        """Which (N,) edges run between white that is clipped and a dark side that is light: they lie elsewhere."""
        return self.clipped & (self._sides.min(axis=0) > LIGHT_INK)

    @property
    def _sides(self) -> Floats:
        return np.asarray(self.tone.grey(np.stack([self.dark, self.dark + self.contrast])), float)


@dataclass(frozen=True, eq=False)
class Outline:
    """Quadrilaterals: corners (N, 4, 2) px, sigma (N, 4) px a coordinate, by_tone (N, D, 4, 2): how the corners
    move with the D unknowns of the tone, pull (N, D), weight (N, D, D): what they say of them, see Evidence, fit: of
    all sides (4 N in order)."""

    corners: Floats
    sigma: Floats
    by_tone: Floats
    pull: Floats
    weight: Floats
    fit: EdgeFit


@dataclass(frozen=True)
class EdgeOptions:
    """most: lines of pixels across an edge that are looked at; more show little more of a straight edge. ground:
    standard deviation of how the light outside changes from px to px away from the edge, as share of the contrast;
    paper's does not, a table's does. blur (N,): px, where an earlier fit found the edge to a fraction of them; rough:
    a tenth of a pixel is enough. tone_unknowns: D, how many of the tone's the edges are asked for."""

    most: int = 96
    ground: float = 0.0
    blur: Floats | None = None
    rough: bool = False
    tone_unknowns: int = 1


_USUAL = EdgeOptions()


def fit_edges(
    image: LightImage,
    start: Floats,
    end: Floats,
    inside: Floats,
    reach: Floats,
    margin: Floats,
    bow: Floats | None = None,
    options: EdgeOptions = _USUAL,
) -> EdgeFit:
    """Fit the edges near the lines from start to end (N, 2) px.

    inside (N, 2): a point on the darker or lighter inner side, which gives the normal its sense (it points away).
    reach (N,): px to either side that belong to this edge alone. margin (N,): px at both ends to leave out.
    bow (N,): px by which the edge is known to bulge inwards between its ends (c2); straight where None.
    """
    along = end - start
    length = np.linalg.norm(along, axis=1)
    tangent = along / length[:, None]
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    middle = (start + end) / 2
    normal *= -np.sign(np.sum((inside - middle) * normal, axis=1))[:, None]
    bands = _Bands(middle, tangent, normal, length, reach, np.zeros(len(start)) if bow is None else bow)
    u, offset, light, weight = _edge_samples(image, bands, margin, options.most)
    return _edge_iterations(u, offset, light, weight, bands, image.tone, options)


@dataclass(frozen=True, eq=False)
class _Bands:
    """Bands along N edges: middle (N, 2), unit vectors along and across (N, 2), length, reach and bow (N,), px."""

    middle: Floats
    tangent: Floats
    normal: Floats
    length: Floats
    reach: Floats
    bow: Floats


def _edge_samples(
    image: LightImage, bands: _Bands, margin: Floats, most: int
) -> tuple[Singles, Singles, Singles, Singles]:
    """Pixels in the bands along the edges, with their exact places: u along in [-1, 1], offset across in px."""
    # From a whole pixel near its middle, places along an edge are exact enough as singles.
    near = np.rint(bands.middle)

    def each(part: Floats) -> Singles:
        return part.astype(np.float32)[:, None, None]

    length, bow, (x, y) = each(bands.length), each(bands.bow), map(each, (bands.middle - near).T)
    (along_x, along_y), (across_x, across_y) = map(each, bands.tangent.T), map(each, bands.normal.T)
    free = np.maximum(bands.length - 2 * margin, 1.0)
    many = int(np.clip(np.max(free), 8, most))
    wide = int(np.ceil(np.max(bands.reach)))
    s = np.linspace(-0.5, 0.5, many, dtype=np.float32)[:, None] * each(free)
    n = np.arange(-wide, wide + 1, dtype=np.float32) + bow * ((2 * s / length) ** 2 - 1)
    columns, rows = np.rint(x + s * along_x + n * across_x), np.rint(y + s * along_y + n * across_y)
    column, row = near.astype(int)[:, None, None].transpose(3, 0, 1, 2)
    light, valid = image.at(columns.astype(int) + column, rows.astype(int) + row)
    columns -= x
    rows -= y
    u = (columns * along_x + rows * along_y) / (length / 2)
    offset = columns * across_x + rows * across_y
    valid &= np.abs(offset - bow * (u**2 - 1)) <= each(bands.reach) + np.float32(0.5)

    # A pixel of a short side is met several times; its weight is that of one pixel.
    repeat = np.minimum(1.0, free / many)[:, None]
    parts = u, offset, light, valid * repeat[..., None]
    u, offset, light, weight = (part.reshape(len(length), -1).astype(np.float32, copy=False) for part in parts)
    return u, offset, light, weight


def _edge_iterations(
    u: Singles, offset: Singles, light: Singles, weight: Singles, bands: _Bands, tone: Tone, options: EdgeOptions
) -> EdgeFit:
    count, reach, start_bow, ground = len(bands.length), bands.reach, bands.bow, options.ground
    unknowns = 10 if ground else 9
    # Dark, its slope, contrast, its slope, log blur, c0, c1, c2, c3, and how the outside changes across.
    parameters = np.zeros((count, unknowns))
    across = offset - start_bow[:, None] * (u**2 - 1)
    bright = weighted_mean(light, weight * (across > 0.4 * reach[:, None]))
    dark = weighted_mean(light, weight * (across < -0.4 * reach[:, None]))
    parameters[:, 5], parameters[:, 7] = -start_bow, start_bow
    parameters[:, 0], parameters[:, 2] = dark, bright - dark
    # A step as soft as the band is wide feels the edge from afar; it sharpens as it comes nearer.
    parameters[:, 4] = np.log(np.maximum(0.5, reach / 4) if options.blur is None else options.blur)
    farthest = np.maximum(1.0, reach / 4)[:, None]
    noise = np.full(count, 4.0)
    bow = _BOW * (bands.length / 100) ** 2
    inverse = np.zeros((count, unknowns, unknowns))
    asked = options.tone_unknowns
    by_tone, excess = np.zeros((count, unknowns, asked)), np.zeros((2, count))
    tone_pull, tone_weight = np.zeros((count, asked)), np.zeros((count, asked, asked))
    active = np.arange(count)
    for iteration in range(ITERATIONS):
        now, w = parameters[active], weight[active]
        model, jacobian = _edge_model(now, u[active], offset[active])
        residual = light[active] - model
        least = LEAST_NOISE * tone.by_grey(np.stack([now[:, 0], now[:, 0] + now[:, 2]], axis=1))
        variance = variance_of_sides(residual, jacobian[:, 2], w, least, 7)
        noise[active] = np.sqrt(weighted_mean(variance, w))
        w = w / variance
        prior = np.zeros((len(active), unknowns))
        prior[:, [1, 3]] = 1 / (0.5 * np.abs(now[:, 2]) + 1)[:, None] ** 2
        prior[:, 4] = 1 / BLUR_SPREAD**2
        prior[:, 7:9] = 1 / (bow[active, None] * [1, _LOPSIDED]) ** 2
        if ground:
            prior[:, 9] = 1 / (ground * np.abs(now[:, 2]) + 1e-3) ** 2
        pull = -now
        pull[:, 4] += USUAL_BLUR
        step, inverse[active] = damped_step(jacobian, residual, w, prior, pull)
        step[:, 4] = np.clip(step[:, 4], -0.5, 0.5)
        step[:, _PLACE] = np.clip(step[:, _PLACE], -farthest[active], farthest[active])
        parameters[active] = now + step
        parameters[:, 4] = np.clip(parameters[:, 4], np.log(SHARPEST), np.log(SOFTEST))
        rest = settled(step[:, _PLACE], step[:, 4], options.rough) | (iteration == ITERATIONS - 1)
        if not rest.any():
            continue
        done, active = active[rest], active[~rest]
        jacobian, residual, w = jacobian[rest], residual[rest], w[rest]
        evidence = tone_evidence(tone.changes(model[rest], asked), residual, jacobian, w, inverse[done])
        by_tone[done], tone_pull[done], tone_weight[done] = evidence.follow, evidence.pull, evidence.weight
        excess[:, done] = evidence.excess, place_excess(jacobian, w * residual, inverse[done], _PLACE)
        if not len(active):
            break
    dark, contrast, blur = parameters[:, 0], parameters[:, 2], np.exp(parameters[:, 4])
    return EdgeFit(
        parameters[:, _PLACE],
        inverse[:, _PLACE, _PLACE],
        noise,
        dark,
        contrast,
        blur,
        np.swapaxes(by_tone[:, _PLACE], 1, 2),
        tone_pull,
        tone_weight,
        excess[0],
        excess[1],
        tone,
    )


def _edge_model(parameters: Floats, u: Singles, offset: Singles) -> tuple[Singles, Singles]:
    dark, dark_slope, contrast, contrast_slope, log_blur, c0, c1, c2, c3, *across = parameters.astype(np.float32).T[
        ..., None
    ]
    blur = np.exp(log_blur)
    value, slope, by_blur = soft_step(offset - (c0 + u * (c1 + u * (c2 + u * c3))), blur)
    height = contrast + contrast_slope * u
    jacobian = np.empty((len(u), parameters.shape[1], u.shape[1]), np.float32)
    if across:
        height = height + across[0] * offset
        jacobian[:, 9] = value * offset
    model = dark + dark_slope * u + height * value
    jacobian[:, 0], jacobian[:, 1] = 1, u
    jacobian[:, 2], jacobian[:, 3] = value, u * value
    jacobian[:, 4] = height * by_blur * blur
    jacobian[:, 5] = -height * slope
    for power in range(6, 9):
        jacobian[:, power] = jacobian[:, power - 1] * u
    return model, jacobian


def fit_outline(
    image: LightImage,
    corners: Floats,
    reach: Floats,
    bow: Floats | None = None,
    options: EdgeOptions = _USUAL,
) -> Outline:
    """The outlines near corners (N, 4, 2) px of quadrilaterals, from the four edges of each.

    reach (N, 4): px to either side of the side from corner k to k + 1 that belong to that edge alone.
    bow (N, 4): how far each side is known to bulge (c2 of an earlier fit), px.
    """
    start, end = corners.reshape(-1, 2), np.roll(corners, -1, axis=1).reshape(-1, 2)
    centre = np.repeat(corners.mean(axis=1), 4, axis=0)
    length = np.linalg.norm(end - start, axis=1)
    # Blur rounds a corner off: within some two pixels of it, or two and a half times a blur that is known.
    rounded = 2.0 if options.blur is None else np.maximum(2.0, 2.5 * options.blur)
    margin = np.minimum(np.maximum(rounded, 0.06 * length), 0.3 * length)
    flat_bow = None if bow is None else bow.reshape(-1)
    fit = fit_edges(image, start, end, centre, reach.reshape(-1), margin, flat_bow, options)
    return meet(corners, fit)


def meet(corners: Floats, fit: EdgeFit) -> Outline:
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
    c = fit.coefficients.reshape(count, 4, 4)[:, both]

    def newton(points: Floats) -> tuple[Floats, Floats, Floats]:
        shift = points[:, :, None] - middle
        u = np.sum(shift * tangent, axis=-1) / half
        powers = u[..., None] ** np.arange(4)
        slope = (c[..., 1] + 2 * c[..., 2] * u + 3 * c[..., 3] * u * u) / half
        gaps = np.sum(shift * normal, axis=-1) - np.sum(c * powers, axis=-1)
        inverse = _inverse(normal - slope[..., None] * tangent)
        return points - (inverse @ gaps[..., None])[..., 0], powers, inverse

    points, powers, inverse = newton(newton(newton(corners)[0])[0])
    covariance = fit.covariance.reshape(count, 4, 4, 4)[:, both]
    variances = np.sum((covariance @ powers[..., None])[..., 0] * powers, axis=-1)
    excess, doubt = (np.maximum(one.reshape(count, 4).mean(axis=1), 1) for one in (fit.excess, fit.pull_excess))
    variance = excess[:, None] * np.sum(inverse**2 * variances[..., None, :], axis=(-1, -2)) / 2
    by_tone = np.moveaxis(fit.by_tone.reshape(count, 4, -1, 4), 2, 1)[:, :, both]
    by_tone = (inverse[:, None] @ np.sum(by_tone * powers[:, None], axis=-1)[..., None])[..., 0]
    pull, weight = (np.sum(one.reshape(count, 4, *one.shape[1:]), axis=1) for one in (fit.pull, fit.weight))
    pull, weight = pull / doubt[:, None], weight / doubt[:, None, None]
    return Outline(points, np.sqrt(np.maximum(variance, 0)), by_tone, pull, weight, fit)


def _inverse(rows: Floats) -> Floats:
    """Of matrices (..., 2, 2), one of parallel rows taken as all but parallel."""
    (a, b), (c, d) = np.moveaxis(rows, (-2, -1), (0, 1))
    determinant = a * d - b * c
    determinant = np.where(np.abs(determinant) < 1e-6, 1e-6, determinant)
    return np.moveaxis(np.array([[d, -b], [-c, a]]) / determinant, (0, 1), (-2, -1))
