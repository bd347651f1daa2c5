"""A blank sheet, lighter or darker than what it lies on: its four corners from what is seen of its four edges."""

from dataclasses import dataclass

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Picture
from quadrig.single.detect.sheet_outlines import SEARCH_SIDE, sheet_outlines
from quadrig.single.subpixel.side_fit import Sides, fit_sides
from quadrig.single.subpixel.tone import USUAL_TONE, LightImage, Tone

# Grey levels from sheet to ground.
_LEAST_CONTRAST = 6.0
# px to either side of an edge that the first and the last fits look at, or three blurs where that is more.
_WIDE, _CLOSE = 8.0, 4.0
# Share of a side's pieces, and of all, that must show it, and of a side from a corner to where it is first seen.
_SEEN, _SEEN_OF_ALL, _FARTHEST = 0.15, 0.55, 0.85
# Factor between the steps of light, and between the light within, along two sides: a ground has textures, and a
# shadow may take two thirds.
_STEPS_APART, _LIGHTS_APART = 4.0, 4.0
# sigma (px) of a corner that is too far from what is seen of its sides.
_WORST_SIGMA = 0.8
# Standard deviation of grey within the sheet, as share of the contrast: a blank sheet bears no print.
_PRINT = 0.2
# Where that is more, by a hand or a shadow: how much darker or lighter than the sheet neither is, and the shares of
# the sheet that may be so, and that may lie at an edge of this share of the contrast.
_INK, _INKED, _EDGE, _EDGES = 8.0, 0.05, 0.25, 0.15
# Pieces of the sides before their first and after their last seen one that may show bare ground where the sheet
# should end: as many as a hand of the ground's colour hides of rendered sheets.
_BARE = 7
# Share of the outline by which one sheet is seen better than another, and factor between how uneven they are within,
# that decide which of two is meant, whatever their contrast.
_BETTER_SEEN, _LESS_EVEN = 0.1, 1.5
# A second sheet of this share of the first one's area makes the choice a guess.
_RIVAL = 0.4
# Standard deviation of log gamma that the profile of an edge of 1 px of blur cannot take away where it is asked for a
# power alone: a curve that is an S looks to it much like one, and moves the edge by more. It grows as blur falls,
# down to some, for a sharp edge shows less of its profile: film leaves 0.33 and 0.25 at blurs of 0.5 and 1 px.
_CURVE_SIGMA, _SHARP = 0.22, 0.4
# px of blur from which an edge is asked for the S, too, and what is then left: sigmoids and Reinhard's curve are none
# of these. JPEG changes the profile of a sharper edge by more than an S does: its S is 0.5 off at a blur of 0.5, 0.3
# at 1, and 0.1 at 2 px.
_SMOOTH, _CURVE_BESIDE_S = 1.5, 0.07
# px for each px of blur by which a corner may be off where white is cut off and nothing says by how much (twice the
# light that white needs: the middle of what is left of the step is so far beside the edge), and on light ground.
_CUT_OFF, _WASHED_OUT = 1.2, 2.0
# px that a real sheet's edge and corner depart from the model.
_MODEL_SIGMA = 0.02


@dataclass(frozen=True, eq=False)
class FoundSheet:
    """A sheet in a picture: corners (4, 2) px, clockwise; sigma px of each coordinate, and the error (4, 2) px that
    all corners share; contrast: grey levels of the faintest side; seen: share of the outline that shows it;
    uneven: standard deviation of grey within over the contrast."""

    corners: Floats
    sigma: float
    common: Floats
    contrast: float
    seen: float
    uneven: float


def find_blank_sheet(grey: Picture, middle: Floats) -> FoundSheet | None:
    """The one blank sheet in a picture, its corners in sight or between edges that are; None where there is none or
    no telling. middle (2,) px: of the whole picture, of which this may be a part."""
    for fine in (False, True):
        fitted = [fit for fit in (_fit(grey, quad, middle) for quad in sheet_outlines(grey, fine)) if fit is not None]
        if fitted:
            return _undisputed(fitted)
    return None


