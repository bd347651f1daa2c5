"""The tone curve of a picture from the bits of the tags in it.

A curve after the lens's blur makes all white cells grow, or all shrink, by the same fraction of a pixel, while the
print has them all of one size. So the inside of a tag, white on black and black on white, shows the curve of whatever
kind, and what ink and paper add. An edge alone shows it by the shape of its profile only, ten times less surely.
"""

from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask, Picture, Reals, Singles
from quadrig.single.subpixel.blurred_step import LEAST_NOISE, damped_step, soft_step, variance_of_sides
from quadrig.single.subpixel.local_homography import local_homographies, mapped
from quadrig.single.subpixel.tone import Evidence, Tone, tone_evidence

# Places beside the edges of bits that are looked at, in so many tags at most: more give gamma better than powers fit.
_PLACES, _TAGS = 720, 6
# px beside three blurs within which an edge between bits is looked at.
_BESIDE = 1.5
# Standard deviation of log gamma that no inside takes away: real curves are no powers.
_MODEL_SIGMA = 0.02
# Share of a tag's side by which its bits may lie elsewhere than the corners of its outline say, as bent sheets have
# it, and lenses; px of it at a side of 100 px, for it grows with the square.
_WARP, _WARP_OF_100 = 0.02, 0.5
# Shares of that by which edges are felt beyond their blur, in turn; steps of Gauss and Newton for each and at last.
_NEARER, _STEPS, _LAST_STEPS = (1.0, 0.5, 0.2, 0.0), 3, 2
# Side of a cell, px and blurs, below which bits run into each other.
_LEAST_CELL, _LEAST_BLURS = 2.0, 1.5
# Share of the contrast that the fit may leave unexplained: more, and something lies over the bits.
_UNEXPLAINED = 0.25
# Share by which the outline's blur is wrong, as a logarithm; share of the contrast by which light and ink may slope.
_BLUR_SPREAD, _SLOPE = 0.3, 0.5


@dataclass(frozen=True, eq=False)
class _Inside:
    """Pixels within tags: grey levels (N, M); place (N, 2, M) along u and v in cells, scale (N, 2, M): cells a px
    along either; plane (N, 3, M) and warp (N, 6, M): polynomials over the tag."""

    levels: Ints
    place: Singles
    scale: Singles
    plane: Singles
    warp: Singles


def tone_from_tags(grey: Picture, corners: Floats, blur: Floats, bits: Floats, tone: Tone) -> Tone:
    """The tone by the insides of the tags, or as it is where none is large and sharp enough.

    grey (h, w); corners (N, 4, 2) px of the outlines, top left first and clockwise on the print; blur (N,) px;
    bits (N, cells, cells), 0 black and 1 white, the black border included; tone: to begin with.
    """
    cells = bits.shape[1]
    cell = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).min(axis=1) / cells
    whole = ((corners > 1) & (corners < np.array(grey.shape[::-1]) - 2)).all(axis=(1, 2))
    usable = np.flatnonzero(whole & bits.any(axis=(1, 2)) & (cell > np.maximum(_LEAST_CELL, _LEAST_BLURS * blur)))
    if not len(usable):
        return tone
    best = usable[np.argsort(cell[usable] / blur[usable])[-_TAGS:]]
    corners, blur, cell, bits = corners[best], blur[best], cell[best], bits[best]
    warp = np.minimum(_WARP * cells * cell, _WARP_OF_100 * (cells * cell / 100) ** 2)
    edges = np.count_nonzero(np.diff(bits, axis=1), axis=(1, 2)) + np.count_nonzero(
        np.diff(bits, axis=2), axis=(1, 2)
    )
    places = _PLACES // max(len(best), 2)
    parameters = np.zeros((len(best), 19))  # dark and its slopes, contrast and its, warp along u and v, log blur
    for share in _NEARER if (warp > blur).any() else _NEARER[-1:]:
        reach = np.minimum((3 * blur + _BESIDE + share * warp) / cell, 0.5)
        grid = np.stack([_beside_bits(one, far, places) for one, far in zip(bits, reach, strict=True)])
        seen = _inside(grey, corners, grid, parameters[:, 6:18], cells)
        # Every pixel is one measurement, however often a small tag's is met.
        once = np.minimum(1.0, edges * 2 * reach * cell**2 / places)
        parameters[:, 18] = np.log(np.maximum(blur, share * warp / 2))
        fit = _Fit(seen, _mixed_differences(bits), once[:, None].astype(np.float32), parameters[:, 18].copy())
        for _ in range(_STEPS if share > 0 else _LAST_STEPS):
            parameters, tone = fit.step(parameters, tone, close=share == 0)
    return tone.doubted(_MODEL_SIGMA)


