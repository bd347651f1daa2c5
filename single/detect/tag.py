"""Tags: which squares of a dictionary are in an image, and their corners to sub-pixel accuracy."""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask, Picture
from quadrig.single.detect.blurred_bits import read_tags, ring
from quadrig.single.detect.dictionaries import tag_cells, tag_dictionary
from quadrig.single.detect.pictures import reduced
from quadrig.single.subpixel.edge_fit import CLIPPED, LIGHT_INK, EdgeFit, EdgeOptions, Outline, fit_outline
from quadrig.single.subpixel.local_homography import mapped, square_homographies
from quadrig.single.subpixel.tag_tone import tone_from_tags
from quadrig.single.subpixel.tone import USUAL_TONE, LightImage

EQ4_FROM_OPENCV = [2, 3, 0, 1]
"""OpenCV's order is top left, top right, bottom right, bottom left; Eq. 4's begins at the bottom right."""

# Longer side (px) of an image above which half of it is searched first: tags are large in large images.
_LARGE = 2000
# px that the fit may move a corner from where the outline's polygon put it, beside a tenth of the side: contours
# run through pixel centres and are up to a pixel off, more where blur is strong.
_FARTHEST = 2.5
# Share of the tag's contrast that each white cell around it must have over the black one beside it.
_LEAST_STEP = 0.25
# Cells within and beyond the edge where black and white are looked at: a third, for paper is often cut close.
_IN, _OUT = 0.5, -0.35
# Share of the border's cells that may look wrong before a tag is taken to be partly hidden.
_WRONG_CELLS = 0.08
# Grey levels between ink and paper below which nothing sure can be said.
_LEAST_CONTRAST = 12.0
# A side whose pixels leave more than this share of its contrast unexplained, and more than its fellows, is covered;
# where cells are few blurs wide their neighbours' light counts too: the share is then _LEAKING over cells in blurs.
_UNEXPLAINED, _LEAKING, _MOST_UNEXPLAINED = 0.05, 0.45, 0.12
# sigma (px) above which a fit has found no edge to hold on to.
_WORST_SIGMA = 0.4
# Side (px) of a tag at which the first fit is made: a bow of a fiftieth of it is within reach.
_FIT_SIDE = 80.0
# px to either side of an edge that the first and the last fit look at, where cells are wide enough.
_WIDE, _CLOSE = 8.0, 4.0
# px: a tag that moved less since the picture before, and blurs less, is where one close fit says.
_STILL, _SHARP = 1.0, 0.8
# Blur (px) beyond which an image of twice the size shows no more of an edge.
_SOFT = 1.5
# Standard deviation of log gamma that is more where white is cut off: light beyond white moves edges as a tone does,
# but not quite as the bits say (twice the light that white needs: by 0.17, one and a half times: by 0.07).
_CLIPPED_SIGMA = 0.15
# Change of the logarithm of light from a cell beside the tag to the next but one beyond which a shadow or glare ends
# there, since no lamp is so uneven, and px by which corners are then off for each unit of it (rendered shadows).
_UNEVEN, _BY_CHANGE = 0.18, 0.8
# px that the model of a straight blurred edge is wrong by on real lenses, added to what noise explains.
_MODEL_SIGMA = 0.01


# Perimeter (px) of the smallest tag looked for: smaller ones look like texture. In pictures wider than
# 1280 it grows with them, for the number of outlines to be looked at does.
_LEAST_PERIMETER, _LEAST_PERIMETER_RATE = 38.4, 0.03
# Kalibr's tags, whose border is wide, touch dark squares with their corners: the grey between counts as paper where
# ink is what lies so many grey levels below the mean around it (of 120 sharp tags 120 are found, else 73).
_TOUCHING, _TOUCHING_WINDOWS = 20, (5, 25)


