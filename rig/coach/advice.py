"""Coaching: of all that could be said to the person with the sheet, the one sentence that lowers the doubt most."""

from collections import Counter
from collections.abc import Collection, Hashable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Literal

import numpy as np

from quadrig.rig.coach.in_hand import InHand, in_hand
from quadrig.rig.coach.next_view import (
    Placements,
    accuracy_weight,
    expected_drop,
    expected_drop_in_hand,
    imagine,
    own_variance,
    seen,
    within_reach,
)
from quadrig.rig.coach.planned_doubt import planning_doubt
from quadrig.rig.doubt.lens_accuracy import accuracy, accuracy_in_words, is_determined, poses_alone
from quadrig.rig.doubt.working_accuracy import covered_points
from quadrig.rig.problem.connectivity import connected_groups
from quadrig.rig.problem.layouts import body_of
from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats, Mask
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

AdviceKind = Literal["show", "connect", "tilt", "region", "share", "nearer", "farther", "done"]

# Placements as near as this to one the person could not reach are not asked for again.
_REFUSED_METRES = 0.35
# A ghost counts as reached when the sheet's middle is this near and it is turned this little away: a placement
# within them gives nine tenths of the expected drop.
_REACHED_METRES, _REACHED_ANGLE = 0.12, np.deg2rad(20)
# Two cameras that saw this many sheets together need not be asked again to share.
_ENOUGH_COMMON = 3
# A new place may be so many times less sure (variance) than the mean of the volume covered so far.
_WIDER_DOUBT = 1.5
_REGION_WORDS = {
    (-1, -1): "upper left corner", (0, -1): "upper edge", (1, -1): "upper right corner",
    (-1, 0): "left edge", (0, 0): "middle", (1, 0): "right edge",
    (-1, 1): "lower left corner", (0, 1): "lower edge", (1, 1): "lower right corner",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Advice:
    """One sentence, and what it means for a program.

    cameras: whom it concerns. ghost: where the sheet should be, rig_from_rect, of rectangle `rectangle`; None
    where the rig has no frame yet. expected: the working accuracy, m, after one View there. groups: for "connect",
    one camera of each of two groups should see the sheet.
    """

    kind: AdviceKind
    sentence: str
    cameras: tuple[str, ...] = ()
    rectangle: str = ""
    ghost: Pose | None = None
    expected: float = float("nan")
    groups: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True, eq=False)
class Situation:
    """What is known when advice is asked for.

    cameras: the names of all that run; views: the kept Views; target: the accuracy asked for, m, or None.
    refused: ghosts the person could not reach; refused_pairs: cameras that could not be shown one sheet together.
    """

    cameras: tuple[str, ...]
    rectangles: tuple[Rectangle, ...]
    views: tuple[View, ...] = ()
    rig: Rig | None = None
    target: float | None = None
    refused: tuple[Pose, ...] = ()
    refused_pairs: frozenset[frozenset[str]] = field(default_factory=frozenset)

    @property
    def in_hand(self) -> InHand:
        """What the person moves."""
        return in_hand(self.rectangles, self.rig)


def advise(situation: Situation) -> Advice:
    """The one sentence that lowers the doubt most: show, connect, then the best next placement, then done."""
    rig = situation.rig
    if len(situation.cameras) == 1 or not situation.views:
        return _first(situation)
    parts = connected(situation.cameras, situation.views, situation.rectangles)
    if rig is None or len(rig.cameras) < len(situation.cameras):
        # Motion may have joined cameras that share nothing.
        return _connect(situation, parts) if len(parts) > 1 else _unplaced(situation)
    if situation.target is not None and accuracy(rig) <= situation.target:
        return Advice("done", good_for(rig) + "; press Enter to finish")
    if poses_alone(rig):
        return _carry_on(situation, rig)
    return best_placement(situation, rig) or Advice("done", good_for(rig) + "; press Enter to finish")


def good_for(rig: Rig) -> str:
    """The sentence that heads every result."""
    if not is_determined(rig):
        return "how good it is for a point is unknown"
    return f"good for {accuracy_in_words(rig)}"


