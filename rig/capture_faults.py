"""What goes wrong while pictures are taken, recognised from pictures and Views and said in words."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from quadrig.single.dictionaries import canonical_dictionary
from quadrig.single.rectangle import CharucoMarking, PlainMarking, Rectangle, TagMarking
from quadrig.single.rotation import Array
from quadrig.single.view import View

Picture = NDArray[np.uint8]
FaultKind = Literal[
    "blur", "motion", "too bright", "too dark", "held still", "wrong board", "wrong scale", "not static"
]

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
# Profiles reach this far (px) to both sides of an edge, and no farther than this part of the sheet's extent across
# it: the cells of a tag are an eighth of it, and the second next edge rises like the outer one. Shorter profiles
# than the last cannot show a sigma of 2.5.
_FARTHEST_PROFILE, _PROFILE_SHARE, _SHORTEST_PROFILE = 9.0, 0.15, 6.0


@dataclass(frozen=True)
class Fault:
    """Something that spoils a capture. sentence: what, where, what to do; camera "" where it concerns all."""

    kind: FaultKind
    sentence: str
    camera: str = ""


@dataclass(frozen=True)
class EdgeWidths:
    """Width of the edges round a View as Gaussian sigmas, px: of the sharpest and of the most smeared direction."""

    sharpest: float
    widest: float


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


def blur_fault(camera: str, widths: EdgeWidths) -> Fault | None:
    """Whether edges are so wide that corners are uncertain: in one direction (motion) or in all (focus)."""
    if not widths.widest > _BLUR_SIGMA:
        return None
    if widths.widest > _SMEAR_RATIO * widths.sharpest:
        return Fault("motion", f"{camera}: the sheet moves too fast; hold it still for a moment", camera)
    return Fault("blur", f"{camera}: the picture is out of focus; focus the lens on where the sheet is", camera)


def edge_widths(grey: Picture, view: View, samples: int = 12) -> EdgeWidths:
    """Widths of the straight edges between neighbouring corners of a View, nan where none is found.

    A profile across an edge is a step smeared by a Gaussian: the second moment of its slope is the sigma squared.
    Profiles are averaged in directions of 45 degrees, so that a smear shows as a direction that is wider.
    """
    corners = outer_corners(view)
    area = abs(float(cv2.contourArea(corners.astype(np.float32))))
    profiles = [_edge_profiles(grey, corners[k], corners[(k + 1) % 4], samples, area) for k in range(4)]
    kept = [(angle, sigma) for angle, sigmas in profiles for sigma in sigmas if np.isfinite(sigma)]
    if len(kept) < 4:
        return EdgeWidths(float("nan"), float("nan"))
    sector = np.array([round(angle / (np.pi / 4)) % 4 for angle, _ in kept])
    sigma = np.array([s for _, s in kept])
    medians = [float(np.median(sigma[sector == k])) for k in range(4) if np.count_nonzero(sector == k) >= 4]
    return EdgeWidths(min(medians), max(medians)) if medians else EdgeWidths(float("nan"), float("nan"))


def outer_corners(view: View) -> Array:
    """Pixels (4, 2) of the points that lie farthest out in the rectangle, in the order of Eq. 4."""
    directions = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], float)
    centred = view.points[:, :2] - view.points[:, :2].mean(0)
    return view.pixels[np.argmax(centred @ directions.T, axis=0)]


def _edge_profiles(grey: Picture, start: Array, end: Array, samples: int, area: float) -> tuple[float, list[float]]:
    """Direction across the edge (rad, in [0, pi)) and each profile's sigma; none where the sheet is too small."""
    along = end - start
    length = float(np.linalg.norm(along))
    reach = min(_FARTHEST_PROFILE, _PROFILE_SHARE * area / max(length, 1.0))
    if reach < _SHORTEST_PROFILE:
        return 0.0, []
    across = np.array([-along[1], along[0]]) / length
    offsets = np.arange(-reach, reach + 0.25, 0.5)
    middles = start + along * np.linspace(0.15, 0.85, samples)[:, None]
    places = (middles[:, None] + across * offsets[:, None]).astype(np.float32)
    values = cv2.remap(grey, places[..., 0], places[..., 1], cv2.INTER_LINEAR).astype(float)
    return float(np.arctan2(across[1], across[0]) % np.pi), [_step_width(v, offsets) for v in values]


