"""What becomes of light between the world and the file: shadows, glare, hands, the lens's blur, noise, tone, codec.

In the order in which it happens: uneven light, shadows and glare fall on the scene, hands lie before it, the lens
blurs and vignettes, the sensor adds noise, the camera's tone curve follows, then whole grey levels, then the codec.
That the curve comes after blur and noise is what moves edges in real pictures: on linear light they would stay.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from quadrig.single.arrays import Floats, Picture, Singles

# Places at which the noise of a picture may begin: two pictures of a recording hardly ever share one.
_STRIP = 1 << 20
# Steps within a pixel at which the outlines of shadows and hands are drawn.
_FINE = 4
# Blur (px) that is the same on whole pixels to some hundredths of a grey level, and takes a hundredth of the time.
_WIDE_BLUR = 4.0
# Linear light of a hand; it darkens towards its outline as round things do.
_SKIN, _ROUNDING = 0.34, 0.35


@dataclass(frozen=True)
class ToneCurve:
    """Grey values in [0, 1] of linear light in [0, 1]: a power with a straight start as in sRGB, then an S.

    gamma: light to the power 1/gamma. offset: of sRGB's formula, 0 for a plain power. s: share of the way from there
    to 3 v^2 - 2 v^3, as film and picture styles deepen shadows and soften highlights.
    """

    gamma: float = 1.0
    offset: float = 0.0
    s: float = 0.0

    def __call__(self, light: Singles) -> Singles:
        """Grey values of light, of any shape; light beyond white stays white."""
        light = np.clip(light, 0, 1)
        value = light if self.gamma == 1 else (1 + self.offset) * light ** (1 / self.gamma) - self.offset
        if self.offset > 0:
            # Where power and straight line through zero touch (IEC 61966-2-1).
            knee = self.offset / (self.gamma - 1)
            start = ((knee + self.offset) / (1 + self.offset)) ** self.gamma
            value = np.where(light < start, light * (knee / start), value)
        return value + self.s * value * (1 - value) * (2 * value - 1)


LINEAR = ToneCurve()
SRGB = ToneCurve(2.4, offset=0.055)
FILM = ToneCurve(2.2, s=0.7)


@dataclass(frozen=True)
class Shadow:
    """A shadow in the picture: outline (K, 2) px as tuples, share of the light it takes, penumbra (sigma, px)."""

    outline: tuple[tuple[float, float], ...]
    depth: float = 0.5
    softness: float = 0.0


@dataclass(frozen=True)
class Glare:
    """A lamp or window that shines back in the picture: outline (K, 2) px as tuples, light that it adds, 1 for white,
    and how softly it ends (sigma, px)."""

    outline: tuple[tuple[float, float], ...]
    light: float = 0.6
    softness: float = 3.0


@dataclass(frozen=True)
class Hand:
    """A hand before the scene: the tip of its middle finger (px), the direction in which it points (radians from +x
    towards +y), the width of a finger (px)."""

    tip: tuple[float, float]
    direction: float = 0.0
    finger: float = 24.0


@dataclass(frozen=True)
class Capture:
    """How a picture of linear light is taken; the default changes nothing but to whole grey levels.

    blur: sigma of the lens's Gaussian, px (all but the room's, which is soft already). noise: sigma of the sensor's,
    in 255ths of white light, before the curve. exposure: white light of 1 gives 255 at 1. vignetting: share of light
    lost in the corners. slope: share of light gained from the middle to the right and to the bottom edge. jpeg:
    quality, or None for no compression.
    """

    blur: float = 0.0
    noise: float = 0.0
    exposure: float = 1.0
    vignetting: float = 0.0
    slope: tuple[float, float] = (0.0, 0.0)
    shadows: tuple[Shadow, ...] = ()
    glares: tuple[Glare, ...] = ()
    hands: tuple[Hand, ...] = ()
    curve: ToneCurve = LINEAR
    jpeg: int | None = None


def take_picture(light: Singles, capture: Capture, rng: np.random.Generator | None = None) -> Picture:
    """The picture uint8 of linear light (h, w) or (h, w, 3), which sheets have blurred already and this changes.

    Noise is drawn from rng; from seed 0 where None.
    """
    for shadow in capture.shadows:
        light *= for_all_colours(1 - shadow.depth * _cover(light.shape, shadow, capture.blur), light)
    for glare in capture.glares:
        light += for_all_colours(glare.light * _cover(light.shape, glare, capture.blur), light)
    for hand in capture.hands:
        cover, tone = _hand_cover(light.shape, hand, capture.blur)
        light += for_all_colours(cover, light) * (for_all_colours(tone, light) - light)
    light *= for_all_colours(_illumination(light.shape, capture), light)
    if capture.noise > 0:
        rng = rng if rng is not None else np.random.default_rng(0)
        light += for_all_colours(_grain(light.shape[0], light.shape[1], rng) * np.float32(capture.noise / 255), light)
    if capture.curve != LINEAR:
        light = capture.curve(light)
    image = cv2.convertScaleAbs(np.maximum(light, 0, out=light), alpha=255)
    if capture.jpeg is not None:
        code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, capture.jpeg])[1]
        image = cv2.imdecode(code, cv2.IMREAD_UNCHANGED)
        assert image is not None
    return np.asarray(image, np.uint8)


def for_all_colours(one: Singles, light: Singles) -> Singles:
    """A value a pixel (h, w) in the shape that meets light, (h, w) or (h, w, 3)."""
    return one if light.ndim == 2 else one[..., None]


def _illumination(shape: Sequence[int], capture: Capture) -> Singles:
    height, width = shape[:2]
    light = _vignette(width, height, capture.vignetting) if capture.vignetting > 0 else np.float32(1)
    if any(capture.slope):
        x, y = np.linspace(-1, 1, width, dtype=np.float32), np.linspace(-1, 1, height, dtype=np.float32)
        light = light * np.maximum(1 + capture.slope[0] * x[None] + capture.slope[1] * y[:, None], 0)
    return np.broadcast_to(np.float32(capture.exposure) * light, (height, width))


def _cover(shape: Sequence[int], patch: Shadow | Glare, blur: float) -> Singles:
    cover = np.zeros((shape[0] * _FINE, shape[1] * _FINE), np.uint8)
    cv2.fillPoly(cover, [_fine(patch.outline)], 255)
    return _gathered(cover, float(np.hypot(blur, patch.softness)))


def _hand_cover(shape: Sequence[int], hand: Hand, blur: float) -> tuple[Singles, Singles]:
    """Share (h, w) of each pixel that the hand hides, and the hand's own light."""
    cover = np.zeros((shape[0] * _FINE, shape[1] * _FINE), np.uint8)
    along = np.array([np.cos(hand.direction), np.sin(hand.direction)])
    across = np.array([-along[1], along[0]])

    def limb(start: Floats, end: Floats, width: float) -> None:
        ends = _fine([tuple(start), tuple(end)])
        cv2.line(cover, ends[0].tolist(), ends[1].tolist(), 255, round(width * _FINE))

    palm = np.array(hand.tip) - 4.5 * hand.finger * along
    for finger, length in zip((-1.65, -0.55, 0.55, 1.65), (4.1, 4.5, 4.2, 3.4), strict=True):
        base = palm + finger * hand.finger * across
        # Half a finger's width lies beyond the end of its axis.
        limb(base, base + (length - 0.5) * hand.finger * (along + 0.04 * finger * across), hand.finger)
    limb(palm, palm - 1.5 * hand.finger * along, 4.4 * hand.finger)
    limb(palm, palm - 12 * hand.finger * along, 2.8 * hand.finger)
    whole = _gathered(cover, blur)
    inner = cv2.GaussianBlur(whole, (0, 0), 0.3 * hand.finger)
    return whole, (_SKIN * (1 - _ROUNDING + _ROUNDING * inner)).astype(np.float32)


