"""Where the middle of a dark or light ellipse lies to a fraction of a pixel."""

from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats, Singles
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
from quadrig.single.subpixel.tone import LightImage

# px to either side of an outline that are looked at, where neighbours leave as much room: three blurs of a soft lens.
_BAND = 6.0
# Share by which light changes from one pixel to the next, at most: a soft shadow over a circle.
_SHADING = 0.01
# x, y, three of the shape, log blur, light within, share by which light changes along x and y, step to light beyond.
_UNKNOWNS = 10


@dataclass(frozen=True, eq=False)
class EllipseFit:
    """Ellipses |shape (pixel - middle)| = 1: middle `pixels` (N, 2) px, shape (N, 2, 2) symmetric, per px; sigma (N,)
    px a coordinate of the middle; noise, contrast (N,) in light, grey_contrast (N,) in grey levels; blur (N,) px."""

    pixels: Floats
    shape: Floats
    sigma: Floats
    noise: Floats
    contrast: Floats
    grey_contrast: Floats
    blur: Floats


def fit_ellipses(image: LightImage, pixels: Floats, shape: Floats, room: float) -> EllipseFit:
    """Fit ellipses of one light on another near pixels (N, 2) and shape (N, 2, 2).

    room: how much larger an ellipse may grow, as a share of itself, before it meets its neighbours.
    The model is the blurred edge in light. A tone curve that it does not know moves the outline alike on all sides,
    and leaves the middle.
    """
    places, light, weight = _pixels_around(image, pixels, shape, room)
    count = len(pixels)
    parameters = np.zeros((count, _UNKNOWNS))
    parameters[:, 2:5] = shape[:, [0, 0, 1], [0, 1, 1]]
    parameters[:, 5] = USUAL_BLUR
    outside = _model(parameters, places)[1][:, 9]
    parameters[:, 6] = weighted_mean(light, weight * (1 - outside))
    parameters[:, 9] = weighted_mean(light, weight * outside) - parameters[:, 6]
    noise, excess, inverse = np.full(count, 4.0), np.ones(count), np.zeros((count, _UNKNOWNS, _UNKNOWNS))
    active = np.arange(count)
    for iteration in range(ITERATIONS):
        now = parameters[active]
        model, jacobian = _model(now, places[active])
        residual, w = light[active] - model, weight[active]
        least = LEAST_NOISE * image.tone.by_grey(now[:, 6:7] + now[:, 9:] * [0, 1])
        variance = variance_of_sides(residual, jacobian[:, 9], w, least, 9)
        noise[active] = np.sqrt(weighted_mean(variance, w))
        w = w / variance
        prior, pull = np.zeros((2, len(active), _UNKNOWNS))
        prior[:, 5] = 1 / BLUR_SPREAD**2
        prior[:, 7:9] = 1 / _SHADING**2
        pull[:, 5] = USUAL_BLUR - now[:, 5]
        pull[:, 7:9] = -now[:, 7:9]
        step, inverse[active] = damped_step(jacobian, residual, w, prior, pull)
        step[:, :2] = np.clip(step[:, :2], -1.0, 1.0)
        # A tenth of its size at a time: the outline's derivative holds near the outline.
        most = 0.1 * np.abs(shape[active]).max(axis=(1, 2))[:, None]
        step[:, 2:5] = np.clip(step[:, 2:5], -most, most)
        step[:, 5] = np.clip(step[:, 5], -0.5, 0.5)
        parameters[active] = now + step
        parameters[:, 5] = np.clip(parameters[:, 5], np.log(SHARPEST), np.log(SOFTEST))
        parameters[:, 7:9] = np.clip(parameters[:, 7:9], -3 * _SHADING, 3 * _SHADING)
        rest = settled(step[:, :2], step[:, 5]) | (iteration == ITERATIONS - 1)
        excess[active[rest]] = place_excess(jacobian[rest], (w * residual)[rest], inverse[active[rest]], slice(0, 2))
        active = active[~rest]
        if not len(active):
            break
    # One ellipse says little of how its pixels hang together; all of them say it.
    shared = np.maximum(np.mean(excess), 1)
    sigma = np.sqrt(shared * np.maximum(inverse[:, 0, 0] + inverse[:, 1, 1], 0) / 2)
    within, contrast = parameters[:, 6], parameters[:, 9]
    grey_contrast = image.tone.grey(within + contrast) - image.tone.grey(within)
    shape = parameters[:, [2, 3, 3, 4]].reshape(-1, 2, 2)
    return EllipseFit(
        pixels + parameters[:, :2], shape, sigma, noise, contrast, grey_contrast, np.exp(parameters[:, 5])
    )