def _fit(grey: Picture, quad: Floats, middle: Floats) -> FoundSheet | None:
    corners, bow, blur, ground, tone = quad, np.zeros((4, 4)), 1.0, 0.0, USUAL_TONE
    span = np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1).min()
    # First wide, since the search was coarse, then close to the edge, where the ground's texture counts less.
    coarse = max(1.0, max(grey.shape) / SEARCH_SIDE)
    for wide in (_WIDE * coarse, _CLOSE, _CLOSE):
        reach = float(min(max(wide, 3 * blur), 0.2 * span))
        asked = 2 if blur > _SMOOTH else 1
        sides = fit_sides(LightImage(grey, tone), corners, bow, reach, blur, middle, ground, asked)
        if not _shows_four(sides):
            return None
        outline, ground = sides.outline, sides.ground
        blur = float(np.median(outline.fit.blur))
        better = tone.updated(outline.pull[0], outline.weight[0])
        corners = outline.corners[0] + np.tensordot(better.beyond(tone, asked), outline.by_tone[0], 1)
        tone, bow = better, sides.coefficients * [[0, 0, 1, 1]]
        bow[:, 0], bow[:, 1] = -bow[:, 2], -bow[:, 3]
        if not np.isfinite(corners).all() or np.abs(corners - quad).max() > 0.1 * span + 4 * coarse:
            return None
    if (corners < 3).any() or (corners > np.array(grey.shape[::-1]) - 4).any():
        # What the image's own edge cuts off has no corner there.
        return None
    contrast = float(np.abs(outline.fit.grey_contrast).min())
    if not _one_sheet(sides) or contrast < _LEAST_CONTRAST:
        return None
    uneven = _unevenness(grey, corners, contrast)
    if uneven is None:
        return None
    if outline.sigma.max() > _WORST_SIGMA:
        return None
    curve = _CURVE_SIGMA if asked == 1 else _CURVE_BESIDE_S
    common = _common(tone.doubted(curve / max(blur, _SHARP)), outline.by_tone[0])
    if outline.fit.clipped.any():
        most = (_WASHED_OUT if outline.fit.washed_out.any() else _CUT_OFF) * blur
        common *= max(1.0, most / max(float(np.linalg.norm(common, axis=1).mean()), 1e-6))
    sigma = np.hypot(outline.sigma[0], _MODEL_SIGMA)
    base, far = _far_corner(sides, sigma, common)
    return FoundSheet(corners, base, far, contrast, float(sides.seen.mean()), uneven)


def _common(tone: Tone, by_tone: Floats) -> Floats:
    """The error (4, 2) px that all corners share by what is left unknown of the tone: its unknowns move an outline
    nearly alike, so that the largest principal part is all but the whole. by_tone (D, 4, 2) px. Of gamma's sense, as
    other Views of the camera have it."""
    root = np.linalg.cholesky(tone.covariance[: len(by_tone), : len(by_tone)])
    by_each = by_tone.reshape(len(by_tone), -1)
    _, most, along = np.linalg.svd(root.T @ by_each, full_matrices=False)
    return (most[0] * np.sign(along[0] @ by_each[0]) * along[0]).reshape(4, 2)


def _far_corner(sides: Sides, sigma: Floats, common: Floats) -> tuple[float, Floats]:
    """Sigma (px) of all corners but the least sure, and the shared error (4, 2) with what is more of that one's.

    A corner far from what is seen of one of its sides is unsure along the other; a View has one sigma for all.
    """
    worst = int(np.argmax(sigma))
    base = float(np.delete(sigma, worst).max())
    before, after = np.argmax(sides.seen[worst - 1, ::-1]), np.argmax(sides.seen[worst])
    other = sides.corners[worst - 1] if after > before else sides.corners[(worst + 1) % 4]
    along = (sides.corners[worst] - other) / np.linalg.norm(sides.corners[worst] - other)
    # Sigma is the root mean square of two coordinates, of which one has it all.
    more = np.sqrt(2 * max(sigma[worst] ** 2 - base**2, 0.0)) * along
    far = common.copy()
    far[worst] += more if more @ common[worst] >= 0 else -more
    return base, far