@lru_cache(maxsize=256)
def _detector(
    dictionary: str, wanted: tuple[int, ...] | None, windows: tuple[int, int], perimeter_rate: float, border: int
) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border
    if border > 1:
        parameters.adaptiveThreshConstant = _TOUCHING
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    parameters.minMarkerPerimeterRate = perimeter_rate
    parameters.adaptiveThreshWinSizeMin, parameters.adaptiveThreshWinSizeMax = windows
    whole = tag_dictionary(dictionary)
    if wanted is None:
        return cv2.aruco.ArucoDetector(whole, parameters)
    # Comparing a candidate with all tags of a large dictionary takes ten times as long as finding it.
    few = cv2.aruco.Dictionary(whole.bytesList[list(wanted)].copy(), whole.markerSize, whole.maxCorrectionBits)
    return cv2.aruco.ArucoDetector(few, parameters)


def find_tags(
    grey: Picture,
    dictionary: str,
    wanted: Iterable[int] | None = None,
    boards: Iterable[frozenset[int]] = (),
    quick: bool = False,
    border: int = 1,
) -> dict[int, list[Floats]]:
    """Rough corners (4, 2) px, top left first and clockwise on the printed tag, of every tag seen, by id.

    wanted: the ids that matter; all of the dictionary where None. Passes over the image go from quick to slow, and
    to smaller images, where blur counts less, until all wanted tags are found; of the tags of a board (one set of
    ids each), until half of them are. quick: the first pass only, which finds nearly all that the others find.
    border: cells of the tags' black border.
    """
    boards = tuple(boards)
    missing = None if wanted is None else tuple(sorted(set(wanted)))
    on_boards: frozenset[int] = frozenset().union(*boards)
    found: dict[int, list[Floats]] = {}
    for scale, windows in _passes(max(grey.shape), border)[: 1 if quick else None]:
        small = reduced(grey, scale)
        for tag_id, quads in _find_once(small, dictionary, missing, on_boards, windows, border).items():
            if tag_id not in found:
                found[tag_id] = [(quad + 0.5) / scale - 0.5 for quad in quads]
        if missing is not None:
            plenty = frozenset().union(*(ids for ids in boards if 2 * len(ids & found.keys()) >= len(ids)))
            missing = tuple(tag_id for tag_id in missing if tag_id not in found and tag_id not in plenty)
            if not missing:
                break
    return found


def _passes(longer_side: int, border: int) -> list[tuple[float, tuple[int, int]]]:
    """Scale of the image and windows (px) of the threshold, for each pass."""
    finer, scale = [], 1.0
    while longer_side * scale > _LARGE:
        finer.insert(0, (scale, (5, 25)))
        scale /= 2
    first = _TOUCHING_WINDOWS if border > 1 else (5, 5)
    return [(scale, first), (scale / 2, (9, 9)), (scale, (15, 15)), *finer]


def _find_once(
    image: Picture,
    dictionary: str,
    wanted: tuple[int, ...] | None,
    on_boards: frozenset[int],
    windows: tuple[int, int],
    border: int,
) -> dict[int, list[Floats]]:
    # Rounded, so that windows of all sizes share few detectors.
    rate = max(_LEAST_PERIMETER_RATE, round(_LEAST_PERIMETER / max(image.shape), 2))
    corners, ids, others = _detector(dictionary, wanted, windows, rate, border).detectMarkers(image)
    found: dict[int, list[Floats]] = {}
    if ids is not None:
        for tag, quad in zip(map(int, np.ravel(ids)), corners, strict=True):
            found.setdefault(tag, []).append(np.asarray(quad, float).reshape(4, 2))
    # Among all tags of a dictionary there is one that anything looks like.
    if wanted is not None and len(others):
        quads = np.array(others, float).reshape(-1, 4, 2)
        alone = np.array([tag not in on_boards for tag in wanted])
        tags, turned = read_tags(image, quads, dictionary, wanted, alone, border)
        for k in np.flatnonzero(tags >= 0).tolist():
            # An outline has another within it, or around it.
            if not any(_same_place(turned[k], quad) for quad in found.get(tags[k], [])):
                found.setdefault(int(tags[k]), []).append(turned[k])
    return found if wanted is None else {wanted[tag]: quads for tag, quads in found.items()}


def _same_place(one: Floats, other: Floats) -> bool:
    """Whether the middle of a quadrilateral (4, 2) lies within another."""
    return cv2.pointPolygonTest(other.astype(np.float32), one.mean(axis=0).tolist(), measureDist=False) >= 0


