"""Rectangles by the tags they bear: those of one family are found by one search."""

from collections.abc import Sequence

from quadrig.single.arrays import Picture
from quadrig.single.detect.tag import find_tags
from quadrig.single.rectangle import FoundTags, Rectangle, TagFamily


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
