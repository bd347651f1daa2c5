"""Where a corner of a board lies to a fraction of a pixel."""

from dataclasses import dataclass, fields

import numpy as np

from quadrig.single.arrays import Floats, Ints, Singles
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

# px, and blurs, that stay clear between what is used around a corner and print beyond; px beside its lines that are
# used all the same.
_LEAST_CLEAR, _CLEAR_OF_BLUR = 1.2, 1.5
SHARP = _LEAST_CLEAR / _CLEAR_OF_BLUR
"""Blur, px, below which it takes away nothing of what is used around a corner."""


@dataclass(frozen=True, eq=False)
class CornerFit:
    """Board corners: pixels (N, 2), sigma (N,) px a coordinate; noise and contrast (N,) in light, grey_contrast (N,)
    in grey levels; blur (N,) px; pull (N, 1), weight (N, 1, 1): what each says of gamma, see Evidence."""

    pixels: Floats
    sigma: Floats
    noise: Floats
    contrast: Floats
    grey_contrast: Floats
    blur: Floats
    pull: Floats
    weight: Floats

    def changed(self, index: Ints, other: "CornerFit") -> "CornerFit":
        """The same with the corners of these indices taken from another fit."""
        parts = [(getattr(self, one.name).copy(), getattr(other, one.name)) for one in fields(self)]
        for whole, part in parts:
            whole[index] = part
        return CornerFit(*(whole for whole, _ in parts))


def fit_corners(
    image: LightImage,
    pixels: Floats,
    axes: Floats,
    radius: Floats,
    clear: float = np.inf,
    blur: float = 0.0,
) -> CornerFit:
    """Fit corners where four squares of a board meet, near pixels (N, 2).

    axes (N, 2, 2): px that one square's side spans along the board's columns and along its rows at each corner.
    radius (N,): px around the corner to use. clear: share of a square's side around each of the board's lines that is
    free of print (ChArUco boards have tags in the white squares). blur: px, as far as known.
    """
    wide = int(np.ceil(np.max(radius, initial=1.0))) + 1
    steps = np.arange(-wide, wide + 1)
    window = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    window = window[np.hypot(*window.T) < np.max(radius, initial=1.0) + 1.3][None]
    whole = np.rint(pixels).astype(int)[:, None] + window
    light, valid = image.at(whole[..., 0], whole[..., 1])
    places = whole - pixels[:, None]
    square = np.linalg.inv(np.swapaxes(axes, 1, 2))
    board = places @ np.swapaxes(square, 1, 2)
    weight = valid * np.clip(radius[:, None] + 0.5 - np.linalg.norm(places, axis=-1), 0, 1)
    # So much more stays clear for the blur of the tags' edges.
    pixel = np.array([max(_LEAST_CLEAR, _CLEAR_OF_BLUR * blur), _LEAST_CLEAR])
    beside, least = pixel[:, None, None] / np.min(np.linalg.norm(axes, axis=2), axis=1)[:, None]
    weight = weight * ~((np.abs(board) > np.maximum(clear - beside, least)[..., None]).all(axis=-1))
    places, weight = places.astype(np.float32), weight.astype(np.float32)
    return _corner_iterations(pixels, axes, places, light, weight, image.tone)


def _corner_iterations(
    pixels: Floats, axes: Floats, places: Singles, light: Singles, weight: Singles, tone: Tone
) -> CornerFit:
    count = len(pixels)
    parameters = np.zeros((count, 9))  # x, y, two angles, log blur, mean light, its slopes, half contrast
    parameters[:, 2:4] = np.arctan2(axes[:, :, 1], axes[:, :, 0])
    parameters[:, 4] = USUAL_BLUR
    parameters[:, 5] = weighted_mean(light, weight)
    pattern = _corner_model(parameters, places)[1][:, 8]
    parameters[:, 8] = np.sum(weight * pattern * (light - parameters[:, 5:6]), axis=1) / np.maximum(
        np.sum(weight * pattern**2, axis=1), 1e-9
    )
    noise = np.full(count, 4.0)
    inverse = np.zeros((count, 9, 9))
    pull_on, weight_on, excess = np.zeros((count, 1)), np.zeros((count, 1, 1)), np.ones(count)
    active = np.arange(count)
    for iteration in range(ITERATIONS):
        now, w = parameters[active], weight[active]
        model, jacobian = _corner_model(now, places[active])
        residual = light[active] - model
        least = LEAST_NOISE * tone.by_grey(now[:, 5:6] + now[:, 8:] * [-1, 1])
        variance = variance_of_sides(residual, (1 + jacobian[:, 8]) / 2, w, least, 8)
        noise[active] = np.sqrt(weighted_mean(variance, w))
        w = w / variance
        prior = np.zeros((len(active), 9))
        # The board's own lines are known to some degrees.
        prior[:, 2:4] = 1 / 0.15**2
        prior[:, 4] = 1 / BLUR_SPREAD**2
        prior[:, 6:8] = 1 / (0.05 * np.abs(now[:, 8]) + 0.1)[:, None] ** 2
        pull = np.zeros((len(active), 9))
        pull[:, 4] = USUAL_BLUR - now[:, 4]
        pull[:, 6:8] = -now[:, 6:8]
        step, inverse[active] = damped_step(jacobian, residual, w, prior, pull)
        step[:, :2] = np.clip(step[:, :2], -1.0, 1.0)
        step[:, 2:4] = np.clip(step[:, 2:4], -0.3, 0.3)
        step[:, 4] = np.clip(step[:, 4], -0.5, 0.5)
        parameters[active] = now + step
        parameters[:, 4] = np.clip(parameters[:, 4], np.log(SHARPEST), np.log(SOFTEST))
        rest = settled(step[:, :2], step[:, 4]) | (iteration == ITERATIONS - 1)
        if not rest.any():
            continue
        done, active = active[rest], active[~rest]
        jacobian, residual, w = jacobian[rest], residual[rest], w[rest]
        evidence = tone_evidence(tone.changes(model[rest], 1), residual, jacobian, w, inverse[done])
        pull_on[done], weight_on[done] = evidence.pull, evidence.weight
        excess[done] = place_excess(jacobian, w * residual, inverse[done], slice(0, 2))
        if not len(active):
            break
    # One window says little of how its pixels hang together; all of a board's say it.
    shared = np.maximum(np.mean(excess), 1)
    sigma = np.sqrt(shared * np.maximum(inverse[:, 0, 0] + inverse[:, 1, 1], 0) / 2)
    mean, half = parameters[:, 5], parameters[:, 8]
    grey_contrast = tone.grey(mean + half) - tone.grey(mean - half)
    blur = np.exp(parameters[:, 4])
    return CornerFit(pixels + parameters[:, :2], sigma, noise, 2 * half, grey_contrast, blur, pull_on, weight_on)


def _corner_model(parameters: Floats, places: Singles) -> tuple[Singles, Singles]:
    x, y, first, second, log_blur, mean, slope_x, slope_y, half = parameters.astype(np.float32).T[..., None]
    blur = np.exp(log_blur)
    dx, dy = places[..., 0] - x, places[..., 1] - y
    signs, by_distance, by_blur, distance_along = [], [], [], []
    for angle in (first, second):
        cos, sin = np.cos(angle), np.sin(angle)
        value, slope, widen = soft_step(cos * dy - sin * dx, blur)
        signs.append(2 * value - 1)
        by_distance.append(2 * slope)
        by_blur.append(2 * widen)
        distance_along.append(cos * dx + sin * dy)
    product = signs[0] * signs[1]
    model = mean + slope_x * places[..., 0] + slope_y * places[..., 1] + half * product
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
    return model, jacobian