def reads_as(grey: Picture, corners: Floats, name: str, tag_id: int) -> bool:
    """Whether the cells within the corners (4, 2), top left first, show the bits of this tag of a dictionary."""
    dictionary, bits = tag_dictionary(name), tag_cells(name, tag_id)[1:-1, 1:-1]
    cells = dictionary.markerSize + 2
    inner = np.arange(1.5, cells - 1, dtype=float) / cells
    grid = np.stack(np.meshgrid(inner, inner), axis=-1).reshape(-1, 2)
    values, black, white = (_sampled(grey, corners[None], p) for p in (grid, ring(cells, _IN), ring(cells, _OUT)))
    wrong = np.count_nonzero((values > (_median(black) + _median(white)) / 2) != bits.ravel())
    return bool(wrong <= dictionary.maxCorrectionBits)


@dataclass(frozen=True, eq=False)
class TagOutlines:
    """Outlines of tags: corners (N, 4, 2) px, top left first and clockwise on the print, as the usual tone has them;
    by_gamma (N, 4, 2): how they move with its log gamma; sigma and blur (N,) px; clipped (N,): which have
    white that may be cut off; sure (N,): which to trust."""

    corners: Floats
    by_gamma: Floats
    sigma: Floats
    blur: Floats
    clipped: Mask
    sure: Mask

    def replace(self, index: Ints, others: "TagOutlines") -> None:
        """Put others in the place of these."""
        for field in fields(self):
            getattr(self, field.name)[index] = getattr(others, field.name)


def toned_corners(grey: Picture, outlines: TagOutlines, cells: Mask) -> tuple[Floats, Floats]:
    """Corners (N, 4, 2) px of outlines in the tone that the insides of the sure ones show, and the error (N, 4, 2) px
    that all share with it. cells (N, n, n): which are white, the black border included."""
    sure, tone = outlines.sure, USUAL_TONE
    if sure.any():
        tone = tone_from_tags(grey, outlines.corners[sure], outlines.blur[sure], cells[sure].astype(float), tone)
    moved = outlines.by_gamma * tone.beyond(USUAL_TONE, 1)
    doubt = np.where(outlines.clipped, tone.doubted(_CLIPPED_SIGMA).sigma, tone.sigma)
    return outlines.corners + moved, doubt[:, None, None] * outlines.by_gamma


def refine_tags(grey: Picture, rough: Floats, cells: int, still: bool = False) -> TagOutlines:
    """The outlines from rough corners (N, 4, 2).

    cells: along a side of the tag, its black border included. still: only those are to be trusted that stand
    where the rough corners are, which takes half the time.
    """
    count = len(rough)
    corners, by_gamma, sigma, blur = np.empty_like(rough), np.empty_like(rough), np.empty((count, 4)), np.empty(count)
    sure, clipped, leak = np.zeros(count, bool), np.zeros(count, bool), np.zeros(count)
    levels = _levels(rough)
    groups = [np.flatnonzero(levels == 0), *np.flatnonzero(levels > 0)[:, None]]
    for group in (g for g in groups if len(g)):
        outline = _fit_from_level(grey, rough[group], cells, int(levels[group[0]]), still)
        corners[group], by_gamma[group], sigma[group] = outline.corners, outline.by_tone[:, 0], outline.sigma
        fit, own_blur = outline.fit, outline.fit.blur.reshape(-1, 4)
        blur[group] = own_blur.mean(axis=1)
        clipped[group] = fit.clipped.reshape(-1, 4).any(axis=1)
        sure[group] = _even_sides(fit, _cell(corners[group], cells))
        if still:
            sure[group] &= (own_blur < _SHARP).all(axis=1)
        leak[group] = _leak(fit, corners[group], cells)
    side = np.linalg.norm(np.roll(rough, -1, axis=1) - rough, axis=2).min(axis=1)
    moved = np.linalg.norm(corners - rough, axis=2).max(axis=1)
    sure &= np.isfinite(corners).all(axis=(1, 2)) & (moved < (_STILL if still else _FARTHEST + 0.1 * side))
    total = np.sqrt(np.mean(sigma**2, axis=1) + leak**2 + _MODEL_SIGMA**2)
    sure &= total < _WORST_SIGMA
    index = np.flatnonzero(sure)
    sure[index], uneven = _looks_whole(grey, corners[index], cells)
    total[index] = np.hypot(total[index], uneven)
    return TagOutlines(corners, by_gamma, total, blur, clipped, sure)