def connected(
    cameras: Sequence[str], views: Iterable[View], rectangles: Sequence[Rectangle]
) -> tuple[tuple[str, ...], ...]:
    """Groups of cameras that share rectangles, directly or through others; the largest first, by name.

    Two cameras of a group show by what they see at one time how the rectangles of a body stand to each other, and
    cameras that see such rectangles at one time are of one group.
    """
    body = {r.name: body_of(r) for r in rectangles}
    moving = {r.name for r in rectangles if r.moving}
    number = {camera: index for index, camera in enumerate(cameras)}
    known = [view for view in views if view.camera in number and view.rectangle in body]
    time = [view.frameset if view.rectangle in moving else -1 for view in known]
    # What is known of one piece: a rectangle at first, later those whose places on their body are known.
    piece = {name: name for name in body}
    part = {camera: camera for camera in cameras}
    before = None
    given = [r for r in rectangles if r.body_from_rect is not None]
    seen_by, names = [view.camera for view in known], [view.rectangle for view in known]
    while before != (piece, part):
        before = dict(piece), dict(part)
        part = _joined(cameras, seen_by, [(piece[name], t) for name, t in zip(names, time, strict=True)])
        together: list[Hashable] = [(body[v.rectangle], t, part[v.camera]) for v, t in zip(known, time, strict=True)]
        piece = _joined(list(body), [*names, *(r.name for r in given)], [*together, *(r.body for r in given)])
    parts = [tuple(camera for camera in cameras if part[camera] == one) for one in dict.fromkeys(part.values())]
    return tuple(sorted(parts, key=lambda part: (-len(part), part)))


def _joined(items: Sequence[str], item: Sequence[str], shared: Sequence[Hashable]) -> dict[str, str]:
    """For each of the items the first of its group: those that share something, directly or through others."""
    number = {name: index for index, name in enumerate(items)}
    things = {thing: index for index, thing in enumerate(dict.fromkeys(shared))}
    rows, columns = [number[one] for one in item], [things[one] for one in shared]
    groups = connected_groups(len(items), np.array(rows, int), np.array(columns, int))
    return {items[index]: items[min(group)] for group in groups for index in group}


def _first(situation: Situation) -> Advice:
    """Before anything was seen; and all that can be said to somebody with one camera."""
    cameras, held = situation.cameras, situation.in_hand
    if len(cameras) == 1:
        if held.body:
            clause = f"{cameras[0]} sees two of its rectangles at a time, from this side and that"
            return Advice(
                "show", held.so_that(clause.replace("its", f"'{held.body}'s") if held.is_room else clause), cameras
            )
        return Advice("show", f"hold the sheet in front of {cameras[0]}, tilted this way and that", cameras)
    first, second = _likeliest(situation, list(combinations(cameras, 2)))
    return _together(first, second, held.for_both(first, second))


def _connect(situation: Situation, parts: Sequence[tuple[str, ...]]) -> Advice:
    """The cameras of different groups that should see one sheet together."""
    seen_by, held = {view.camera for view in situation.views}, situation.in_hand
    lone = [part[0] for part in parts[1:] if len(part) == 1]
    pairs = [(camera, other) for camera in lone for other in situation.cameras if other != camera]
    if any(frozenset(pair) not in situation.refused_pairs for pair in pairs) and len(situation.cameras) > 2:
        # Cameras that saw nothing come first, in their order, those that were asked in vain behind the others.
        tries = {camera: sum(camera in pair for pair in situation.refused_pairs) for camera in lone}
        camera = min(lone, key=lambda name: (tries[name], name in seen_by, situation.cameras.index(name)))
        said = "shares nothing with the others" if camera in seen_by else f"has not seen {held.seen}"
        _, other = _likeliest(situation, [pair for pair in pairs if pair[0] == camera])
        asked = _on_body(situation, parts, camera, other) or held.for_both(camera, other)
        return _together(camera, other, f"{camera} {said} yet: {asked}")
    groups = (parts[0], parts[1])
    if len(parts[0]) > 1 and not _refused_groups(situation, groups):
        first, second = (" or ".join(part) if len(part) < 4 else f"{part[0]} to {part[-1]}" for part in groups)
        sentence = f"{held.for_both(f'one of {first}', f'one of {second}')}: they share nothing yet"
        return Advice("connect", sentence, tuple(sorted((*parts[0], *parts[1]))), groups=groups)
    pairs = [(a, b) for k, part in enumerate(parts) for other in parts[k + 1 :] for a in part for b in other]
    first, second = _likeliest(situation, pairs)
    both = "hold the sheet where both see it"
    if held.body:
        both = _on_body(situation, parts, second, first) or held.for_both(first, second)
    return _together(first, second, f"{first} and {second} share nothing yet: {both}")


