"""Which cameras share nothing with the others, and what would join them."""

import numpy as np

from quadrig.rig.problem.build import Problem
from quadrig.single.arrays import Ints, Mask
from quadrig.single.errors import QuadrigError


def connected_groups(items: int, item: Ints, shared: Ints) -> list[list[int]]:
    """Groups of the items 0 .. items - 1 that share something, directly or through others; the largest first.

    item, shared (K,): each item with each thing that it shares.
    """
    order = np.argsort(shared, kind="stable")
    item, shared = item[order], shared[order]
    together = shared[1:] == shared[:-1]
    group = np.arange(items)
    # Hundreds of thousands of Views join a handful of cameras: each two are looked at once.
    for pair in np.unique(item[:-1][together] * items + item[1:][together]):
        left, right = group[pair // items], group[pair % items]
        if left != right:
            group[group == max(left, right)] = min(left, right)
    groups = [np.flatnonzero(group == first).tolist() for first in np.unique(group)]
    return sorted(groups, key=lambda members: (-len(members), members))


def components(problem: Problem, views: Ints | None = None) -> list[list[int]]:
    """Cameras (indices) that rectangles join, directly or through others; largest group first. views (indices): those
    that count, all where None."""
    views = np.arange(len(problem.views)) if views is None else views
    return connected_groups(len(problem.cameras), problem.camera[views], problem.node[views])


def seen_by_others(problem: Problem) -> Mask:
    """Which Views (V,) bool are of a rectangle that another camera saw at the same time, or as it stood still."""
    what = problem.node * len(problem.rectangles) + problem.rectangle
    sightings = np.unique(what * len(problem.cameras) + problem.camera)
    seen, watchers = np.unique(sightings // len(problem.cameras), return_counts=True)
    return np.isin(what, seen[watchers > 1])


def missing_cameras(problem: Problem, kept: list[int]) -> dict[str, str]:
    """A sentence for each camera that is not among those kept: what it lacks, and what to show to whom."""
    sentences = {}
    for group in components(problem):
        for camera in sorted(set(group) - set(kept)):
            name = problem.cameras[camera].name
            if set(group) & set(kept):
                sentences[name] = _untied(problem, camera, kept) or contradiction(name)
            else:
                sentences[name] = _sentence(problem, camera, group, kept)
    return sentences


def _untied(problem: Problem, camera: int, kept: list[int]) -> str:
    """What to say of a camera that saw other rectangles of a body than the others did; empty where it saw one of
    theirs at one time."""
    own, theirs = problem.camera == camera, np.isin(problem.camera, kept)
    seen = problem.node * len(problem.rectangles) + problem.rectangle
    if np.isin(seen[own], seen[theirs]).any():
        return ""
    names, others = list(problem.rectangles), ", ".join(problem.cameras[c].name for c in kept)
    shared = own & np.isin(problem.node, problem.node[theirs])
    mine = ", ".join(repr(names[row]) for row in np.unique(problem.rectangle[shared]))
    body = problem.nodes[int(problem.node[shared][0])].body
    return (
        f"{problem.cameras[camera].name}: of body {body!r} it saw {mine} and {others} other rectangles, and nothing "
        "shows how these stand to each other: show one rectangle to both at once, or turn everything about two axes, "
        "far and for longer, while each sees its own"
    )


def contradiction(name: str) -> str:
    """What to say of a camera that shares rectangles with the others, but agrees with none of them."""
    return (
        f"{name}: what it saw contradicts the other cameras, as where it was recorded at another time; "
        "poses need a rectangle that cameras see at one time: check its clock, and that it is of this rig"
    )


def refuse(problem: Problem) -> QuadrigError:
    """The error where no rectangle was seen at all."""
    cameras = ", ".join(camera.name for camera in problem.cameras) or "no camera"
    return QuadrigError(
        f"no rectangle was found in the pictures of {cameras}; "
        "check the markings, sizes and dictionaries in rig.toml against what was printed"
    )


def _sentence(problem: Problem, camera: int, group: list[int], kept: list[int]) -> str:
    name = problem.cameras[camera].name
    own = {int(problem.node[i]) for i in range(len(problem.views)) if problem.camera[i] == camera}
    others = ", ".join(problem.cameras[c].name for c in kept)
    if not own:
        rectangles = ", ".join(repr(r) for r in sorted(problem.rectangles))
        return f"{name} saw no rectangle; show it {rectangles} together with {others}"
    company = [problem.cameras[c].name for c in group if c != camera]
    joined = f" (only with {', '.join(company)})" if company else ""
    near, rectangle, gap = _nearest(problem, camera, kept)
    if rectangle is None:
        wanted = sorted({problem.views[i].rectangle for i in np.flatnonzero(problem.camera == camera)})
        return (
            f"{name} shares no rectangle with {others}{joined}; "
            f"hold {wanted[0]!r} where {name} and {near} see it at once"
        )
    return (
        f"{name} shares no rectangle with {others}{joined}; it comes nearest with {near}: both saw {rectangle!r}, "
        f"{gap} framesets apart; hold {rectangle!r} still where {name} and {near} see it at once"
    )


def _nearest(problem: Problem, camera: int, kept: list[int]) -> tuple[str, str | None, int]:
    """The kept camera, and the rectangle, that this camera comes nearest to sharing, and how many framesets apart."""
    best: tuple[int, str, str] | None = None
    own = [problem.views[i] for i in range(len(problem.views)) if problem.camera[i] == camera]
    frames: dict[str, list[int]] = {}
    for view in own:
        frames.setdefault(view.rectangle, []).append(view.frameset)
    for index in range(len(problem.views)):
        other = problem.views[index]
        if int(problem.camera[index]) in kept and other.rectangle in frames:
            gap = min(abs(other.frameset - f) for f in frames[other.rectangle])
            entry = (gap, other.camera, other.rectangle)
            best = entry if best is None or entry < best else best
    if best is None:
        seeing = [c for c in kept if (problem.camera == c).any()] or kept
        return problem.cameras[seeing[0]].name, None, 0
    return best[1], best[2], best[0]
