"""Which rectangles are in an image, and where: one call for every kind of marking."""

from collections.abc import Sequence

import cv2
import numpy as np

from .detect_board import check_board_rectangle, detect_charuco, detect_chessboard
from .detect_plain import detect_plain
from .detect_tag import check_tag_rectangle, detect_tags, find_tags
from .errors import QuadrigError
from .marking_image import charuco_tag_squares
from .rectangle import CharucoMarking, ChessboardMarking, PlainMarking, Rectangle, TagMarking
from .rotation import Array
from .view import View


def detect(image: Array, rectangles: Sequence[Rectangle]) -> list[View]:
    """The Views of all rectangles that are surely in the image, in the order of the rectangles; [] where none is.

    image: uint8, (h, w) grey or (h, w, 3) blue green red. A tag gives its four corners in Eq. 4's order, a
    ChArUco board those inner corners that are in sight, a chessboard all of its inner corners, a blank sheet its
    four corners. Readings that the picture cannot tell apart are in View.alternatives. Camera and frameset are the
    caller's to fill in. Rectangles whose corners are given by hand are not looked for.
    Raises QuadrigError where the rectangles cannot be told apart or name a tag that does not exist.
    """
    check_rectangles(rectangles)
    grey = grey_image(image)
    views: dict[str, View] = {}
    for (dictionary, inverted), members in _by_dictionary(rectangles).items():
        seen = 255 - grey if inverted else grey
        found = find_tags(seen, dictionary, _wanted(members), _board_ids(members))
        tags = [r for r in members if isinstance(r.marking, TagMarking)]
        for view in detect_tags(seen, tags, found):
            views[view.rectangle] = view
        for rectangle in members:
            if isinstance(rectangle.marking, CharucoMarking):
                _keep(views, detect_charuco(seen, rectangle, found))
    for rectangle in rectangles:
        if isinstance(rectangle.marking, ChessboardMarking):
            _keep(views, detect_chessboard(grey, rectangle))
        elif isinstance(rectangle.marking, PlainMarking):
            _keep(views, detect_plain(grey, rectangle))
    return [views[r.name] for r in rectangles if r.name in views]


def grey_image(image: Array) -> Array:
    """The image (h, w) uint8 of a grey or blue-green-red one. Raises QuadrigError where it is neither."""
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3)):
        raise QuadrigError(
            f"an image of shape {image.shape} and type {image.dtype} cannot be searched; give 8-bit grey or colour"
        )
    if image.ndim == 2:
        return image
    return image[..., 0] if image.shape[2] == 1 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def check_rectangles(rectangles: Sequence[Rectangle]) -> None:
    """Raises QuadrigError where a tag does not exist or where two rectangles cannot be told apart in a picture."""
    owners: dict[object, str] = {}
    for rectangle in rectangles:
        for mark in _marks(rectangle):
            if mark in owners and owners[mark] != rectangle.name:
                raise QuadrigError(
                    f"rectangles {owners[mark]!r} and {rectangle.name!r} look alike in a picture: "
                    "give each its own tag ids, board size, or only one blank sheet"
                )
            owners[mark] = rectangle.name


def _marks(rectangle: Rectangle) -> list[tuple]:
    """What a picture can show of a rectangle that no other may have."""
    marking = rectangle.marking
    if isinstance(marking, TagMarking):
        return [(check_tag_rectangle(rectangle), False, marking.id)]
    if isinstance(marking, CharucoMarking):
        name = check_board_rectangle(rectangle)
        last = marking.first_id + len(charuco_tag_squares(marking))
        return [(name, marking.inverted, tag_id) for tag_id in range(marking.first_id, last)]
    if isinstance(marking, ChessboardMarking):
        return [("chessboard", *sorted((marking.columns, marking.rows)))]
    return [("plain",)] if isinstance(marking, PlainMarking) else []


def _wanted(members: Sequence[Rectangle]) -> set[int]:
    """The tag ids that these rectangles bear."""
    return {mark[2] for rectangle in members for mark in _marks(rectangle)}


def _board_ids(members: Sequence[Rectangle]) -> list[frozenset[int]]:
    boards = [rectangle for rectangle in members if isinstance(rectangle.marking, CharucoMarking)]
    return [frozenset(mark[2] for mark in _marks(board)) for board in boards]


def _by_dictionary(rectangles: Sequence[Rectangle]) -> dict[tuple[str, bool], list[Rectangle]]:
    groups: dict[tuple[str, bool], list[Rectangle]] = {}
    for rectangle in rectangles:
        if isinstance(rectangle.marking, TagMarking):
            groups.setdefault((check_tag_rectangle(rectangle), False), []).append(rectangle)
        elif isinstance(rectangle.marking, CharucoMarking):
            key = (check_board_rectangle(rectangle), rectangle.marking.inverted)
            groups.setdefault(key, []).append(rectangle)
    return groups


def _keep(views: dict[str, View], view: View | None) -> None:
    if view is not None:
        views[view.rectangle] = view