def _step_width(values: Array, offsets: Array) -> float:
    """Sigma of a smeared step, nan where the profile holds no single step."""
    slope = np.gradient(values, offsets)
    sign = np.sign(slope[np.argmax(np.abs(slope))])
    slope = np.maximum(sign * slope, 0)
    # The flanks of neighbouring edges and noise lie below a tenth of the peak.
    slope = np.where(slope > 0.1 * slope.max(), slope, 0)
    total, height = slope.sum(), np.ptp(values)
    if height < 30 or total <= 0:
        return float("nan")
    middle = (slope * offsets).sum() / total
    return float(np.sqrt((slope * (offsets - middle) ** 2).sum() / total))


def _inside(grey: Picture, view: View) -> Array:
    corners = outer_corners(view)
    low = np.clip(np.floor(corners.min(0)), 0, None).astype(int)
    high = np.ceil(corners.max(0)).astype(int) + 1
    cut = grey[low[1] : high[1], low[0] : high[0]]
    mask = np.zeros(cut.shape, np.uint8)
    if cut.size:
        cv2.fillConvexPoly(mask, np.round(corners - low).astype(np.int32), 1)
    return cut[mask > 0]


def held_still_fault(seconds: float, patience: float = 4.0) -> Fault | None:
    """Said when nothing new was seen for `seconds` while the sheet was in view."""
    if seconds < patience:
        return None
    return Fault("held still", "the sheet has been seen like this already; move it, tilt it, show another part")


def wrong_board_fault(
    found: Mapping[str, Sequence[tuple[str, int]]], rectangles: Sequence[Rectangle]
) -> Fault | None:
    """Marks of boards that rig.toml does not know. found: for each camera the (dictionary, id) of its tags."""
    known = known_tags(rectangles)
    for camera, tags in found.items():
        foreign = [tag for tag in tags if tag not in known]
        if foreign and len(foreign) == len(tags):
            listed = ", ".join(f"{identity} of {dictionary}" for dictionary, identity in sorted(set(foreign))[:4])
            expected = ", ".join(_expected(r) for r in rectangles if not isinstance(r.marking, PlainMarking))
            return Fault(
                "wrong board",
                f"{camera} sees tag {listed}, which rig.toml does not name (it names {expected}); take the right "
                "sheet or correct rig.toml",
                camera,
            )
    return None


def known_tags(rectangles: Sequence[Rectangle]) -> set[tuple[str, int]]:
    """Every (dictionary, id) that belongs to a rectangle."""
    known: set[tuple[str, int]] = set()
    for rectangle in rectangles:
        marking = rectangle.marking
        if isinstance(marking, TagMarking):
            known.add((canonical_dictionary(marking.dictionary), marking.id))
        elif isinstance(marking, CharucoMarking):
            last = marking.first_id + (marking.columns * marking.rows + 1) // 2
            known |= {(canonical_dictionary(marking.dictionary), k) for k in range(marking.first_id, last)}
    return known


def _expected(rectangle: Rectangle) -> str:
    marking = rectangle.marking
    if isinstance(marking, TagMarking):
        return f"{marking.id} of {marking.dictionary}"
    if isinstance(marking, CharucoMarking):
        return f"a ChArUco board of {marking.dictionary}"
    return f"a {marking.kind}"


def not_static_fault(rectangle: str, camera: str) -> Fault:
    """Said of a rectangle that rig.toml calls static and that moved in a camera's picture."""
    return Fault(
        "not static",
        f"{rectangle} moves in the picture of {camera}, but rig.toml calls it static; set moving = true, or leave it "
        "and the camera alone",
        camera,
    )
