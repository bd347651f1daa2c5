"""Which rectangles are in an image, and where: one call for every kind of marking."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from quadrig.single.arrays import Picture
from quadrig.single.detect.pictures import grey_image
from quadrig.single.detect.tag import find_tags
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import FoundTags, Marking, Rectangle, TagFamily
from quadrig.single.view import View

# No marking has fewer cells, and halved for a first look such a picture would have no pixels left.
_SMALLEST = 8


def detect_views(
    image: Picture, rectangles: Sequence[Rectangle], *, near: Sequence[View] | None = None
) -> list[View]:
    """The Views of all rectangles that are surely in the image, in the order of the rectangles; [] where none is.

    image: uint8, (h, w) grey or (h, w, 3) blue green red. A tag gives its four corners in Eq. 4's order, a
    ChArUco board those inner corners that are in sight, a chessboard all of its inner corners, a blank sheet its
    four corners. Readings that the picture cannot distinguish are in View.alternatives. Camera and frameset are the
    caller's to fill in. Rectangles whose corners are given by hand are not looked for.
    A rectangle with `back` that is not seen from the front is looked for from behind.
    near: what was found in the same camera's picture before ([] where nothing was). Rectangles are then looked for
    first where they were, and the whole picture is searched once, quickly, for those that are not there: three to
    five times faster, and all but the faintest are found. Search without it now and then.
    Raises QuadrigError where two of the rectangles look alike.
    """
    check_rectangles(rectangles)
    grey = grey_image(image)
    if min(grey.shape) < _SMALLEST:
        return []
    before = None if near is None else {view.rectangle: view for view in near}
    by_name = {view.rectangle: view for view in _search_all(grey, rectangles, before)}
    behind = [r for r in rectangles if r.back and r.name not in by_name]
    by_name |= {view.rectangle: view for view in find_mirrored(grey, behind, near=near)}
    return [by_name[r.name] for r in rectangles if r.name in by_name]


def find_mirrored(
    grey: Picture, rectangles: Sequence[Rectangle], *, near: Sequence[View] | None = None
) -> list[View]:
    """The Views of rectangles that a grey picture shows mirrored, as from behind; near: as for detect_views."""
    if not rectangles:
        return []
    before = None if near is None else {view.rectangle: _mirrored(view, grey.shape[1]) for view in near}
    views = _search_all(np.ascontiguousarray(grey[:, ::-1]), rectangles, before)
    return [_mirrored(view, grey.shape[1]) for view in views]


def _mirrored(view: View, width: int) -> View:
    """What a View of a mirrored picture is in the picture itself: the sheet's points are where they are."""
    common = None if view.common is None else view.common * [-1, 1]
    return replace(view, pixels=view.pixels * [-1, 1] + [width - 1, 0], common=common, back=not view.back)


def _search_all(grey: Picture, rectangles: Sequence[Rectangle], before: Mapping[str, View] | None) -> list[View]:
    views = _search(grey, [r for r in rectangles if r.marking.tags is None], before)
    for members in families(rectangles).values():
        views += _search(grey, members, before)
    return views


def _search(grey: Picture, members: Sequence[Rectangle], before: Mapping[str, View] | None) -> list[View]:
    """Views of the rectangles of one family, or of those without tags; near earlier Views where there are some."""
    views = follow_views(grey, members, before) if before else []
    there = {view.rectangle for view in views}
    missing = [rectangle for rectangle in members if rectangle.name not in there]
    if missing:
        views += find_views(grey, missing, search_tags(grey, missing, quick=before is not None))
    return views


def find_views(grey: Picture, members: Sequence[Rectangle], found: FoundTags) -> list[View]:
    """Views of rectangles of one family, or of those without tags, in a picture in which these tags were found."""
    return [view for kind, same in _by_kind(members).items() for view in kind.find_all(grey, same, found)]


def follow_views(grey: Picture, members: Sequence[Rectangle], near: Mapping[str, View]) -> list[View]:
    """The same near where an earlier picture showed them; near: earlier Views by rectangle."""
    return [view for kind, same in _by_kind(members).items() for view in kind.follow_all(grey, same, near)]


def _by_kind(members: Sequence[Rectangle]) -> dict[type[Marking], list[Rectangle]]:
    kinds: dict[type[Marking], list[Rectangle]] = {}
    for rectangle in members:
        kinds.setdefault(type(rectangle.marking), []).append(rectangle)
    return kinds


def check_rectangles(rectangles: Sequence[Rectangle]) -> None:
    """Raises QuadrigError where two rectangles look alike in a picture."""
    owners: dict[Hashable, str] = {}
    for rectangle in rectangles:
        for mark in rectangle.marking.marks:
            if mark in owners and owners[mark] != rectangle.name:
                raise QuadrigError(
                    f"rectangles {owners[mark]!r} and {rectangle.name!r} look alike in a picture: "
                    "give each its own tag ids, board size, or only one blank sheet"
                )
            owners[mark] = rectangle.name


def families(rectangles: Sequence[Rectangle]) -> dict[TagFamily, list[Rectangle]]:
    """The rectangles that bear tags, by the family of these."""
    members: dict[TagFamily, list[Rectangle]] = {}
    for rectangle in rectangles:
        if rectangle.marking.tags is not None:
            members.setdefault(rectangle.marking.tags.family, []).append(rectangle)
    return members


def known_tags(rectangles: Sequence[Rectangle]) -> set[tuple[str, int]]:
    """Every (dictionary, id) that belongs to a rectangle."""
    all_tags = [rectangle.marking.tags for rectangle in rectangles]
    return {(tags.family.dictionary, tag) for tags in all_tags if tags is not None for tag in tags.ids}


def search_tags(grey: Picture, members: Sequence[Rectangle], *, quick: bool = False) -> FoundTags:
    """The tags of these rectangles, all of one family or without any; quick: as for find_tags."""
    borne = [rectangle.marking.tags for rectangle in members if rectangle.marking.tags is not None]
    if not borne:
        return {}
    ids = [tags.ids for tags in borne]
    boards = [board for board in ids if len(board) > 1]
    family = borne[0].family
    looked_at = 255 - grey if family.inverted else grey
    return find_tags(looked_at, family.dictionary, frozenset().union(*ids), boards, quick, family.border)
