"""Why a camera finds no sheet: it is mirrored, described otherwise or not named in rig.toml, it moves, or the lens is
not in focus."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from quadrig.io.live.search import Search, halved
from quadrig.io.search.plain_sights import sight_words
from quadrig.rig.coach.capture_faults import unreadable_fault, wrong_board_fault
from quadrig.rig.coach.fault import Fault
from quadrig.single.arrays import Picture
from quadrig.single.detect.image_search import families
from quadrig.single.detect.plain_sight import PlainSight, redescribed
from quadrig.single.detect.tag import find_tags
from quadrig.single.rectangle import Rectangle

# One camera is looked at this often (s): without wanted ids its picture costs as much as a frameset.
_EVERY = 0.5
# Dictionaries people print, looked for in turn after those of rig.toml. Small ones of many ids read clutter as tags.
_USUAL = ("apriltag_36h11", "aruco_4x4_50", "aruco_5x5_100", "aruco_6x6_250", "apriltag_25h9")

Tag = tuple[str, int]


@dataclass(frozen=True)
class _Look:
    """What one look found."""

    tags: frozenset[Tag] = frozenset()
    fault: Fault | None = None


class BlindCameras:
    """Looks now and then at a camera that sees no known sheet; only what two looks in a row show is believed."""

    def __init__(self, rectangles: Sequence[Rectangle]) -> None:
        self._rectangles = tuple(rectangles)
        self._own = list(dict.fromkeys(family.dictionary for family in families(rectangles)))
        self._others = [name for name in _USUAL if name not in self._own]
        self._turn, self._last = 0, 0.0
        self._looks: dict[str, _Look] = {}
        self._pictures: dict[str, Picture] = {}
        self._sights: dict[str, PlainSight | None] = {}

    def look(self, searches: Sequence[Search], now: float) -> Fault | None:
        """What keeps one of the cameras from finding anything, in words. now: s, of the frames' clock."""
        before, self._pictures = self._pictures, {**self._pictures, **{s.camera: s.grey for s in searches}}
        blind = [search for search in searches if not search.views]
        if not blind or now - self._last < _EVERY:
            return None
        self._last, self._turn = now, self._turn + 1
        # Two looks in a row go to one camera and one dictionary beside rig.toml's own.
        search = blind[self._turn // 2 % len(blind)]
        other = [self._others[self._turn // 2 // len(blind) % len(self._others)]] if self._others else []
        half, half_before = halved(search.grey), halved(before.get(search.camera, search.grey))
        if said := self._described_otherwise(search.camera, half):
            return said
        tags = frozenset((name, tag) for name in [*self._own, *other] for tag in find_tags(half, name, quick=True))
        look = _Look(tags, unreadable_fault(search.camera, half, half_before))
        if look.fault is not None and look.fault.kind == "motion" and len(blind) < len(searches):
            # Where another camera sees the sheet, what moves here may be anything.
            look = replace(look, fault=None)
        known, self._looks[search.camera] = self._looks.get(search.camera, _Look()), look
        if twice := sorted(look.tags & known.tags):
            return wrong_board_fault({search.camera: twice}, self._rectangles)
        return look.fault if look.fault == known.fault else None

    def _described_otherwise(self, camera: str, half: Picture) -> Fault | None:
        """Whether two looks in a row show a rectangle mirrored, or as it would be with another marking."""
        known, sight = self._sights.get(camera), redescribed([half], self._rectangles)
        self._sights[camera] = sight
        if sight is None or sight != known:
            return None
        return Fault("wrong board", sight_words(camera, sight, self._rectangles), camera)
