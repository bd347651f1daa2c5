"""Which cameras, and which rectangles of a body, are tied by what was seen at one time, and how they stand to each
other.

Two rectangles of a body are tied by a camera that sees both at one time, two cameras by a body that both see at one
time. Each step makes the next: cameras that are tied see as one, and rectangles that are tied are seen as one.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.layouts import body_of
from quadrig.rig.start.lenses_and_poses import Candidates
from quadrig.rig.start.motion_averaging import RelativePose, average
from quadrig.rig.start.relative_poses import Sightings, chain, relative_poses, sigmas
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.pose import Pose, compose_jacobians, stacked

# A pose that is given exactly, in the place of a sigma (rad and m, as one).
_EXACT = 1e-6


@dataclass(frozen=True, eq=False)
class Tied:
    """Items in groups within which all poses are known. group (I,): the item that is each one's root; item_from_group
    (I,): its pose to the frame of that; doubt (I,): sigma of that, rad and m as one, zero for a root."""

    group: Ints
    item_from_group: Pose
    doubt: Floats

    @staticmethod
    def none(items: int) -> "Tied":
        """Every item by itself."""
        identity = Pose(np.tile(np.eye(3), (items, 1, 1)), np.zeros((items, 3)))
        return Tied(np.arange(items), identity, np.zeros(items))

    @property
    def groups(self) -> int:
        """How many groups there are."""
        return len(np.unique(self.group))


@dataclass(frozen=True, eq=False)
class Together:
    """Cameras (C,) and rectangles (R,), tied by what was seen together."""

    cameras: Tied
    rectangles: Tied


@dataclass(frozen=True, eq=False)
class Ties:
    """Relative poses of cameras, and of rectangles of a body, that are known from elsewhere than what was seen at one
    time."""

    cameras: tuple[RelativePose, ...] = ()
    rectangles: tuple[RelativePose, ...] = ()


def seen_together(problem: Problem, candidates: Candidates, reference: int, ties: Ties | None = None) -> Together:
    """All that is tied; the groups of cameras have the reference for a root where they hold it."""
    ties = ties or Ties()
    together = Together(Tied.none(len(problem.cameras)), Tied.none(len(problem.rectangles)))
    while True:
        before = together.cameras.groups, together.rectangles.groups
        together = replace(together, rectangles=_tied_rectangles(problem, candidates, together, ties.rectangles))
        relatives = relative_poses(_camera_sightings(problem, candidates, together))
        together = replace(together, cameras=_tied(len(problem.cameras), [*relatives, *ties.cameras], [reference]))
        after = together.cameras.groups, together.rectangles.groups
        if after == before or not problem.layouts.names:
            return together


def camera_from_cluster(problem: Problem, candidates: Candidates, rectangles: Tied) -> tuple[Pose, Floats, Floats]:
    """The pose (K,) of each candidate's group of rectangles in its camera, with sigmas of rotation and position."""
    rectangle = problem.rectangle[candidates.view]
    rotation, translation = sigmas(candidates)
    rows = np.flatnonzero(problem.layouts.number[rectangle] >= 0)
    if not len(rows):
        return candidates.camera_from_rect, rotation, translation
    pose, on_body = candidates.camera_from_rect[rows], rectangles.item_from_group[rectangle[rows]]
    shift, _ = compose_jacobians(pose, on_body)
    covariance = shift @ candidates.covariance[rows] @ np.swapaxes(shift, -1, -2)
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    doubt = rectangles.doubt[rectangle[rows]] ** 2
    rotation[rows] = np.sqrt(variance[:, :3].sum(axis=1) + doubt)
    far = 1 + (on_body.translation**2).sum(axis=1)
    translation[rows] = np.sqrt(variance[:, 3:].sum(axis=1) + far * doubt)
    moved = pose @ on_body
    result = Pose(candidates.camera_from_rect.rotation.copy(), candidates.camera_from_rect.translation.copy())
    result.rotation[rows], result.translation[rows] = moved.rotation, moved.translation
    return result, rotation, translation


def _camera_sightings(problem: Problem, candidates: Candidates, together: Together) -> Sightings:
    """Of cameras, in groups of rectangles."""
    view = candidates.view
    pose, rotation, translation = camera_from_cluster(problem, candidates, together.rectangles)
    cluster = together.rectangles.group[problem.rectangle[view]]
    shared = cluster * len(problem.nodes) + problem.node[view]
    return Sightings(problem.camera[view], shared, view, pose, rotation, translation, candidates.cost)


