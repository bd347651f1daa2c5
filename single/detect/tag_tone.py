"""The tone curve of a picture from the bits of the tags in it.

A curve after the lens's blur makes all white cells grow, or all shrink, by the same fraction of a pixel, while the
print has them all of one size. So the inside of a tag, white on black and black on white, tells the curve of whatever
kind, and what ink and paper add. An edge alone tells it by the shape of its profile only, ten times less surely.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.detect.blurred_step import LEAST_NOISE, damped_step, standard_normal, variance_of_sides
from quadrig.single.detect.local_homography import local_homographies, mapped
from quadrig.single.detect.tone import Tone, gamma_evidence

# Places at which an inside is looked at, and tags: more tell gamma better than a power fits a curve.
_PLACES, _TAGS = 360, 2
# Standard deviation of log gamma that no inside takes away: real curves are no powers.
_MODEL_SIGMA = 0.02
# Gauss-Newton steps: the outline's fit has found place and blur.
_STEPS = 2
# Side of a cell, px and blurs, below which bits run into each other.
_LEAST_CELL, _LEAST_BLURS = 3.0, 1.5
# Share of the contrast that the fit may leave unexplained: more, and something lies over the bits.
_UNEXPLAINED = 0.15
# Cells by which bits lie elsewhere than the outline's corners say: bent sheets, the lens's distortion, the curve.
_WARP = 0.2
# Share by which the outline's blur is wrong, as a logarithm; share of the contrast by which light and ink may slope.
_BLUR_SPREAD, _SLOPE = 0.3, 0.5


@dataclass(frozen=True, eq=False)
class _Inside:
    """Pixels within tags: light (N, M) is a table's, by their grey levels (N, M); u, v (N, M) place in cells; blur_u,
    blur_v (N, M): cells a px along either; plane (N, M, 3) and warp (N, M, 6): polynomials over the tag."""

    levels: Ints
    u: Floats
    v: Floats
    blur_u: Floats
    blur_v: Floats
    plane: Floats
    warp: Floats


def tone_from_tags(grey: Floats, corners: Floats, blur: Floats, bits: Floats, tone: Tone) -> Tone:
    """The tone by the insides of the tags, or as it is where none is large and sharp enough.

    grey (h, w) uint8; corners (N, 4, 2) px of the outlines, top left first and clockwise on the print; blur (N,) px;
    bits (N, cells, cells), 0 black and 1 white, the black border included; tone: to begin with.
    """
    cells = bits.shape[1]
    side = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).min(axis=1) / cells
    inside = ((corners > 1) & (corners < np.array(grey.shape[::-1]) - 2)).all(axis=(1, 2))
    usable = np.flatnonzero(inside & (side > _LEAST_CELL) & (side > _LEAST_BLURS * blur))
    if not len(usable):
        return tone
    best = usable[np.argsort(side[usable] / blur[usable])[-_TAGS:]]
    seen = _inside(grey, corners[best], cells)
    # Every pixel is one measurement, however often a small tag's is met.
    once = np.minimum(1.0, (side[best] * cells) ** 2 / _PLACES)[:, None]
    padded = np.pad(bits[best], ((0, 0), (1, 1), (1, 1)), constant_values=1.0)
    corner_of = np.diff(np.diff(padded, axis=1), axis=2)
    parameters = np.zeros((len(best), 19))  # dark and its slopes, contrast and its, warp along u and v, log blur
    parameters[:, 18] = start = np.log(np.hypot(blur[best], np.sqrt(1 / 12)))
    for _ in range(_STEPS):
        light = tone.table()[seen.levels]
        if not parameters[:, 3].any():
            parameters[:, 0], parameters[:, 3] = np.percentile(light, 10, axis=1), np.ptp(light, axis=1)
        model, jacobian = _model(parameters, seen, corner_of)
        residual, one = light - model, np.ones_like(light)
        contrast = np.abs(parameters[:, 3])
        least = LEAST_NOISE * tone.by_grey(parameters[:, :1] + parameters[:, 3:4] * [0, 1])
        variance = variance_of_sides(residual, jacobian[:, 3], one, least, parameters.shape[1])
        weight = once.astype(np.float32) / variance
        prior = np.zeros_like(parameters)
        prior[:, [1, 2, 4, 5]] = 1 / (_SLOPE * contrast + 1)[:, None] ** 2
        prior[:, 6:18], prior[:, 18] = 1 / _WARP**2, 1 / _BLUR_SPREAD**2
        pull = -parameters
        pull[:, 18] += start
        step, inverse = damped_step(jacobian, residual, weight, prior, pull)
        follow, *evidence = gamma_evidence(model, residual, jacobian, weight, inverse)
        told = _told(tone, *evidence, np.sqrt(variance.mean(axis=1)) < _UNEXPLAINED * contrast)
        parameters += step
        parameters[:, 6:] += follow[:, 6:] * np.log(told.gamma / tone.gamma)
        _read_anew(parameters, tone, told)
        tone = told
    return tone


@lru_cache(maxsize=1)
def _spread(count: int) -> Floats:
    """Places (count, 2) that fill the unit square evenly, in step with no grid of cells: the R2 sequence."""
    # Powers of the plastic number, the root of x^3 = x + 1.
    return np.arange(1, count + 1)[:, None] * np.array([0.7548776662466927, 0.5698402909980532]) % 1


def _read_anew(parameters: Floats, tone: Tone, told: Tone) -> None:
    """Dark, contrast and their slopes as another tone reads the same grey values: in dark pictures the light changes
    by so much that its derivative by gamma does not say."""
    dark = told.light(tone.grey(parameters[:, 0]))
    contrast = told.light(tone.grey(parameters[:, 0] + parameters[:, 3])) - dark
    parameters[:, [1, 2, 4, 5]] *= (contrast / np.where(parameters[:, 3] == 0, 1, parameters[:, 3]))[:, None]
    parameters[:, 0], parameters[:, 3] = dark, contrast


def _inside(grey: Floats, corners: Floats, cells: int) -> _Inside:
    unit = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    image_from_unit = local_homographies(np.broadcast_to(unit, corners.shape), corners)
    # The outermost cells' outer half is the outline's.
    grid = (2 * _spread(_PLACES) - 1) * (1 - 1 / cells)
    whole = np.rint(mapped(image_from_unit, grid)).astype(int)
    unit_from_image = np.linalg.inv(image_from_unit)
    place = mapped(unit_from_image, whole)
    x, y = place[..., 0], place[..., 1]
    g = unit_from_image[:, None]
    depth = whole[..., 0] * g[..., 2, 0] + whole[..., 1] * g[..., 2, 1] + g[..., 2, 2]
    gradient = (g[..., :2, :2] - place[..., None] * g[..., 2:, :2]) / depth[..., None, None]
    slope = np.linalg.norm(gradient, axis=-1) * cells / 2
    one = np.ones_like(x)
    return _Inside(
        grey[whole[..., 1], whole[..., 0]],
        *np.moveaxis((place + 1) * cells / 2, -1, 0).astype(np.float32),
        *np.moveaxis(slope, -1, 0).astype(np.float32),
        np.stack([one, x, y], axis=1).astype(np.float32),
        np.stack([one, x, y, x * x, x * y, y * y], axis=1).astype(np.float32),
    )


def _model(parameters: Floats, seen: _Inside, corner_of: Floats) -> tuple[Floats, Floats]:
    """Light (N, M) of blurred bits and its derivatives (N, 19, M). corner_of (N, G, G): mixed differences of the bits
    at the lines between cells, along v and u; the bits are the sum of so many products of a step along either."""
    dark, contrast, warp_u, warp_v, log_blur = np.split(
        parameters.astype(np.float32)[..., None], [3, 6, 12, 18], axis=1
    )
    blur = np.exp(log_blur[:, 0])
    lines = np.arange(corner_of.shape[1], dtype=np.float32)
    steps, slopes, widenings = [], [], []
    for place, warp, unit in ((seen.u, warp_u, seen.blur_u), (seen.v, warp_v, seen.blur_v)):
        wide = (blur * unit)[..., None]
        scaled = ((place + np.sum(warp * seen.warp, axis=1))[..., None] - lines) / wide
        step, slope = standard_normal(scaled)
        steps.append(step)
        slopes.append(slope / wide)
        widenings.append(-scaled * slope)
    corner_of = corner_of.astype(np.float32)
    across = steps[1] @ corner_of, steps[0] @ np.swapaxes(corner_of, 1, 2)
    white = 1 + np.sum(steps[0] * across[0], axis=-1)
    by_place = [np.sum(slope * other, axis=-1) for slope, other in zip(slopes, across, strict=True)]
    by_blur = sum(np.sum(widen * other, axis=-1) for widen, other in zip(widenings, across, strict=True))
    height = np.sum(contrast * seen.plane, axis=1)
    model = np.sum(dark * seen.plane, axis=1) + height * white
    jacobian = np.concatenate(
        [
            seen.plane,
            seen.plane * white[:, None],
            seen.warp * (height * by_place[0])[:, None],
            seen.warp * (height * by_place[1])[:, None],
            (height * by_blur)[:, None],
        ],
        axis=1,
    )
    return model, jacobian


def _told(tone: Tone, pull: Floats, weight: Floats, explained: Mask) -> Tone:
    """The tone after the evidence of the tags that are what they are taken for; all share the same wrong model."""
    shared = 1 / (1 + weight[explained].sum() * _MODEL_SIGMA**2)
    return tone.told(shared * pull[explained].sum(), shared * weight[explained].sum())
