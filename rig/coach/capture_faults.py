"""What goes wrong while pictures are taken, recognised from pictures and Views and said in words."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from quadrig.rig.coach.edge_width import EdgeWidths, edge_widths
from quadrig.rig.coach.fault import Fault
from quadrig.rig.coach.in_hand import SHEET, InHand
from quadrig.single.arrays import Floats, Picture
from quadrig.single.detect.image_search import known_tags
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# Pixels this near to white have lost what was above them.
_CLIPPED = 252
# An exposed sheet has at most a few clipped glints; where half of its bright half is clipped the white spreads
# over the dark and moves every edge outwards.
_CLIPPED_SHARE = 0.5
# Where the brightest part of a sheet stays below this of 255, sensor noise is as large as its edges are steep.
_DARK = 45
# Width (sigma, px) of an edge: a sharp picture shows 0.5 to 1.0. At 2.5 a corner is already uncertain by half a
# pixel, and defocus moves it where the two sides of the edge differ in brightness.
_BLUR_SIGMA = 2.5
# Motion smears the edges across it and not those along it; optics smear all alike within this ratio.
_SMEAR_RATIO = 1.8
# Where nothing was found: width (sigma, px of a picture at half size) of the sharpest edges beyond which no usual tag
# is, and the grey levels that something that moved changed by. Pictures of webcams show 0.0 to 0.2.
_LOST_SIGMA, _MOVED = 1.0, 20
# Part of the picture that moves when a sheet does; above the last the camera itself, or the light, does.
_LEAST_MOVED, _MOST_MOVED = 0.003, 0.6


def exposure_fault(camera: str, grey: Picture, view: View) -> Fault | None:
    """Whether the sheet of a View is too bright or too dark to be measured. grey (H, W)."""
    values = _inside(grey, view)
    if values.size < 16:
        return None
    bright = values[values >= np.median(values)]
    if np.mean(bright >= _CLIPPED) > _CLIPPED_SHARE:
        return Fault(
            "too bright", f"{camera}: the sheet is over-exposed; dim the light or shorten the exposure", camera
        )
    if np.percentile(values, 95) < _DARK:
        return Fault("too dark", f"{camera}: the sheet is too dark; add light or lengthen the exposure", camera)
    return None


def blur_fault(camera: str, widths: EdgeWidths, held: InHand = SHEET) -> Fault | None:
    """Whether edges are so wide that corners are uncertain: in one direction (motion) or in all (focus).

    held: what is moved.
    """
    if not widths.widest > _BLUR_SIGMA:
        return None
    if widths.widest > _SMEAR_RATIO * widths.sharpest:
        return Fault("motion", f"{camera}: {held.noun} moves too fast; hold it still for a moment", camera)
    return _out_of_focus(camera)


def unreadable_fault(camera: str, half: Picture, before: Picture) -> Fault | None:
    """Why nothing is found in a picture: no light or too much, what moves in it is smeared, no edge in it is sharp.

    half, before: (H, W), the picture at half size and the one before it.
    """
    if np.mean(half >= _CLIPPED) > _CLIPPED_SHARE:
        return Fault(
            "too bright", f"{camera}: the picture is over-exposed; dim the light or shorten the exposure", camera
        )
    if np.percentile(half, 95) < _DARK:
        return Fault("too dark", f"{camera}: the picture is dark; uncover the lens, or add light", camera)
    moved = cv2.dilate((cv2.absdiff(half, before) > _MOVED).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    if _LEAST_MOVED < np.mean(moved) < _MOST_MOVED:
        widths = edge_widths(half, moved)
        if widths.widest > max(_LOST_SIGMA, _SMEAR_RATIO * widths.sharpest):
            return Fault("motion", f"{camera}: what moves is smeared; hold the sheet still for a moment", camera)
    return _out_of_focus(camera) if edge_widths(half).tenth > _LOST_SIGMA else None


def _out_of_focus(camera: str) -> Fault:
    return Fault("blur", f"{camera}: the picture is out of focus; focus the lens on where the sheet is", camera)


def outer_corners(view: View) -> Floats:
    """Pixels (4, 2) of the points that lie farthest out in the rectangle, in the order of Eq. 4."""
    directions = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], float)
    centred = view.points[:, :2] - view.points[:, :2].mean(0)
    return view.pixels[np.argmax(centred @ directions.T, axis=0)]


def _inside(grey: Picture, view: View) -> Picture:
    corners = outer_corners(view)
    low = np.clip(np.floor(corners.min(0)), 0, None).astype(int)
    high = np.ceil(corners.max(0)).astype(int) + 1
    cut = grey[low[1] : high[1], low[0] : high[0]]
    mask = np.zeros(cut.shape, np.uint8)
    if cut.size:
        cv2.fillConvexPoly(mask, np.round(corners - low).astype(np.int32), 1)
    return cut[mask > 0]


def held_still_fault(seconds: float, held: InHand = SHEET, patience: float = 4.0) -> Fault | None:
    """Said when nothing new was seen for `seconds` while something was in view. held: what is moved."""
    if seconds < patience:
        return None
    if held.is_room:
        return Fault("held still", "this has been seen from here already; carry the rig on, turn it, tilt it")
    return Fault("held still", f"{held.noun} has been seen like this already; move it, tilt it, show another part")


def wrong_board_fault(
    found: Mapping[str, Sequence[tuple[str, int]]], rectangles: Sequence[Rectangle]
) -> Fault | None:
    """Marks of boards that rig.toml does not know. found: for each camera the (dictionary, id) of its tags."""
    known = known_tags(rectangles)
    for camera, tags in found.items():
        foreign = [tag for tag in tags if tag not in known]
        if foreign and len(foreign) == len(tags):
            listed = ", ".join(f"{identity} of {dictionary}" for dictionary, identity in sorted(set(foreign))[:4])
            expected = ", ".join(rectangle.marking.description for rectangle in rectangles)
            return Fault(
                "wrong board",
                f"{camera} sees tag {listed}, which rig.toml does not name (it names {expected}); take the right "
                "sheet or correct rig.toml",
                camera,
            )
    return None


def not_static_fault(rectangle: str, camera: str) -> Fault:
    """Said of a rectangle that rig.toml calls static and that moved in a camera's picture."""
    return Fault(
        "not static",
        f"{rectangle} moves in the picture of {camera}, but rig.toml calls it static; set moving = true, or leave it "
        "and the camera alone",
        camera,
    )