def _pixels_around(image: LightImage, pixels: Floats, shape: Floats, room: float) -> tuple[Singles, Singles, Singles]:
    """Places (N, P, 2) px about each middle, light and weight (N, P) of the pixels near each outline."""
    half = np.linalg.norm(np.linalg.inv(shape), axis=2).max()
    wide = int(np.ceil(min(half + _BAND, half * (1 + room)))) + 1
    steps = np.arange(-wide, wide + 1)
    window = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    places = (np.rint(pixels)[:, None] + window - pixels[:, None]).astype(np.float32)
    distance, _, q = _distance(places[..., 0], places[..., 1], shape[:, [0, 0, 1], [0, 1, 1]])
    near = (np.abs(distance) < _BAND) & (q < 1 + room)
    # What is far from the outline is left out altogether: of large circles that is nearly all.
    most = int(near.sum(axis=1).max())
    chosen = np.argsort(~near, axis=1, kind="stable")[:, :most]
    near = np.take_along_axis(near, chosen, axis=1)
    places = np.take_along_axis(places, chosen[..., None], axis=1)
    whole = np.rint(places + pixels[:, None]).astype(int)
    light, inside = image.at(whole[..., 0], whole[..., 1])
    return places, light, (near & inside).astype(np.float32)


def _distance(u: Singles, v: Singles, shape: Floats) -> tuple[Singles, tuple[Singles, Singles], Singles]:
    """px from the outline outwards (to first order; Sampson, 1982), what shape makes of each place, and its length:
    of places (N, P) about the middle and shape (N, 3) as xx, xy, yy."""
    xx, xy, yy = shape.astype(np.float32).T[..., None]
    a, b = xx * u + xy * v, xy * u + yy * v
    q = np.maximum(np.hypot(a, b), 1e-3)
    slope = np.maximum(np.hypot(xx * a + xy * b, xy * a + yy * b) / q, 1e-6)
    return (q - 1) / slope, (a, b), q


def _model(parameters: Floats, places: Singles) -> tuple[Singles, Singles]:
    x, y, xx, xy, yy, log_blur, within, slope_x, slope_y, contrast = parameters.astype(np.float32).T[..., None]
    blur = np.exp(log_blur)
    u, v = places[..., 0] - x, places[..., 1] - y
    distance, (a, b), _ = _distance(u, v, parameters[:, 2:5])
    outside, slope, widen = soft_step(distance, blur)
    normal_x, normal_y = xx * a + xy * b, xy * a + yy * b
    length = np.maximum(np.hypot(normal_x, normal_y), 1e-6)
    jacobian = np.zeros((len(x), _UNKNOWNS, u.shape[1]), np.float32)
    across = contrast * slope / length
    jacobian[:, 0], jacobian[:, 1] = -across * normal_x, -across * normal_y
    jacobian[:, 2], jacobian[:, 3], jacobian[:, 4] = across * a * u, across * (a * v + b * u), across * b * v
    jacobian[:, 5] = contrast * widen * blur
    jacobian[:, 6] = 1
    jacobian[:, 9] = outside
    # Uneven light is uneven on paper; ink has little of it to be uneven.
    even, shade = within + contrast * outside, 1 + slope_x * places[..., 0] + slope_y * places[..., 1]
    jacobian *= shade[:, None]
    jacobian[:, 7], jacobian[:, 8] = even * places[..., 0], even * places[..., 1]
    return even * shade, jacobian