def _on_body(situation: Situation, parts: Sequence[tuple[str, ...]], camera: str, other: str) -> str:
    """Which rectangle of a body the one camera should see while the other, of another group, sees which; empty where
    nothing is moved but a sheet, or too little was seen of the body."""
    held, group = situation.in_hand, next(part for part in parts if other in part)
    if not held.body or camera not in {view.camera for view in situation.views}:
        return ""
    if frozenset((camera, other)) in situation.refused_pairs:
        return (
            f"turn {held.noun} far about one axis, then about another, while {camera} and {other} each see their own"
        )
    of_group = Counter(view.rectangle for view in situation.views if view.camera in group)
    of_other = Counter(view.rectangle for view in situation.views if view.camera == other)
    known = [name for name, _ in of_group.most_common() if of_other.keys() - {name}]
    if not known:
        return held.so_that(f"{other} sees two rectangles of '{held.body}' at a time, then {camera} one of these")
    beside = next(name for name, _ in of_other.most_common() if name != known[0])
    return held.so_that(f"{camera} sees '{known[0]}' while {other} sees '{beside}'")


def _together(first: str, second: str, sentence: str) -> Advice:
    return Advice("connect", sentence, (first, second), groups=((first,), (second,)))


def _likeliest(situation: Situation, pairs: Sequence[tuple[str, str]]) -> tuple[str, str]:
    """Of pairs of cameras the one that most likely sees one place, but for those that were asked in vain. Where
    nothing was seen yet, neighbours in the order of cameras: people number them along the wall."""
    open_pairs = [pair for pair in pairs if frozenset(pair) not in situation.refused_pairs]
    return min(open_pairs or pairs, key=lambda pair: _apart(situation, *pair))


def _refused_groups(situation: Situation, groups: tuple[tuple[str, ...], ...]) -> bool:
    return frozenset((*groups[0], *groups[1])) in situation.refused_pairs


def _apart(situation: Situation, first: str, second: str) -> tuple[float, int, int, int]:
    """Framesets between the nearest Views of one moving sheet in both (a sheet on its way from one picture to the
    other passes where they meet), then how far apart they are in the order of the cameras, then the order."""
    times = {camera: [v.frameset for v in situation.views if v.camera == camera] for camera in (first, second)}
    gaps = [abs(a - b) for a in times[first] for b in times[second]]
    one, other = situation.cameras.index(first), situation.cameras.index(second)
    return (float(min(gaps, default=10**9)), abs(one - other), one, other)


def _unplaced(situation: Situation) -> Advice:
    rig = situation.rig
    placed = {camera.name for camera in rig.cameras} if rig else set()
    lost = next((camera for camera in situation.cameras if camera not in placed), situation.cameras[0])
    others = [camera for camera in situation.cameras if camera != lost]
    _, other = _likeliest(
        situation, [(lost, one) for one in others if one in placed] or [(lost, one) for one in others]
    )
    held = situation.in_hand
    if held.body:
        why = rig.missing.get(lost, "") if rig is not None else ""
        return Advice(
            "tilt", why or f"{held.for_both(lost, other)}, turning it about more than one axis", (lost, other)
        )
    return Advice("tilt", f"tilt the sheet more, where {lost} and {other} both see it", (lost, other))


