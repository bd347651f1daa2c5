"""Colours that mean the same in every picture we draw, of middle tones that read on dark and on light grounds."""

from collections.abc import Sequence

from quadrig.rig.result import Rig

Colour = tuple[int, int, int]

# Distinguished by eye and by most who see few colours (after Okabe and Ito).
_CAMERAS: tuple[Colour, ...] = (
    (205, 125, 0), (40, 145, 205), (0, 158, 115), (200, 95, 155), (213, 94, 0), (0, 114, 178), (145, 135, 20),
    (150, 110, 220),
)  # fmt: skip
STATIC: Colour = (128, 128, 145)
MOVING: Colour = (90, 150, 70)
MOVED: Colour = (125, 145, 118)
FOUND: Colour = (40, 160, 70)
PREDICTED: Colour = (235, 106, 24)
FAULT: Colour = (225, 45, 45)
FINE: Colour = (120, 135, 150)
# On the dark ground of a live session: what is said, what is wrong, what is done and where to hold the sheet.
SAID: Colour = (235, 235, 235)
WARNING: Colour = (255, 180, 60)
DONE: Colour = (90, 220, 120)
SHEET: Colour = (200, 190, 150)


def camera_colours(names: Sequence[str]) -> dict[str, Colour]:
    """A colour for each camera by its number in the rig; beyond the palette's end darker rounds of it."""
    return {name: _round(index) for index, name in enumerate(names)}


def rig_colours(rig: Rig) -> dict[str, Colour]:
    """A colour for each camera of a rig."""
    return camera_colours([camera.name for camera in rig.cameras])


def hexadecimal(colour: Colour) -> str:
    """#rrggbb."""
    return "#" + "".join(f"{part:02x}" for part in colour)


def _round(index: int) -> Colour:
    fade = 0.75 ** (index // len(_CAMERAS))
    red, green, blue = _CAMERAS[index % len(_CAMERAS)]
    return int(red * fade), int(green * fade), int(blue * fade)