@dataclass(frozen=True, eq=False)
class _Fit:
    """What the steps share: the pixels, the bits' mixed differences (N, G, G), what a pixel counts for (N, 1),
    and the logarithm of the blur (N,) they begin with, px."""

    seen: _Inside
    corner_of: Singles
    once: Singles
    log_blur: Floats

    def step(self, parameters: Floats, tone: Tone, close: bool) -> tuple[Floats, Tone]:
        """Parameters (N, 19) after a step of Gauss and Newton; where close, the tone after what they show of it."""
        light = tone.table()[self.seen.levels]
        if not parameters[:, 3].any():
            parameters[:, 0], parameters[:, 3] = np.percentile(light, 10, axis=1), np.ptp(light, axis=1)
        model, jacobian = _model(parameters, self.seen, self.corner_of)
        residual, contrast = light - model, np.abs(parameters[:, 3])
        least = LEAST_NOISE * tone.by_grey(parameters[:, :1] + parameters[:, 3:4] * [0, 1])
        variance = variance_of_sides(residual, jacobian[:, 3], np.ones_like(light), least, parameters.shape[1])
        weight = self.once / variance
        prior = np.zeros_like(parameters)
        prior[:, [1, 2, 4, 5]] = 1 / (_SLOPE * contrast + 1)[:, None] ** 2
        prior[:, 6:18], prior[:, 18] = 1 / (2 * _WARP * self.corner_of.shape[1]) ** 2, 1 / _BLUR_SPREAD**2
        pull = -parameters
        pull[:, 18] += self.log_blur
        step, inverse = damped_step(jacobian, residual, weight, prior, pull)
        evidence = tone_evidence(tone.changes(model, 1), residual, jacobian, weight, inverse)
        explained = np.sqrt(variance.mean(axis=1)) < _UNEXPLAINED * contrast
        after = _updated(tone, evidence, explained) if close else tone
        if not close:
            # Edges are felt from afar as soft as they were taken to be.
            step[:, 18] = 0
        parameters = parameters + step
        follow = evidence.follow @ after.beyond(tone, 1)
        return _read_anew(parameters, follow, tone, after), after


def _beside_bits(bits: Floats, reach: float, count: int) -> Floats:
    """Places (count, 2), in cells, within reach of the edges between black and white bits."""
    rows, columns = np.nonzero(np.diff(bits, axis=1))
    upright = np.stack([columns + 1, rows + 0.5], axis=1)
    rows, columns = np.nonzero(np.diff(bits, axis=0))
    level = np.stack([columns + 0.5, rows + 1], axis=1)
    middle = np.concatenate([upright, level])
    size = np.concatenate([np.tile([reach, 0.5], (len(upright), 1)), np.tile([0.5, reach], (len(level), 1))])
    # The R2 sequence fills a square evenly and in step with nothing: powers of the root of x^3 = x + 1.
    number = np.arange(count)
    spread = 2 * (number[:, None] * np.array([0.7548776662466927, 0.5698402909980532]) % 1) - 1
    edge = number % len(middle)
    return np.asarray(middle[edge] + spread * size[edge], float)


def _mixed_differences(bits: Floats) -> Singles:
    """Of bits (N, cells, cells) in a white ring, at the lines between cells: (N, cells + 1, cells + 1) along v, u."""
    padded = np.pad(bits, ((0, 0), (1, 1), (1, 1)), constant_values=1.0)
    return np.diff(np.diff(padded, axis=1), axis=2).astype(np.float32)


