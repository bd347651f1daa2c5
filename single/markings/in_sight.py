"""Markings that pictures show to somebody who knows none of them: tags, ChArUco boards, AprilGrids, chessboards.

No picture shows how large they are: the side of a square, or of a tag where there are no squares, is 1 here.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

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

# Middles (N, 2) of tags on a grid of unit step, y down, by ids (N,) counted from the first.
Grid = Callable[[np.ndarray], Floats]


def markings_in_sight(pictures: Sequence[Picture]) -> tuple[Marking, ...]:
    """What grey pictures of one camera show in plain sight: one board, or single tags of one dictionary.

    It takes seconds.
    """
    sight = plain_sight(pictures, ())
    if sight is None:
        return ()
    if sight.family is None:
        return (ChessboardMarking(*sight.squares, square=1.0),)
    family = sight.family
    seen = [_placed(picture, family) for picture in pictures]
    most = max(range(len(seen)), key=lambda k: len(seen[k]))
    board = _board(seen[most], family, max(sight.ids) + 1)
    if isinstance(board, AprilGridMarking):
        board = _spaced(board, pictures[most])
    return (board,) if board is not None else tuple(TagMarking(family.dictionary, tag) for tag in sight.ids)


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


def _board(seen: Mapping[int, Floats], family: TagFamily, tags: int) -> Marking | None:
    """The board whose tags lie as these do, which are the first so many of a dictionary; None where there is none."""
    fits = []
    for grid, marking in _candidates(family, tags):
        off, side = _fit(seen, grid)
        if off < _OFF and _RATIOS[0] < side < _RATIOS[1]:
            fits.append((off, marking, side))
    for _, marking, side in sorted(fits, key=lambda fit: fit[0]):
        if isinstance(marking, CharucoMarking):
            return replace(marking, marker=round(side, 2))
        if isinstance(marking, AprilGridMarking):
            return replace(marking, spacing=round(1 / side - 1, 2))
    return None


def _candidates(family: TagFamily, tags: int) -> Iterator[tuple[Grid, Marking]]:
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
    ids, quads = np.array(list(seen)), np.stack(list(seen.values()))
    try:
        places = grid(ids)
    except IndexError:
        return np.inf, 0.0
    if len(ids) < _FEWEST or min(np.ptp(places, axis=0)) < 1:
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
