"""A blank sheet, lighter or darker than what it lies on: its four corners from its four edges."""

from dataclasses import dataclass

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Ints, Picture
from quadrig.single.detect.pictures import reduced
from quadrig.single.subpixel.edge_fit import fit_outline
from quadrig.single.subpixel.tone import USUAL_TONE, LightImage

# Search at no more pixels than this along the image's longer side: a sheet is large.
_SEARCH_SIDE = 640
# Share of the image's area below which a blank quadrilateral is not taken for the sheet.
_LEAST_AREA = 0.004
# Grey levels from sheet to ground.
_LEAST_CONTRAST = 15.0
# px to either side of an edge that the first and the last fit look at, or three blurs where that is more.
_WIDE, _CLOSE = 8.0, 5.0
# rms of what the blurred straight edge leaves unexplained beside it, as share of the contrast.
_UNEXPLAINED = 0.25
# Standard deviation of grey within the sheet, as share of the contrast: a blank sheet bears no print.
_PRINT = 0.2
# A second sheet of this share of the first one's area makes the choice a guess.
_RIVAL = 0.4
# Lines of pixels across an edge that the last fit looks at: the shape of its profile needs many.
_LINES = 256
# Standard deviation of log gamma that the profile of an edge cannot take away: a curve that is an S looks to it much
# like a power, and moves the edge by more.
_CURVE_SIGMA = 0.15
# px that a real sheet's edge and corner depart from the model.
_MODEL_SIGMA = 0.02


@dataclass(frozen=True, eq=False)
class FoundSheet:
    """A sheet in a picture: corners (4, 2) px, clockwise; sigma px of each coordinate, and the error (4, 2) px that
    all corners share."""

    corners: Floats
    sigma: float
    common: Floats


def find_blank_sheet(grey: Picture) -> FoundSheet | None:
    """The one blank sheet in a picture, wholly in sight; None where there is none or no telling."""
    fitted = [fit for fit in (_fit(grey, quad) for quad in _candidates(grey)) if fit is not None]
    fitted.sort(key=lambda sheet: -cv2.contourArea(sheet.corners.astype(np.float32)))
    return _undisputed(fitted)


def _candidates(grey: Picture) -> list[Floats]:
    """Rough convex quadrilaterals (4, 2) px, clockwise, that any threshold cuts out of the picture."""
    scale = min(1.0, _SEARCH_SIDE / max(grey.shape))
    small = cv2.GaussianBlur(reduced(grey, scale), (0, 0), 1.0)
    low, high = np.percentile(small, [1, 99])
    quads: list[Floats] = []
    for threshold in np.linspace(low, high, 16)[1:-1]:
        _, mask = cv2.threshold(small, float(threshold), 255, cv2.THRESH_BINARY)
        contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
        for contour in contours:
            quad = _quad(np.asarray(contour, np.int32), small.shape)
            if quad is not None and not any(np.abs(quad - other).max() < 3 for other in quads):
                quads.append(quad)
    return [(quad + 0.5) / scale - 0.5 for quad in quads]


def _quad(contour: Ints, shape: tuple[int, ...]) -> Floats | None:
    hull = cv2.convexHull(contour)
    area = cv2.contourArea(contour)
    if area < _LEAST_AREA * shape[0] * shape[1] or area < 0.9 * cv2.contourArea(hull):
        return None
    bend = 0.02 * cv2.arcLength(hull, closed=True)
    polygon = cv2.approxPolyDP(hull, bend, closed=True).reshape(-1, 2).astype(float)
    if len(polygon) != 4 or cv2.contourArea(polygon.astype(np.float32)) < 0.92 * area:
        return None
    if (polygon < 2).any() or (polygon > np.array(shape[::-1]) - 3).any():
        return None
    turn = np.cross(np.append(polygon[1] - polygon[0], 0), np.append(polygon[2] - polygon[1], 0))[2]
    return polygon if turn > 0 else polygon[::-1].copy()


def _fit(grey: Picture, quad: Floats) -> FoundSheet | None:
    corners, tone = quad[None], USUAL_TONE
    span = np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1).min()
    # First wide, since the search was coarse, then close to the edge, where the ground's texture counts less.
    blur = 0.0
    for wide, most in ((_WIDE, 64), (_CLOSE, 96), (_CLOSE, _LINES)):
        reach = min(max(wide, 3 * blur), 0.2 * span)
        outline = fit_outline(LightImage(grey, tone), corners, np.full((1, 4), reach), most=most)
        blur = float(np.median(outline.fit.blur))
        better = tone.updated(outline.pull[0], outline.weight[0])
        corners = outline.corners + outline.by_gamma * np.log(better.gamma / tone.gamma)
        tone = better
        if not np.isfinite(corners).all() or np.abs(corners[0] - quad).max() > 0.1 * span + 4:
            return None
    if (corners < 3).any() or (corners > np.array(grey.shape[::-1]) - 4).any():
        # What the image's own edge cuts off has no corner there.
        return None
    fit = outline.fit
    contrast = float(np.abs(fit.grey_contrast).min())
    if contrast < _LEAST_CONTRAST or len(set(np.sign(fit.contrast))) > 1:
        return None
    if np.any(fit.noise > _UNEXPLAINED * np.abs(fit.contrast)) or not _blank(grey, corners[0], contrast):
        return None
    sigma = float(np.hypot(np.sqrt(np.mean(outline.sigma**2)), _MODEL_SIGMA))
    return FoundSheet(corners[0], sigma, tone.doubted(_CURVE_SIGMA).sigma * outline.by_gamma[0])


def _blank(grey: Picture, corners: Floats, contrast: float) -> bool:
    """Whether what lies within is of one tone, but for a slow change of light."""
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
    return float(np.std(left)) < _PRINT * contrast


def _undisputed(fitted: list[FoundSheet]) -> FoundSheet | None:
    if not fitted:
        return None
    largest = fitted[0].corners.astype(np.float32)
    area = cv2.contourArea(largest)
    for other in (sheet.corners for sheet in fitted[1:]):
        apart = cv2.pointPolygonTest(largest, tuple(other.mean(axis=0).tolist()), measureDist=False) < 0
        if apart and cv2.contourArea(other.astype(np.float32)) > _RIVAL * area:
            return None
    return fitted[0]
