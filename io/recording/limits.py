"""How large what is read may claim to be: checked before it is decoded, since a few bytes can claim terabytes."""

import os

from quadrig.single.errors import QuadrigError

LARGEST = "RIG_LARGEST"
"""The environment variable that raises the limit; worker processes inherit it. In megapixels."""

# Above the sensors that people calibrate (the largest on sale have 100 to 150 million pixels, 102 in one piece), and
# low enough that the most wasteful coding of so many pixels, a progressive JPEG in full colour, needs a gigabyte.
_MEGAPIXELS = 128
# Of a pixel in colour, which is what the limit is meant for: wider samples count for more.
_PIXEL_BYTES = 3


def most_pixels() -> int:
    """The most pixels that a picture may have. Raises QuadrigError where RIG_LARGEST is no number."""
    given = os.environ.get(LARGEST, "")
    if not given:
        return _MEGAPIXELS * 10**6
    if not given.isdigit() or int(given) == 0:
        raise QuadrigError(f"{LARGEST} is {given!r}; give the megapixels of the largest picture, a whole number")
    return int(given) * 10**6


def most_bytes() -> int:
    """The most bytes that one chunk of a recording may unfold to: one uncompressed picture of the most pixels."""
    return most_pixels() * _PIXEL_BYTES


def too_many_pixels(width: int, height: int, pixel_bytes: int = _PIXEL_BYTES) -> str:
    """Why a picture of this size is not decoded, or ""."""
    most = most_pixels()
    cost = width * height * max(pixel_bytes, _PIXEL_BYTES) // _PIXEL_BYTES
    if cost <= most:
        return ""
    return f"{width}x{height} px is beyond the limit of {most // 10**6} megapixels; {_raised(cost)}"


def too_many_bytes(size: int) -> str:
    """Why a chunk that unfolds to this size is not decompressed, or ""."""
    if size <= most_bytes():
        return ""
    return f"{size / 1e6:.0f} MB is beyond the limit of {most_bytes() // 10**6} MB; {_raised(size // _PIXEL_BYTES)}"


def _raised(pixels: int) -> str:
    return f"where that is meant, {LARGEST}={-(-pixels // 10**6)} raises it"
