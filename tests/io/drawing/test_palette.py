"""Colours that are read on dark grounds and on light ones."""

import numpy as np
import pytest

from quadrig.io.drawing import palette

# The grounds of rerun's themes and of the report's.
_DARK, _LIGHT = (22, 24, 30), (255, 255, 255)
_COLOURS = [
    *palette.camera_colours([f"cam{i}" for i in range(8)]).values(),
    *(palette.STATIC, palette.MOVING, palette.MOVED, palette.FOUND, palette.PREDICTED, palette.FAULT, palette.FINE),
]


def luminance(colour):
    """Relative luminance of sRGB, as the accessibility guidelines of the web define it."""
    part = np.array(colour) / 255
    return np.where(part <= 0.03928, part / 12.92, ((part + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722]


def contrast(one, other):
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("ground", [_DARK, _LIGHT])
@pytest.mark.parametrize("colour", _COLOURS)
def test_every_colour_is_read_on_both_grounds(colour, ground):
    # What the same guidelines ask of large text and of drawings.
    assert contrast(colour, ground) >= 3


def test_cameras_differ_in_colour():
    assert len(set(palette.camera_colours([f"cam{i}" for i in range(40)]).values())) == 40