def _carry_on(situation: Situation, rig: Rig) -> Advice:
    """Of a rig whose cameras see nothing in common: the camera that is least sure, and what it saw least of."""
    camera = max((one.name for one in rig.cameras), key=rig.position_sigma)
    seen_by_it = Counter(view.rectangle for view in situation.views if view.camera == camera)
    # What it saw it can see again, and what it saw least tells most.
    wanted = min(sorted(seen_by_it), key=lambda name: seen_by_it[name])
    clause = f"{camera}, the least sure of all, sees '{wanted}'; tilt it on the way, forward and to the sides"
    return Advice("show", situation.in_hand.so_that(clause), (camera,), wanted)


def best_placement(situation: Situation, rig: Rig) -> Advice | None:
    """The placement that lowers the rig's doubt most and why, in a sentence; None where nothing helps."""
    cameras, covariance = planning_doubt(rig)
    rig = replace(rig, cameras=cameras, covariance=covariance)
    volume = covered_points(rig.rectangles)
    weight = accuracy_weight(rig.cameras, volume)
    before = float(np.trace(weight @ rig.covariance))
    best: tuple[float, Placements, Mask, Floats, int] | None = None
    for rectangle in _in_hand(situation.rectangles):
        placements = imagine(rig.cameras, rectangle, volume)
        good = within_reach(placements, volume) & ~_refused(placements, situation.refused)
        good &= seen(rig.cameras, placements).any(1)
        if not good.any():
            continue
        placements = placements[good]
        sees = seen(rig.cameras, placements)
        exact = expected_drop(rig.cameras, rig.covariance, weight, placements, sees, _noise(rig))
        held = expected_drop_in_hand(rig.cameras, rig.covariance, weight, placements, exact, _noise(rig))
        held *= _worth_answering_for(rig, placements, sees, volume, before, held)
        chosen = int(np.argmax(held))
        if best is None or held[chosen] > best[0]:
            best = (float(held[chosen]), placements, sees, exact, chosen)
    if best is None or not best[0] > 0:
        return None
    drop, placements, sees, drops, chosen = best
    kind, sentence, concerned = _why(situation, rig, placements, sees, drops, chosen, weight)
    ghost = placements.rig_from_rect[chosen]
    return Advice(kind, sentence, concerned, placements.rectangle.name, ghost, float(np.sqrt(max(before - drop, 0))))


def _worth_answering_for(
    rig: Rig, placements: Placements, sees: Mask, volume: Floats, before: float, held: Floats
) -> Mask:
    """Which placements (B,) leave the covered volume one that can be answered for; all where none does.

    A placement far out, where the rig will know little even afterwards, lowers the doubt of the middle but widens
    the volume by more than that.
    """
    worth = np.zeros(len(placements), bool)
    helps = np.flatnonzero(held > 0)
    if len(helps):
        own, count = own_variance(rig.cameras, rig.covariance, volume, placements[helps], sees[helps], _noise(rig))
        worth[helps] = own <= _WIDER_DOUBT * count * np.maximum(before - held[helps], 0)
    return worth if worth.any() else np.ones(len(placements), bool)


def _in_hand(rectangles: Sequence[Rectangle]) -> list[Rectangle]:
    """The rectangles a person can hold elsewhere."""
    return [rectangle for rectangle in rectangles if rectangle.moving]


def _noise(rig: Rig) -> float:
    return rig.noise if np.isfinite(rig.noise) and rig.noise > 0 else 1.0


def _refused(placements: Placements, refused: Collection[Pose]) -> Mask:
    near = np.zeros(len(placements), bool)
    for pose in refused:
        offset = placements.rig_from_rect.translation - pose.translation
        near |= np.linalg.norm(offset, axis=-1) < _REFUSED_METRES
    return near


