"""Keeping the few framesets of a live stream that show something new: their corners fitted, their faults named."""

from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from quadrig.io.live.search import LiveSearch, Search
from quadrig.rig.adjustment.motion import LONGEST_GAP
from quadrig.rig.coach.capture_faults import blur_fault, exposure_fault, held_still_fault, not_static_fault
from quadrig.rig.coach.edge_width import view_edge_widths
from quadrig.rig.coach.fault import Fault
from quadrig.rig.coach.in_hand import in_hand
from quadrig.rig.coach.novelty import FASTEST, Key, Places, displaced, news, outlines_of, speed
from quadrig.rig.problem.layouts import body_of
from quadrig.single.arrays import Floats
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# After so many seconds without anything kept, a sheet that moves up to three times too fast is taken as well: a
# blurred View is worth more than none.
_HURRY, _HURRIED = 2.5, 3 * FASTEST
# What several cameras saw in motion is followed by two more framesets, this far (s) apart: three give a velocity and
# an acceleration, from which the joint adjustment finds clocks that are off, as long as no gap is longer than it
# bridges.
_FOLLOWING, _FOLLOW_AFTER = 2, 0.1
# A sheet that moved by less (of the picture's diagonal) in that time shows no clock: 10 ms, the least that clocks are
# off by, are a third of a pixel of it. Corners as the search finds them at half size stand still to within less.
_MOVED = 0.004
# Faults are said while they are this young (s): long enough to be read, short enough to be gone when mended.
_FAULT_SECONDS = 2.0


@dataclass(frozen=True, eq=False)
class Kept:
    """The Views of one frameset that were kept, and the faults for which others were not."""

    frameset: int
    stamp: int
    views: tuple[View, ...]
    faults: tuple[Fault, ...] = ()