def _leak(fit: EdgeFit, corners: Floats, cells: int) -> Floats:
    """px (N,) by which light of the neighbouring cells moves corners, where blur is wide against a cell.

    Measured on rendered tags of 4 and 6 bits: rms error over blur is 0.16 at cells of 2 blurs, 0.06 at 3.75,
    0.03 at 4.5, 0.01 at 5.5; the formula runs through these.
    """
    blur = fit.blur.reshape(-1, 4).max(axis=1)
    ratio = _cell(corners, cells).min(axis=1) / blur
    return 0.18 * blur * np.exp(-((ratio / 3.6) ** 3))


def _even_sides(fit: EdgeFit, cell: Floats) -> Mask:
    """Which tags (N,) have four sides that are alike: dark within, of like contrast, and none of them half hidden."""
    contrast, noise = fit.contrast.reshape(-1, 4), fit.noise.reshape(-1, 4)
    least = contrast.min(axis=1)
    even = (fit.grey_contrast.reshape(-1, 4).min(axis=1) > _LEAST_CONTRAST) & (
        contrast.max(axis=1) < 4 * np.maximum(least, 1)
    )
    leaking = _LEAKING * fit.blur.reshape(-1, 4) / np.maximum(cell, 1e-3)
    hidden = (noise > np.clip(leaking, _UNEXPLAINED, _MOST_UNEXPLAINED) * contrast) & (
        noise > 2.5 * noise.min(axis=1, keepdims=True)
    )
    return even & ~hidden.any(axis=1) & ~fit.washed_out.reshape(-1, 4).any(axis=1)


def _levels(corners: Floats) -> Ints:
    """How often the image is halved (N,) until the tag's mean side is near _FIT_SIDE px."""
    side = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).mean(axis=1)
    return np.maximum(0, np.rint(np.log2(side / _FIT_SIDE))).astype(int)


def _fit_from_level(grey: Picture, rough: Floats, cells: int, top: int, still: bool) -> Outline:
    """The outlines from the coarse image of level `top` down to 0.

    still: the rough corners are good to a pixel. Coarse first, since a wide-angle lens bows the side of a large tag
    by more than the close search spans.
    """
    origin, crop = _crop(grey, rough, 2**top)
    scale, sides = 2**top, rough.shape[:2]
    small = (rough - origin + 0.5) / scale - 0.5
    bow = np.zeros(sides) if still else None
    outline = _fit_level(reduced(crop, 1 / scale), small, cells, bow, None)
    while scale > 1 and np.median(outline.fit.blur) <= _SOFT:
        scale //= 2
        bow, blur = (2 * part.reshape(sides) for part in (outline.fit.coefficients[:, 2], outline.fit.blur))
        outline = _fit_level(reduced(crop, 1 / scale), 2 * outline.corners + 0.5, cells, bow, blur)
    fit = replace(outline.fit, blur=outline.fit.blur * scale)
    corners = (outline.corners + 0.5) * scale - 0.5 + origin
    sigma, by_tone = outline.sigma * scale, outline.by_tone * scale
    return replace(outline, corners=corners, sigma=sigma, by_tone=by_tone, fit=fit)


def _fit_level(image: Picture, corners: Floats, cells: int, bow: Floats | None, blur: Floats | None) -> Outline:
    """The outlines in this image's pixels; bow, blur (N, 4): px, from coarser ones."""
    cell, light = _cell(corners, cells), LightImage(image)
    if bow is None:
        # First wide enough for the rough corners' error, then close to the edge found.
        first = fit_outline(light, corners, np.clip(0.6 * cell, 1.0, _WIDE), options=EdgeOptions(32, rough=True))
        corners = np.where(np.isfinite(first.corners), first.corners, corners)
        bow, blur = first.fit.coefficients[:, 2].reshape(cell.shape), first.fit.blur.reshape(cell.shape)
    close = np.clip(0.8 * cell, 1.0, _CLOSE if blur is None else np.maximum(_CLOSE, 3 * blur))
    outline = fit_outline(light, corners, close, bow, EdgeOptions(blur=None if blur is None else blur.ravel()))
    return replace(outline, corners=np.where(np.isfinite(outline.corners), outline.corners, corners))