def _why(
    situation: Situation, rig: Rig, placements: Placements, sees: Mask, drops: Floats, chosen: int, weight: Floats
) -> tuple[AdviceKind, str, tuple[str, ...]]:
    """What makes the chosen placement better than its plainer neighbours: the change that costs most of the drop."""
    camera = rig.cameras[int(placements.camera[chosen])].name
    together = _shared_with(rig, placements, sees, chosen, weight)
    row, fill = placements.region[chosen], placements.fill[chosen]
    same_camera = placements.camera == placements.camera[chosen]
    same_region = same_camera & (placements.region == row).all(1)
    flat = same_region & (placements.fill == fill) & (placements.tilt == 0).all(1)
    middle = same_camera & (placements.region == 0).all(1) & (placements.fill == fill)
    elsewhere = same_region & (placements.fill != fill)
    losses: dict[AdviceKind, float] = {}
    if placements.tilt[chosen].any():
        losses["tilt"] = _loss(drops, chosen, flat)
    if row.any():
        losses["region"] = _loss(drops, chosen, middle)
    if elsewhere.any():
        losses["nearer" if fill > float(np.median(placements.fill[same_camera])) else "farther"] = 0.5 * _loss(
            drops, chosen, elsewhere
        )
    if together:
        common = _common_views(situation, camera, together[0])
        losses["share"] = together[1] / (1 + common / _ENOUGH_COMMON)
    kind = max(losses, key=lambda k: losses[k]) if losses else "region"
    held, name = situation.in_hand, placements.rectangle.name
    where = _REGION_WORDS[(int(row[0]), int(row[1]))]
    if kind == "share" and together:
        return kind, held.for_both(camera, together[0]), (camera, together[0])
    if held.body:
        return kind, held.so_that(f"{camera} sees '{name}' {_seen_so(kind, placements, chosen, where)}"), (camera,)
    if kind == "tilt":
        side = "to one side" if placements.tilt[chosen][1] else "forward or back"
        return kind, f"{camera}: tilt the sheet more, {side}", (camera,)
    if kind == "region":
        return kind, f"{camera}: {where} of the picture", (camera,)
    if kind == "nearer":
        return kind, f"{camera}: hold the sheet nearer to the camera", (camera,)
    return kind, f"{camera}: hold the sheet farther from the camera", (camera,)


def _seen_so(kind: AdviceKind, placements: Placements, chosen: int, where: str) -> str:
    """How a camera should see a rectangle."""
    if kind == "tilt":
        return "tilted to one side" if placements.tilt[chosen][1] else "tilted forward or back"
    return {"nearer": "nearer", "farther": "farther away"}.get(kind, f"at the {where} of its picture")


def _common_views(situation: Situation, first: str, second: str) -> int:
    """How often two cameras saw one rectangle at once."""
    seen_by = {
        camera: {(v.rectangle, v.frameset) for v in situation.views if v.camera == camera}
        for camera in (first, second)
    }
    return len(seen_by[first] & seen_by[second])


def _loss(drops: Floats, chosen: int, plainer: Mask) -> float:
    """Part of the drop that the best of the plainer placements does not give; all of it where there is none."""
    return 1.0 if not plainer.any() else 1.0 - float(drops[plainer].max() / drops[chosen])


def _shared_with(
    rig: Rig, placements: Placements, sees: Mask, chosen: int, weight: Floats
) -> tuple[str, float] | None:
    """The other camera whose seeing the sheet too matters most, and the part of the drop that hangs on it."""
    own = int(placements.camera[chosen])
    others = [k for k in np.flatnonzero(sees[chosen]) if k != own]
    if not others or not sees[chosen, own]:
        return None
    without = np.repeat(sees[[chosen]], len(others), axis=0)
    without[np.arange(len(others)), others] = False
    copies = placements[np.full(len(others), chosen)]
    drops = expected_drop(rig.cameras, rig.covariance, weight, copies, without, _noise(rig))
    full = expected_drop(
        rig.cameras, rig.covariance, weight, placements[np.array([chosen])], sees[[chosen]], _noise(rig)
    )
    worst = int(np.argmin(drops))
    return rig.cameras[int(others[worst])].name, 1.0 - float(drops[worst] / full[0])


def reached(ghost: Pose, rig_from_rect: Pose) -> bool:
    """Whether a sheet stands where the ghost does, as nearly as a person can hold it; turning it over its own
    middle in its plane changes nothing."""
    apart = float(np.linalg.norm(ghost.translation - rig_from_rect.translation))
    cosine = float(ghost.rotation[:, 2] @ rig_from_rect.rotation[:, 2])
    return apart < _REACHED_METRES and cosine > np.cos(_REACHED_ANGLE)
