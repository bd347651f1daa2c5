"""Several recordings of the same cameras as one: every instant its own, and what stands still in one of them only."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.problem.layouts import body_of
from quadrig.rig.start.in_step import cameras_in_step
from quadrig.single.rectangle import WORLD, Rectangle
from quadrig.single.view import View

# Between recordings that are put after one another, s: no motion is seen to go on from one to the next.
_PAUSE = 3600.0


@dataclass(frozen=True, eq=False)
class RecordedViews:
    """What one recording showed: its name, its Views, and the time of each frameset, ns, by index."""

    name: str
    views: Sequence[View]
    times: Sequence[int]


def joined(
    recordings: Sequence[RecordedViews], cameras: Sequence[CameraInput], rectangles: Sequence[Rectangle]
) -> tuple[tuple[Rectangle, ...], RecordedViews]:
    """All recordings as one, and the rectangles in it.

    What stands still stands elsewhere in each recording, but for the surveyed world, which stands where it was
    surveyed: of its rectangles, the same sheets on a body that is the same, each has a name for each recording, its
    own in the one with most Views of the body. Cameras that a recording shows
    at other times than its stamps say share no instant in it.
    """
    names = _names(recordings, rectangles)
    known = {rectangle.name: rectangle for rectangle in rectangles}
    every = dict(known)
    for (number, old), new in names.items():
        body = known[old].body and f"{known[old].body} ({recordings[number].name}, {number + 1})"
        every[new] = replace(known[old], name=new, body=body, sheet=old)
    views: list[View] = []
    times: list[int] = []
    begin = 0.0
    for number, recording in enumerate(recordings):
        renamed = [replace(v, rectangle=names.get((number, v.rectangle), v.rectangle)) for v in recording.views]
        for together in cameras_in_step(cameras, list(every.values()), renamed):
            own = [view for view in renamed if view.camera in together]
            views += [_later(view, len(times), begin) for view in own]
            times += recording.times
            begin = max([begin, *(view.time + begin for view in own if np.isfinite(view.time))]) + _PAUSE
    # Where it is seen under other names alone nobody misses it.
    idle = {old for _, old in names} - {view.rectangle for view in views}
    return tuple(one for one in every.values() if one.name not in idle), RecordedViews(
        recordings[0].name, views, times
    )


def _later(view: View, framesets: int, seconds: float) -> View:
    return replace(view, frameset=view.frameset + framesets, time=view.time + seconds)


def _names(recordings: Sequence[RecordedViews], rectangles: Sequence[Rectangle]) -> Mapping[tuple[int, str], str]:
    """New names of rectangles, by recording (its number) and the name they have."""
    seen = [Counter(view.rectangle for view in recording.views) for recording in recordings]
    taken, names = {rectangle.name for rectangle in rectangles}, {}
    of_body: dict[str, list[int]] = {}
    for rectangle in rectangles:
        counts = of_body.setdefault(body_of(rectangle), [0] * len(seen))
        counts[:] = [count + own[rectangle.name] for count, own in zip(counts, seen, strict=True)]
    for rectangle in rectangles:
        if rectangle.moving or rectangle.body == WORLD:
            continue
        numbers = [number for number, counts in enumerate(seen) if counts[rectangle.name]]
        counts = of_body[body_of(rectangle)]
        keeps = max(range(len(seen)), key=lambda number: (counts[number], -number))
        for number in numbers:
            if number != keeps:
                name = f"{rectangle.name} ({recordings[number].name})"
                names[number, rectangle.name] = name if name not in taken else f"{name} {number + 1}"
                taken.add(names[number, rectangle.name])
    return names