def _crop(grey: Picture, corners: Floats, scale: int) -> tuple[Floats, Picture]:
    """The part of the image around the corners, and the pixel (2,) where it begins; whole steps of the scale."""
    if scale == 1:
        return np.zeros(2), grey
    low = np.floor(corners.min(axis=(0, 1)) / scale - 8).clip(0).astype(int) * scale
    high = np.ceil(corners.max(axis=(0, 1)) / scale + 8).astype(int) * scale
    # A last row or column that is cut short would shift the whole of the halved image.
    high = np.minimum(high, np.array(grey.shape[::-1]) // scale * scale)
    return low.astype(float), grey[low[1] : high[1], low[0] : high[0]]


def _cell(corners: Floats, cells: int) -> Floats:
    """px across the outermost cells along each side (N, 4), where the tag is narrowest."""
    end = np.roll(corners, -1, axis=1)
    along = end - corners
    length = np.linalg.norm(along, axis=2)
    depth = []
    for k in (2, 3):
        other = np.roll(corners, -k, axis=1) - corners
        depth.append(np.abs(along[..., 0] * other[..., 1] - along[..., 1] * other[..., 0]) / length)
    return np.minimum(*depth) / cells


def _looks_whole(grey: Picture, corners: Floats, cells: int) -> tuple[Mask, Floats]:
    """Of which tags (N, 4, 2) the black border with the white ring around it is there, all the way, and at all four
    corners; and px (N,) by which the border of a shadow or of glare across it may move a corner.

    Each black cell is held against the white beside it, so that glare over a part of the tag does not count.
    """
    places = [part for depth in (_IN, _OUT) for part in (ring(cells, depth), _corners(depth / cells))]
    levels = _sampled(grey, corners, np.concatenate(places))
    black, black_corners, white, white_corners = np.split(levels, np.cumsum([len(p) for p in places[:-1]]), axis=1)
    contrast = _median(white) - _median(black)
    least = _LEAST_STEP * contrast[:, None]
    # What is outside the image (nan) is neither right nor wrong.
    whole = (contrast > _LEAST_CONTRAST) & (np.sum(white - black < least, axis=1) <= _WRONG_CELLS * 4 * cells)
    whole &= ~((white > CLIPPED) & (black > LIGHT_INK)).any(axis=1)
    # Edges that end under a thumb do not meet where the corner is.
    whole &= ~(white_corners - black_corners < least).any(axis=1)
    light = np.log(np.maximum(USUAL_TONE.light(white.reshape(-1, 4, cells)), 1))
    change = np.nanmax(np.abs(light[..., 2:] - light[..., :-2]), axis=(1, 2), initial=0.0)
    return whole, np.where(change > _UNEVEN, _BY_CHANGE * change, 0.0)


def _median(levels: Floats) -> Floats:
    """Median (N,) of what is no nan in levels (N, P): numpy's own takes each row by itself."""
    ordered, count = np.sort(levels, axis=1), np.isfinite(levels).sum(axis=1)
    row = np.arange(len(levels))
    return (ordered[row, (count - 1) // 2] + ordered[row, count // 2]) / 2


def _corners(depth: float) -> Floats:
    """Places (4, 2) so far within the corners of a unit square."""
    low, high = depth, 1 - depth
    return np.array([[low, low], [high, low], [high, high], [low, high]])


def _sampled(grey: Picture, corners: Floats, places: Floats) -> Floats:
    """Grey levels (N, P) at places (P, 2) of a unit square with corners (N, 4, 2) in the image; nan outside of it."""
    seen = np.nan_to_num(mapped(square_homographies(corners), places), nan=-1, posinf=-1, neginf=-1)
    seen = np.rint(seen).astype(int)
    inside = np.all((seen >= 0) & (seen < np.array(grey.shape[::-1])), axis=-1)
    seen = np.where(np.expand_dims(inside, -1), seen, 0)
    return np.where(inside, grey[seen[..., 1], seen[..., 0]].astype(float), np.nan)