class Keeper:
    """Decides frameset by frameset, and fits the corners of what it keeps on the threads of `pool`."""

    def __init__(self, search: LiveSearch, rectangles: Sequence[Rectangle], pool: ThreadPoolExecutor) -> None:
        self._search, self._rectangles, self._pool = search, tuple(rectangles), pool
        self._held, self._body = in_hand(rectangles), {one.name: body_of(one) for one in rectangles}
        self.views: list[View] = []
        self.framesets = 0
        self._places = Places()
        self._before: tuple[int, dict[Key, Floats]] = (0, {})
        self._pending: tuple[int, int, dict[Key, Floats], list[Future]] | None = None
        # s, of the frames' own clock: files that are played quicker than they were taken are judged alike.
        self._now: float | None = None
        self._kept_at = self._news_at = 0.0
        self._following = 0
        self._faults: dict[tuple[str, str], tuple[float, Fault]] = {}

    def restore(self, views: Sequence[View]) -> None:
        """Take over the Views of an earlier session."""
        self.views += views
        self.framesets = len({view.frameset for view in self.views})
        for view in views:
            self._places = self._places.with_views(outlines_of([view], self._rectangles))

    def consider(self, frameset: int, stamp: int, searches: Sequence[Search], diagonals: Mapping[str, float]) -> None:
        """Begin to keep a frameset where it is worth it and nothing else is being fitted."""
        outlines = outlines_of([view for search in searches for view in search.views], self._rectangles)
        before, self._before = self._before, (stamp, outlines)
        now = stamp / 1e9
        if self._now is None:
            self._kept_at = self._news_at = now
        self._now = now
        moving = {r.name for r in self._rectangles if r.moving}
        in_hand = {key: line for key, line in outlines.items() if key[1] in moving}
        fast = speed(before[1], in_hand, (stamp - before[0]) / 1e9, diagonals)
        fresh = news(outlines, self._places, diagonals)
        self._judge_stillness(bool(in_hand), bool(fresh), now)
        astray = displaced(outlines, self._places, self._rectangles, diagonals)
        if astray is not None:
            self.blame(not_static_fault(astray[1], astray[0]))
        wanted = self._wanted(outlines, fresh, moving, diagonals)
        if not wanted or self._pending is not None or self._too_fast(fast):
            return
        self._following = _FOLLOWING if fresh else self._following - 1
        futures = [self._pool.submit(self._fit, search, wanted) for search in searches if search.views]
        self._pending = (frameset, stamp, {key: outlines[key] for key in wanted}, futures)

    def _wanted(
        self, outlines: Mapping[Key, Floats], fresh: set[Key], moving: set[str], diagonals: Mapping[str, float]
    ) -> set[Key]:
        """What of a frameset is worth keeping: what is new, and how a moving sheet goes on from there."""
        if fresh:
            # A static sheet seen again from where it was seen adds nothing; what moves is wanted from all, and of a
            # body all rectangles.
            shown = {self._body[name] for _, name in fresh if name in moving}
            return fresh | {key for key in outlines if self._body[key[1]] in shown}
        since = (self._now or 0.0) - self._kept_at
        if not self._following or not _FOLLOW_AFTER <= since < LONGEST_GAP:
            return set()
        going = {k for k, line in outlines.items() if self._places.distance(k, line) > _MOVED * diagonals[k[0]]}
        cameras = Counter(body for _, body in {(camera, self._body[name]) for camera, name in going})
        return {key for key in outlines if key[1] in moving and cameras[self._body[key[1]]] > 1}

    def _too_fast(self, fast: float) -> bool:
        """Whether the sheet is too fast to be kept, which is said where it has been so for long."""
        hurried = (self._now or 0.0) - self._kept_at > _HURRY
        if fast <= (_HURRIED if hurried else FASTEST):
            return False
        if hurried:
            self.blame(Fault("motion", f"{self._held.noun} moves too fast; hold it still for a moment"))
        return True

    def collect(self, wait: bool = False) -> Kept | None:
        """What was kept since, once it is fitted."""
        if self._pending is None:
            return None
        frameset, stamp, outlines, futures = self._pending
        if not wait and not all(future.done() for future in futures):
            return None
        self._pending = None
        views: list[View] = []
        faults: list[Fault] = []
        for future in futures:
            good, bad = future.result()
            views += good
            faults += bad
        for fault in faults:
            self.blame(fault)
        if not views:
            return Kept(frameset, stamp, (), tuple(faults)) if faults else None
        self._kept_at, self._news_at = stamp / 1e9, self._now or 0.0
        self._places = self._places.with_views(
            {key: line for key, line in outlines.items() if any((v.camera, v.rectangle) == key for v in views)}
        )
        self.views += views
        self.framesets += 1
        return Kept(frameset, stamp, tuple(views), tuple(faults))

    def fault(self) -> Fault | None:
        """The fault that is to be said now, the youngest first."""
        oldest = (self._now or 0.0) - _FAULT_SECONDS
        self._faults = {k: entry for k, entry in self._faults.items() if entry[0] > oldest}
        return max(self._faults.values(), key=lambda entry: entry[0])[1] if self._faults else None

    def blame(self, fault: Fault) -> None:
        """Say a fault from now on, for a while."""
        self._faults[fault.kind, fault.camera] = (self._now or 0.0, fault)

    def _judge_stillness(self, in_hand: bool, fresh: bool, now: float) -> None:
        if fresh or not in_hand:
            self._news_at = now
            self._faults.pop(("held still", ""), None)
        still = held_still_fault(now - self._news_at, self._held)
        if still is not None:
            self.blame(still)

    def _fit(self, search: Search, wanted: set[Key]) -> tuple[list[View], list[Fault]]:
        """The Views of one camera that are wanted and good, and what is wrong with the others."""
        faults: list[Fault] = []
        sound: set[str] = set()
        for view in search.views:
            if (view.camera, view.rectangle) in wanted:
                fault = exposure_fault(view.camera, search.grey, view)
                fault = fault or blur_fault(view.camera, view_edge_widths(search.grey, view), self._held)
                if fault is None:
                    sound.add(view.rectangle)
                else:
                    faults.append(fault)
        return list(self._search.refine(search, sound)), faults