def _shows_four(sides: Sides) -> bool:
    """Whether each side is seen over a good part of its length, and near both of its corners."""
    seen = sides.seen
    if (seen.mean(axis=1) < _SEEN).any() or seen.mean() < _SEEN_OF_ALL:
        return False
    if max(np.argmax(seen, axis=1).max(), np.argmax(seen[:, ::-1], axis=1).max()) > _FARTHEST * seen.shape[1]:
        return False
    # A bright patch beside a sheet ends in a line, too, but table lies where that would meet the sheet's own sides.
    before = np.cumsum(seen, axis=1) == 0
    after = np.cumsum(seen[:, ::-1], axis=1)[:, ::-1] == 0
    return bool(np.count_nonzero(sides.bare & (before | after)) <= _BARE)


def _one_sheet(sides: Sides) -> bool:
    """Whether the four sides end at the corners and have like steps of light and like light within."""
    step, light = np.abs(sides.step), np.maximum(sides.outline.fit.dark, 0.1)
    alike = step.max() < _STEPS_APART * step.min() and light.max() < _LIGHTS_APART * light.min()
    return bool(alike and not sides.goes_on.any())


def _unevenness(grey: Picture, corners: Floats, contrast: float) -> float | None:
    """How much grey varies within, over the contrast, but for a slow change of light; None where that is more than a
    shadow and a hand would do."""
    size = 48
    inset = corners.mean(axis=0) + 0.92 * (corners - corners.mean(axis=0))
    unit = np.array([[0, 0], [size, 0], [size, size], [0, size]], np.float32)
    image_from_unit = cv2.getPerspectiveTransform(unit, inset.astype(np.float32))
    inside = cv2.warpPerspective(
        cv2.blur(grey, (3, 3)), image_from_unit, (size, size), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    ).astype(float)
    y, x = np.mgrid[-1 : 1 : size * 1j, -1 : 1 : size * 1j]
    basis = np.stack([np.ones(size * size), x.ravel(), y.ravel()], axis=1)
    left = inside.ravel() - basis @ np.linalg.lstsq(basis, inside.ravel(), rcond=None)[0]
    uneven = float(np.std(left)) / contrast
    if uneven < _PRINT:
        return uneven
    light = USUAL_TONE.light(np.maximum(inside, 1))
    inked = np.abs(np.log(light / np.median(light))) > np.log(_INK)
    edges = np.hypot(*np.gradient(inside)) > _EDGE * contrast
    return uneven if inked.mean() < _INKED and edges.mean() < _EDGES else None


def _undisputed(fitted: list[FoundSheet]) -> FoundSheet | None:
    """The largest sheet, if there is no other like it. Of two that share ground the one is meant of which more is
    seen, or that is more even, or whose edges are clearer."""
    clear = [one for one in fitted if not any(_overlap(one, two) and _clearer(two, one) for two in fitted)]
    if not clear:
        return None
    largest = max(clear, key=_area)
    rival = any(one is not largest and _area(one) > _RIVAL * _area(largest) for one in clear)
    return None if rival else largest


def _clearer(one: FoundSheet, other: FoundSheet) -> bool:
    if abs(one.seen - other.seen) > _BETTER_SEEN:
        return one.seen > other.seen
    if max(one.uneven, other.uneven) > _LESS_EVEN * min(one.uneven, other.uneven):
        return one.uneven < other.uneven
    return one.contrast > other.contrast


def _area(sheet: FoundSheet) -> float:
    return cv2.contourArea(sheet.corners.astype(np.float32))


def _overlap(one: FoundSheet, other: FoundSheet) -> bool:
    """Whether the middle of either lies within the other."""
    return _holds(one, other) or _holds(other, one)


def _holds(one: FoundSheet, other: FoundSheet) -> bool:
    middle = other.corners.mean(axis=0).tolist()
    return cv2.pointPolygonTest(one.corners.astype(np.float32), middle, measureDist=False) >= 0
