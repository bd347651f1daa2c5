"""What is in plain sight where no rectangle is found: the sheet mirrored, a board of another size, other tags."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.single.arrays import Picture
from quadrig.single.detect.chessboard import find_chessboard
from quadrig.single.detect.dictionaries import dictionary_names, dictionary_size, tag_dictionary
from quadrig.single.detect.image_search import detect_views, families, find_mirrored
from quadrig.single.detect.pictures import reduced
from quadrig.single.detect.saddle_grid import largest_grid
from quadrig.single.detect.tag import find_tags, refine_tags
from quadrig.single.rectangle import Marking, Rectangle, TagFamily

# Longer side (px) of the pictures that are searched for tags of any dictionary: that of a sheet in plain sight is
# large, and every dictionary is another search.
_LARGEST = 1280
# px below which nothing stands out in a picture.
_SMALLEST = 60
# Each holds the tags of the smaller ones of its kind; more ids would find more tags in clutter.
_DICTIONARIES = (
    "apriltag_36h11",
    "apriltag_25h9",
    "apriltag_16h5",
    "aruco_4x4_250",
    "aruco_5x5_250",
    "aruco_6x6_250",
    "aruco_7x7_250",
    "aruco_original",
    "aruco_mip_36h12",
)
# Bits of a tag from which on clutter is not read as one; those of fewer need clean outlines, and to be seen thrice.
_SURE_BITS, _TIMES = 36, 3
# Points of a board that another reading of its tags does not have by chance.
_SURE_POINTS = 6


@dataclass(frozen=True)
class PlainSight:
    """What pictures show in the place of what was looked for.

    rectangle: the one that is seen `mirrored`, or with another `marking`. family, ids: of tags that no rectangle
    bears, and in how many of the pictures each is seen. squares: columns and rows of a chessboard.
    """

    rectangle: str = ""
    mirrored: bool = False
    marking: Marking | None = None
    family: TagFamily | None = None
    ids: tuple[int, ...] = ()
    times: tuple[int, ...] = ()
    squares: tuple[int, int] = (0, 0)


def plain_sight(pictures: Sequence[Picture], rectangles: Sequence[Rectangle]) -> PlainSight | None:
    """What grey pictures of one camera, in which no rectangle was found, show instead; None where nothing is sure.

    It takes seconds: for when a search was in vain.
    """
    return redescribed(pictures, rectangles) or _foreign_tags(pictures, rectangles) or _chessboard(pictures)


def redescribed(pictures: Sequence[Picture], rectangles: Sequence[Rectangle]) -> PlainSight | None:
    """The part of `plain_sight` that takes little time: a rectangle that is mirrored, or counted otherwise."""
    pictures = [grey for grey in pictures if min(grey.shape) >= _SMALLEST]
    with_tags = [r for r in rectangles if r.marking.tags is not None and not r.back]
    for grey in pictures:
        for view in find_mirrored(grey, with_tags, near=[]):
            return PlainSight(view.rectangle, mirrored=True)
    for rectangle in rectangles:
        marking = _meant_instead(pictures, rectangle)
        if marking is not None:
            return PlainSight(rectangle.name, marking=marking)
    return None


def _chessboard(pictures: Sequence[Picture]) -> PlainSight | None:
    for grey in pictures:
        grid = largest_grid(grey) if min(grey.shape) >= _SMALLEST else None
        if grid is not None and find_chessboard(grey, *grid) is not None:
            return PlainSight(squares=(grid[0] + 1, grid[1] + 1))
    return None


def _meant_instead(pictures: Sequence[Picture], rectangle: Rectangle) -> Marking | None:
    """The marking that explains most of one of the pictures, of those that may be meant in a rectangle's place."""
    best, most = None, (_SURE_POINTS - 1, 0)
    for grey in pictures:
        for marking in rectangle.marking.meant_instead(grey):
            if marking == rectangle.marking:
                continue
            width, height = marking.size or (rectangle.width, rectangle.height)
            other = replace(rectangle, width=width, height=height, marking=marking, back=False)
            views = detect_views(grey, [other], near=[])
            points = max((len(view.pixels) for view in views), default=0)
            # Of two boards that show as much, the smaller one has nothing that is not seen.
            if (points, -len(marking.points(other))) > most:
                best, most = marking, (points, -len(marking.points(other)))
    return best


def _foreign_tags(pictures: Sequence[Picture], rectangles: Sequence[Rectangle]) -> PlainSight | None:
    """Tags of any usual dictionary that stand out in the pictures and belong to no rectangle."""
    own = families(rectangles)
    names = dict.fromkeys([*(family.dictionary for family in own), *_DICTIONARIES])
    looked_for = [TagFamily(name, inverted) for name in names for inverted in (False, True)]
    looked_for += [TagFamily("apriltag_36h11", border=2)]
    seen: Counter[tuple[TagFamily, int]] = Counter()
    for grey in pictures:
        small = reduced(grey, min(1.0, _LARGEST / max(grey.shape)))
        for family in looked_for:
            picture = 255 - small if family.inverted else small
            seen.update((family, tag) for tag in _sure_tags(picture, family))
    known = {(family, tag) for family, members in own.items() for one in members for tag in _ids(one)}
    count: Counter[TagFamily] = Counter()
    for (family, tag), times in seen.items():
        if (family, tag) not in known:
            count[family] += times
    for family, times in count.most_common():
        if times >= _TIMES or _bits(family.dictionary) >= _SURE_BITS:
            ids = sorted(tag for other, tag in seen if other == family and (family, tag) not in known)
            return PlainSight(
                family=family._replace(dictionary=_smallest(family.dictionary, max(ids))),
                ids=tuple(ids),
                times=tuple(seen[family, tag] for tag in ids),
            )
    return None


def _sure_tags(picture: Picture, family: TagFamily) -> list[int]:
    """Ids of the tags of a family in a picture."""
    found = find_tags(picture, family.dictionary, quick=True, border=family.border)
    if _bits(family.dictionary) >= _SURE_BITS or not found:
        return list(found)
    quads = np.stack([places[0] for places in found.values()])
    clean = refine_tags(picture, quads, tag_dictionary(family.dictionary).markerSize + 2).sure
    return [tag for tag, good in zip(found, clean.tolist(), strict=True) if good]


def _ids(rectangle: Rectangle) -> Iterable[int]:
    return () if rectangle.marking.tags is None else rectangle.marking.tags.ids


def _bits(name: str) -> int:
    return 36 if "36h" in name else int(name.split("_")[1][0]) ** 2 if "x" in name else 25


def _smallest(name: str, tag: int) -> str:
    """The smallest dictionary of a kind that has a tag: aruco_4x4_50 for the first of aruco_4x4_250."""
    kind = name.rpartition("_")[0]
    alike = [one for one in dictionary_names() if "x" in kind and one.rpartition("_")[0] == kind] or [name]
    return min((one for one in alike if dictionary_size(one) > tag), key=dictionary_size)
