"""What a search makes of a picture first: grey, smaller, or the part around where something was seen before."""

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Picture
from quadrig.single.errors import QuadrigError

# A window around earlier pixels reaches this share of their extent, and px, beyond them.
_REACH, _LEAST_REACH = 0.45, 24


def grey_image(image: Picture) -> Picture:
    """The image (h, w) of a grey or blue-green-red one. Raises QuadrigError where it is neither, or empty."""
    image = np.asarray(image)
    if not image.size:
        raise QuadrigError(f"an image of shape {image.shape} has no pixels; give one that was read whole")
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3)):
        raise QuadrigError(
            f"an image of shape {image.shape} and type {image.dtype} cannot be searched; give 8-bit grey or colour"
        )
    if image.ndim == 2:
        return image
    return image[..., 0] if image.shape[2] == 1 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def reduced(grey: Picture, scale: float) -> Picture:
    """The picture at a smaller scale, each pixel the mean of what it covers; itself at a scale of 1."""
    if scale == 1:
        return grey
    width, height = (max(1, round(side * scale)) for side in grey.shape[::-1])
    return np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def window_around(grey: Picture, pixels: Floats) -> tuple[Picture, Floats]:
    """The part of a picture around pixels (P, 2) of an earlier one, and the pixel (2,) at which it begins."""
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    # Inner corners leave a square outside; a hand moves a board by a fraction of its size from picture to picture.
    reach = _REACH * np.max(high - low) + _LEAST_REACH
    low = np.clip(np.floor(low - reach), 0, None).astype(int)
    high = np.ceil(high + reach).astype(int) + 1
    return np.ascontiguousarray(grey[low[1] : high[1], low[0] : high[0]]), low.astype(float)