def _tied_rectangles(
    problem: Problem, candidates: Candidates, together: Together, ties: Sequence[RelativePose]
) -> Tied:
    if not problem.layouts.names:
        return together.rectangles
    names = list(problem.rectangles)
    number = {name: row for row, name in enumerate(names)}
    bodies: dict[str, list[int]] = {}
    for name, rectangle in problem.rectangles.items():
        bodies.setdefault(body_of(rectangle), []).append(number[name])
    joint = np.zeros(len(names), bool)
    for members in bodies.values():
        joint[members] = len(members) > 1
    sightings = _rectangle_sightings(problem, candidates, together, joint)
    poses = [rectangle.body_from_rect for rectangle in problem.rectangles.values()]
    given = [relative for members in bodies.values() for relative in _given(problem, members)]
    seen = [*relative_poses(sightings), *ties]
    open_ones = [one for one in seen if poses[one.left] is None or poses[one.right] is None]
    frames = [row for row in range(len(names)) if problem.layouts.number[row] < 0 or poses[row] is not None]
    tied = _tied(len(names), [*open_ones, *given], frames)
    # A group that holds a given pose stands in the frame of its body.
    of_root = [(poses[root] or Pose.identity()).inverse() for root in tied.group]
    return replace(tied, item_from_group=tied.item_from_group @ stacked(of_root))


def _given(problem: Problem, members: Sequence[int]) -> list[RelativePose]:
    """Relative poses of the rectangles (indices) of a body that have a given pose on it."""
    rectangles = list(problem.rectangles.values())
    known = [(row, rectangles[row].body_from_rect) for row in members]
    placed = [(row, pose) for row, pose in known if pose is not None]
    found = []
    for row, pose in placed[1:]:
        first, body_from_first = placed[0]
        sigma = float(np.hypot(*rectangles[row].layout_sigma)) + _EXACT
        found.append(RelativePose(first, row, body_from_first.inverse() @ pose, 1, 1, sigma))
    return found


def _rectangle_sightings(problem: Problem, candidates: Candidates, together: Together, joint: Mask) -> Sightings:
    """Of rectangles (those of bodies of several), in groups of cameras."""
    rows = np.flatnonzero(joint[problem.rectangle[candidates.view]])
    view = candidates.view[rows]
    camera = problem.camera[view]
    rotation, translation = (each[rows] for each in sigmas(candidates))
    group_from_rect = together.cameras.item_from_group[camera].inverse() @ candidates.camera_from_rect[rows]
    shared = together.cameras.group[camera] * len(problem.nodes) + problem.node[view]
    return Sightings(
        problem.rectangle[view],
        shared,
        view,
        group_from_rect,
        rotation,
        translation,
        candidates.cost[rows],
        is_seen=True,
    )


def _tied(items: int, relatives: Sequence[RelativePose], roots: Iterable[int]) -> Tied:
    """Items tied by relative poses, along the most certain path and then by the vote of all; roots: those that are to
    be the root of their group, the first of a group's first."""
    result = Tied.none(items)
    open_ones = np.ones(items, bool)
    rotation, translation = result.item_from_group.rotation, result.item_from_group.translation
    for root in [*roots, *range(items)]:
        if not open_ones[root]:
            continue
        pose, reached = chain(items, relatives, root)
        rows = np.flatnonzero(reached)
        open_ones[rows] = False
        result.group[rows] = root
        if len(rows) == 1:
            continue
        place = np.cumsum(reached) - 1
        own = [
            replace(one, left=int(place[one.left]), right=int(place[one.right]))
            for one in relatives
            if reached[one.left]
        ]
        pose = average(pose[rows], own, int(place[root]))
        rotation[rows], translation[rows] = pose.rotation, pose.translation
        for one in own:
            for row in (rows[one.left], rows[one.right]):
                best = result.doubt[row]
                if row != root and (best == 0 or one.sigma < best):
                    result.doubt[row] = one.sigma
    return result


def in_frame(problem: Problem, together: Together) -> Mask:
    """Which rectangles (R,) are tied to the frame of their body."""
    given = np.array([rectangle.body_from_rect is not None for rectangle in problem.rectangles.values()])
    is_frame = (problem.layouts.number < 0) | given
    return is_frame[together.rectangles.group]