def _read_anew(parameters: Floats, follow: Floats, tone: Tone, after: Tone) -> Floats:
    """The parameters as another tone has them. Dark, contrast and their slopes by the same grey values: in dark
    pictures the light changes by so much that its derivative by gamma does not say."""
    parameters = np.concatenate([parameters[:, :6], parameters[:, 6:] + follow[:, 6:]], axis=1)
    dark = after.light(tone.grey(parameters[:, 0]))
    contrast = after.light(tone.grey(parameters[:, 0] + parameters[:, 3])) - dark
    parameters[:, [1, 2, 4, 5]] *= (contrast / np.where(parameters[:, 3] == 0, 1, parameters[:, 3]))[:, None]
    parameters[:, 0], parameters[:, 3] = dark, contrast
    return parameters


def _inside(grey: Picture, corners: Floats, grid: Floats, warp: Floats, cells: int) -> _Inside:
    unit = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    image_from_unit = local_homographies(np.broadcast_to(unit, corners.shape), corners)
    around = np.swapaxes(2 * grid / cells - 1, 1, 2)
    shift = np.stack(
        [np.sum(part[..., None] * _powers(around), axis=1) for part in np.split(warp, 2, axis=1)], axis=1
    )
    whole = np.rint(mapped(image_from_unit, np.swapaxes(around - 2 / cells * shift, 1, 2))).astype(int)
    unit_from_image = np.linalg.inv(image_from_unit).astype(float)
    places = mapped(unit_from_image, whole)
    g = unit_from_image[:, None]
    depth = whole[..., 0] * g[..., 2, 0] + whole[..., 1] * g[..., 2, 1] + g[..., 2, 2]
    gradient = (g[..., :2, :2] - places[..., None] * g[..., 2:, :2]) / depth[..., None, None]
    unit_places = np.swapaxes(places, 1, 2).astype(np.float32)
    height, width = grey.shape
    powers = _powers(unit_places)
    return _Inside(
        grey[np.clip(whole[..., 1], 0, height - 1), np.clip(whole[..., 0], 0, width - 1)],
        (unit_places + 1) * np.float32(cells / 2),
        np.swapaxes(np.linalg.norm(gradient, axis=-1), 1, 2).astype(np.float32) * np.float32(cells / 2),
        powers[:, :3],
        powers,
    )


def _powers(places: Reals) -> Reals:
    """1, x, y, x^2, x y, y^2 (N, 6, M) of places (N, 2, M)."""
    x, y = places[:, 0], places[:, 1]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


def _model(parameters: Floats, seen: _Inside, corner_of: Singles) -> tuple[Singles, Singles]:
    """Light (N, M) of blurred bits and its derivatives (N, 19, M). corner_of (N, G, G): mixed differences of the bits
    at the lines between cells, along v and u; the bits are the sum of so many products of a step along either."""
    columns: Singles = parameters.astype(np.float32)[..., None]
    dark, contrast, blur = columns[:, :3], columns[:, 3:6], np.exp(columns[:, 18:])
    lines = np.arange(corner_of.shape[1], dtype=np.float32)
    steps, slopes, widenings = [], [], []
    for axis, warp in enumerate((columns[:, 6:12], columns[:, 12:18])):
        scale = seen.scale[:, axis, :, None]
        place = seen.place[:, axis] + np.sum(warp * seen.warp, axis=1)
        step, slope, widen = soft_step((place[..., None] - lines) / scale, blur)
        steps.append(step)
        slopes.append(slope / scale)
        widenings.append(widen * blur)
    across = steps[1] @ corner_of, steps[0] @ np.swapaxes(corner_of, 1, 2)
    white = 1 + np.sum(steps[0] * across[0], axis=-1)
    by_u, by_v = (np.sum(slope * other, axis=-1) for slope, other in zip(slopes, across, strict=True))
    by_blur = np.sum(widenings[0] * across[0] + widenings[1] * across[1], axis=-1)
    height = np.sum(contrast * seen.plane, axis=1)
    model = np.sum(dark * seen.plane, axis=1) + height * white
    parts = [
        seen.plane,
        seen.plane * white[:, None],
        seen.warp * (height * by_u)[:, None],
        seen.warp * (height * by_v)[:, None],
        (height * by_blur)[:, None],
    ]
    return model, np.concatenate(parts, axis=1)


def _updated(tone: Tone, evidence: Evidence, explained: Mask) -> Tone:
    """The tone after the evidence of the tags that are what they are taken for."""
    return tone.updated(evidence.pull[explained].sum(axis=0), evidence.weight[explained].sum(axis=0))
