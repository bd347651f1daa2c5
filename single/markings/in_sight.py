"""Markings that pictures show to somebody who knows none of them: tags, ChArUco boards, AprilGrids, chessboards.

No picture shows how large they are: the side of a square, or of a tag where there are no squares, is 1 here.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from quadrig.single.arrays import Floats, Picture
from quadrig.single.detect.dictionaries import tag_dictionary
from quadrig.single.detect.image_search import detect_views
from quadrig.single.detect.pictures import reduced
from quadrig.single.detect.plain_sight import plain_sight
from quadrig.single.detect.tag import find_tags, refine_tags
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.april_grid import AprilGridMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Marking, Rectangle, TagFamily

# Longer side (px) of the pictures in which the tags are placed: that of a sheet in plain sight is large.
_LARGEST = 1600
# Four places fit on any grid; with two more, grids that are not there are a quarter of a step off.
_FEWEST, _OFF = 6, 0.15
# Of what people print, no board has more columns.
_MOST_COLUMNS = 30
# Side of a tag over that of its square, or over the step of its grid: outside of these the grid is a chance.
_RATIOS = (0.3, 0.98)
# Hundredths that the spacing of rough corners is off by, at most.
_ROUGHLY = 6

# What is usual, and how far a single look at a sharp picture is off: blur makes black wider or narrower by as much.
_USUAL = {"marker": (0.75, 0.02), "spacing": (0.3, 0.01)}
# Pictures whose corners are fitted for the spacing: each takes a second.
_FITTED = 3

# Middles (N, 2) of tags on a grid of unit step, y down, by ids (N,) counted from the first.
Grid = Callable[[np.ndarray], Floats]
_Board = CharucoMarking | AprilGridMarking


@dataclass(frozen=True)
class Sighting:
    """A marking of unit size that is in sight.

    times: pictures that show a tag. estimates: of a board's side of a tag over its square (ChArUco), or of the space
    between tags over a tag (AprilGrid), from a picture each: the marking has what they agree on.
    """

    marking: Marking
    times: int = 1
    estimates: tuple[float, ...] = ()


def markings_in_sight(pictures: Sequence[Picture]) -> tuple[Sighting, ...]:
    """What grey pictures of one camera show in plain sight: one board, or single tags of one dictionary.

    It takes seconds.
    """
    sight = plain_sight(pictures, ())
    if sight is None:
        return ()
    if sight.family is None:
        return (Sighting(ChessboardMarking(*sight.squares, square=1.0)),)
    family = sight.family
    seen = [_placed(picture, family) for picture in pictures]
    order = sorted(range(len(seen)), key=lambda k: -len(seen[k]))
    again = {tag for tag, times in zip(sight.ids, sight.times, strict=True) if times > 1}
    most = seen[order[0]]
    # What one picture alone shows may be clutter, and no tag of the board.
    for trusted in (again | (set(sight.ids) & set(most)), again):
        board = _board({tag: quad for tag, quad in most.items() if tag in trusted}, family, trusted)
        if board is not None:
            kept = [({tag: quad for tag, quad in seen[k].items() if tag in trusted}, pictures[k]) for k in order]
            return (_agreed(Sighting(board, estimates=_estimates(board, kept))),)
    return tuple(
        Sighting(TagMarking(family.dictionary, tag), times) for tag, times in zip(sight.ids, sight.times, strict=True)
    )


def together(found: Sequence[Sequence[Sighting]]) -> tuple[Sighting, ...]:
    """What several cameras show, in whatever order they are given: of boards that bear the same tags the one seen
    whole, with what all estimates of it agree on; of tags each one once that is on no board, with all its times."""
    every = sorted((one for sightings in found for one in sightings), key=lambda one: repr(one.marking))
    boards = sorted((one for one in every if one.marking.size is not None), key=_extent, reverse=True)
    kept: list[Sighting] = []
    for one in [*boards, *(one for one in every if one.marking.size is None)]:
        same = next((k for k, other in enumerate(kept) if _alike(one.marking, other.marking)), None)
        if same is None:
            kept.append(one)
        elif kept[same].marking.size is None:
            kept[same] = replace(kept[same], times=kept[same].times + one.times)
        elif _nominal(one.marking) == _nominal(kept[same].marking):
            kept[same] = replace(kept[same], estimates=kept[same].estimates + one.estimates)
    return tuple(_agreed(one) for one in kept)


def _extent(sighting: Sighting) -> float:
    # Of AprilGrids, whose spacing is estimated, as of others: what counts is how many tags are seen.
    width, height = _nominal(sighting.marking).size or (0.0, 0.0)
    return width * height


def _alike(one: Marking, other: Marking) -> bool:
    """Whether two descriptions may be of one sheet: they bear the same tags, or are both chessboards.

    Dictionaries of one kind begin alike, however many tags they have.
    """
    if one.tags is None or other.tags is None:
        return one.kind == other.kind
    first, second = ((m.family.dictionary.rpartition("_")[0], m.family.inverted) for m in (one.tags, other.tags))
    same = one.tags.family.dictionary == other.tags.family.dictionary or ("x" in first[0] and first[0] == second[0])
    return same and first[1] == second[1] and bool(one.tags.ids & other.tags.ids)


def _estimated(board: Marking) -> str | None:
    """The key of what is estimated of a board, or None."""
    return {"charuco": "marker", "aprilgrid": "spacing"}.get(board.kind)


def _with(board: Marking, value: float) -> Marking:
    key = _estimated(board)
    return board if key is None else replace(board, **{key: value})


def _nominal(board: Marking) -> Marking:
    key = _estimated(board)
    return board if key is None else _with(board, _USUAL[key][0])


def _agreed(sighting: Sighting) -> Sighting:
    """With the median of the estimates, or what is usual where it is within their doubt."""
    key = _estimated(sighting.marking)
    if key is None or not sighting.estimates:
        return sighting
    usual, single = _USUAL[key]
    value = float(np.median(sighting.estimates))
    # 1.48 median deviations are a sigma of normal errors; blur is common to all pictures and does not average out.
    doubt = max(single, 1.48 * float(np.median(np.abs(np.array(sighting.estimates) - value))))
    # Each is rounded: 0.77 is two hundredths from 0.75, whatever its last bit says.
    value = usual if abs(value - usual) <= doubt + 1e-9 else round(value, 2)
    return replace(sighting, marking=_with(sighting.marking, value))


def _estimates(board: _Board, seen: Sequence[tuple[Mapping[int, Floats], Picture]]) -> tuple[float, ...]:
    """Of what is estimated of the board, one from each picture that shows enough of it; seen: most tags first."""
    estimates = []
    for tags, picture in seen:
        grid = _row_by_row(board.columns) if isinstance(board, AprilGridMarking) else _on_squares(board)
        off, side = _fit(tags, grid)
        if not (off < _OFF and _RATIOS[0] < side < _RATIOS[1]):
            continue
        if not isinstance(board, AprilGridMarking):
            estimates.append(side)
        elif len(estimates) < _FITTED:
            estimates.append(_spaced(replace(board, spacing=round(1 / side - 1, 2)), picture).spacing)
    return tuple(estimates)


def _spaced(board: AprilGridMarking, picture: Picture) -> AprilGridMarking:
    """The board with the spacing to a hundredth with which its corners fit best: rough ones only show it roughly."""
    best, misfit = board, _misfit(board, picture)
    for way in (-1, 1):
        for step in range(1, _ROUGHLY + 1):
            spacing = round(board.spacing + way * step / 100, 2)
            tried = replace(board, spacing=spacing) if spacing > 0 else None
            if tried is None or (next_misfit := _misfit(tried, picture)) > misfit:
                break
            best, misfit = tried, next_misfit
        if best is not board:
            break
    return best


def _misfit(board: AprilGridMarking, picture: Picture) -> float:
    """RMS (px) by which the board's corners depart from a plane's picture; infinite where it is not seen."""
    for view in detect_views(picture, [Rectangle("board", *board.size, board)], near=[]):
        places, pixels = view.points[:, :2], np.asarray(view.pixels, float)
        image_from_board, _ = cv2.findHomography(places, pixels)
        again = cv2.perspectiveTransform(places[None].astype(float), image_from_board)[0]
        return float(np.sqrt(np.mean((again - pixels) ** 2)))
    return np.inf


def _placed(picture: Picture, family: TagFamily) -> dict[int, Floats]:
    """Corners (4, 2) px of each tag that is seen once."""
    small = reduced(picture, min(1.0, _LARGEST / max(picture.shape)))
    small = 255 - small if family.inverted else small
    found = find_tags(small, family.dictionary, border=family.border)
    ids = [tag for tag, quads in found.items() if len(quads) == 1]
    if not ids:
        return {}
    rough = np.stack([np.asarray(found[tag][0]) for tag in ids])
    outlines = refine_tags(small, rough, tag_dictionary(family.dictionary).markerSize + 2 * family.border)
    return dict(zip(ids, np.where(outlines.sure[:, None, None], outlines.corners, rough), strict=True))


def _board(seen: Mapping[int, Floats], family: TagFamily, ids: Collection[int]) -> _Board | None:
    """The board whose tags lie as these do, with the first of a dictionary's tags up to these ids; None where there
    is none."""
    fits = []
    for grid, marking in _candidates(family, max(ids, default=-1) + 1):
        off, side = _fit(seen, grid)
        if off < _OFF and _RATIOS[0] < side < _RATIOS[1]:
            fits.append((off, marking))
    return min(fits, key=lambda fit: fit[0])[1] if fits else None


def _candidates(family: TagFamily, tags: int) -> Iterator[tuple[Grid, _Board]]:
    """Boards of every number of columns that bear so many tags, or a few more in their last row."""
    for columns in range(2, _MOST_COLUMNS + 1):
        for legacy in (False, True):
            rows = next(rows for rows in range(2, 2 * tags + 3) if len(_squares(columns, rows, legacy)) >= tags)
            if family.border == 1 and (marking := _charuco(columns, rows, legacy, family)) is not None:
                yield _on_squares(marking), marking
        rows = -(-tags // columns)
        if not family.inverted and rows > 1:
            try:
                grid = AprilGridMarking(columns, rows, 1.0, 0.3, family.dictionary, border=family.border)
            except QuadrigError:
                continue
            yield _row_by_row(columns), grid


def _squares(columns: int, rows: int, legacy: bool) -> list[tuple[int, int]]:
    first = 0 if legacy and rows % 2 == 0 else 1
    return [(c, r) for r in range(rows) for c in range(columns) if (c + r) % 2 == first]


def _charuco(columns: int, rows: int, legacy: bool, family: TagFamily) -> CharucoMarking | None:
    """None where the dictionary has too few tags, or the older pattern is no other."""
    if legacy and rows % 2 == 1:
        return None
    try:
        return CharucoMarking(columns, rows, 1.0, 0.75, family.dictionary, legacy, family.inverted)
    except QuadrigError:
        return None


def _on_squares(marking: CharucoMarking) -> Grid:
    squares = np.array(marking.tag_squares, float)
    return lambda ids: squares[ids]


def _row_by_row(columns: int) -> Grid:
    # Kalibr counts from the bottom left upwards.
    return lambda ids: np.column_stack([ids % columns, -(ids // columns)]).astype(float)


def _fit(seen: Mapping[int, Floats], grid: Grid) -> tuple[float, float]:
    """How far (RMS, steps) the tags are from a plane's picture of the grid, and the side of a tag there, in steps."""
    if len(seen) < _FEWEST:
        return np.inf, 0.0
    ids, quads = np.array(list(seen)), np.stack(list(seen.values()))
    try:
        places = grid(ids)
    except IndexError:
        return np.inf, 0.0
    if min(np.ptp(places, axis=0)) < 1:
        return np.inf, 0.0
    grid_from_image, _ = cv2.findHomography(quads.mean(axis=1), places)
    if grid_from_image is None:
        return np.inf, 0.0
    corners = cv2.perspectiveTransform(quads.reshape(1, -1, 2).astype(float), grid_from_image)[0].reshape(-1, 4, 2)
    off = float(np.sqrt(np.mean(np.sum((corners.mean(axis=1) - places) ** 2, axis=1))))
    # Clockwise as printed; on a grid that is seen mirrored, anticlockwise.
    first, second = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    area = float(np.median(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])) / 2
    return off, float(np.sqrt(max(area, 0.0)))