def _fine(outline: Sequence[tuple[float, float]]) -> NDArray[np.int32]:
    return np.rint((np.array(outline) + 0.5) * _FINE - 0.5).astype(np.int32)


def _gathered(fine: Picture, blur: float) -> Singles:
    """A drawing (h, w) in [0, 1] of one of finer steps, blurred before the pixels gather it."""
    wide = blur > _WIDE_BLUR
    if blur > 0 and not wide:
        fine = np.asarray(cv2.GaussianBlur(fine, (0, 0), blur * _FINE), np.uint8)
    size = (fine.shape[1] // _FINE, fine.shape[0] // _FINE)
    gathered = cv2.resize(fine, size, interpolation=cv2.INTER_AREA).astype(np.float32) / np.float32(255)
    return np.asarray(cv2.GaussianBlur(gathered, (0, 0), blur), np.float32) if wide else gathered


def _grain(height: int, width: int, rng: np.random.Generator) -> Singles:
    """Normal noise (h, w): a random part of one long strip, since drawing it anew would take a third of the time."""
    start = int(rng.integers(0, _STRIP))
    return _strip(height * width + _STRIP)[start : start + height * width].reshape(height, width)


@lru_cache(maxsize=4)
def _strip(length: int) -> Singles:
    return np.random.default_rng(length).standard_normal(length, np.float32)


@lru_cache(maxsize=8)
def _vignette(width: int, height: int, strength: float) -> Singles:
    x = (np.arange(width, dtype=np.float32) - (width - 1) / 2) / (width / 2)
    y = (np.arange(height, dtype=np.float32) - (height - 1) / 2) / (height / 2)
    return (1 - strength * (x[None, :] ** 2 + y[:, None] ** 2) / 2).astype(np.float32)
