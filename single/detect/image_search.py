"""Which rectangles are in an image, and where: one call for every kind of marking."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from quadrig.single.arrays import Picture
from quadrig.single.detect.blank_sheet import detect_plain
from quadrig.single.detect.charuco import check_board_rectangle, detect_charuco
from quadrig.single.detect.chessboard import detect_chessboard
from quadrig.single.detect.pictures import grey_image, window_around
from quadrig.single.detect.tag import check_tag_rectangle, detect_tags, find_tags, track_tags
from quadrig.single.errors import QuadrigError
from quadrig.single.marking import CharucoMarking, ChessboardMarking, PlainMarking, TagMarking, charuco_tag_squares
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View


def detect_views(
    image: Picture, rectangles: Sequence[Rectangle], *, near: Sequence[View] | None = None
) -> list[View]:
    """The Views of all rectangles that are surely in the image, in the order of the rectangles; [] where none is.

    image: uint8, (h, w) grey or (h, w, 3) blue green red. A tag gives its four corners in Eq. 4's order, a
    ChArUco board those inner corners that are in sight, a chessboard all of its inner corners, a blank sheet its
    four corners. Readings that the picture cannot tell apart are in View.alternatives. Camera and frameset are the
    caller's to fill in. Rectangles whose corners are given by hand are not looked for.
    near: what was found in the same camera's picture before ([] where nothing was). Rectangles are then looked for
    first where they were, and the whole picture is searched once, quickly, for those that are not there: three to
    five times faster, and all but the faintest are found. Search without it now and then.
    Raises QuadrigError where the rectangles cannot be told apart or name a tag that does not exist.
    """
    check_rectangles(rectangles)
    grey = grey_image(image)
    before = None if near is None else {view.rectangle: view for view in near}
    views: dict[str, View] = {}
    for (dictionary, inverted), members in _by_dictionary(rectangles).items():
        for view in _of_dictionary(grey, (dictionary, inverted), members, before):
            views[view.rectangle] = view
    for rectangle in rectangles:
        if isinstance(rectangle.marking, ChessboardMarking):
            _keep(views, _chessboard(grey, rectangle, before))
        elif isinstance(rectangle.marking, PlainMarking):
            _keep(views, detect_plain(grey, rectangle))
    return [views[r.name] for r in rectangles if r.name in views]


def _of_dictionary(
    grey: Picture, kind: tuple[str, bool], members: Sequence[Rectangle], before: Mapping[str, View] | None
) -> list[View]:
    """Views of the tags and ChArUco boards of one dictionary, inverted or not; near earlier Views if any."""
    dictionary, inverted = kind
    seen = 255 - grey if inverted else grey
    tags = [r for r in members if isinstance(r.marking, TagMarking)]
    boards = [r for r in members if isinstance(r.marking, CharucoMarking)]
    views: list[View] = []
    if before is not None:
        views += track_tags(grey, tags, before)
        views += [view for board in boards if (view := _board_nearby(grey, dictionary, board, before)) is not None]
        there = {view.rectangle for view in views}
        tags, boards = ([r for r in group if r.name not in there] for group in (tags, boards))
    if tags or boards:
        wanted = _wanted([*tags, *boards])
        found = find_tags(seen, dictionary, wanted, _board_ids(boards), quick=before is not None)
        views += detect_tags(grey, tags, found)
        views += [view for board in boards if (view := detect_charuco(grey, board, found)) is not None]
    return views


def _board_nearby(grey: Picture, dictionary: str, board: Rectangle, before: Mapping[str, View]) -> View | None:
    if board.name not in before:
        return None
    window, corner = window_around(grey, before[board.name].pixels)
    # A board in motion is so blurred that only the slower passes find its tags; its window is small.
    assert isinstance(board.marking, CharucoMarking)
    window = 255 - window if board.marking.inverted else window
    tags = find_tags(window, dictionary, _wanted([board]), _board_ids([board]))
    found = {tag_id: [quad + corner for quad in quads] for tag_id, quads in tags.items()}
    return detect_charuco(grey, board, found)


def _chessboard(grey: Picture, board: Rectangle, before: Mapping[str, View] | None) -> View | None:
    if before is not None and board.name in before:
        window, corner = window_around(grey, before[board.name].pixels)
        view = detect_chessboard(window, board)
        if view is not None:
            return replace(view, pixels=view.pixels + corner)
    return detect_chessboard(grey, board)


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
