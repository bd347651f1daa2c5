"""Relative poses of two things that Views tie together, by the vote of everything that both share.

Two cameras share poses of bodies that both see; two rectangles of a body share the cameras that see both at one time.
All readings and twins vote, the largest agreement wins. Then the paths of least uncertainty (Bajramovic and Denzler,
"Global uncertainty-based selection of relative poses for multi camera calibration", BMVC 2008) chain them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadrig.rig.start.lenses_and_poses import Candidates
from quadrig.rig.start.motion_averaging import RelativePose
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.pose import Pose
from quadrig.single.rotation import nearest_rotation

# Candidates further apart than this many of their common sigmas do not support one another.
AGREES = 4.0
# What votes for a relative pose: the most certain. More would not change who wins.
_MOST_VOTERS = 32


@dataclass(frozen=True, eq=False)
class Sightings:
    """Poses of items, each by one candidate of a View. item, shared, view (K,): whose pose it is, in what, by which
    View. pose (K,): item_from_shared of cameras, shared_from_item of rectangles (is_seen). rotation, translation
    (K,): sigmas of its step, rad and m; cost (K,): chi-square above the View's likeliest candidate."""

    item: Ints
    shared: Ints
    view: Ints
    pose: Pose
    rotation: Floats
    translation: Floats
    cost: Floats
    is_seen: bool = False

    def between(self, i: Ints, j: Ints) -> tuple[Pose, Floats, Floats]:
        """left_from_right by rows of the left and of the right item, with sigmas of its rotation and position."""
        left, right = self.pose[i], self.pose[j]
        rotation = np.hypot(self.rotation[i], self.rotation[j])
        if self.is_seen:
            pose = left.inverse() @ right
            lever = np.linalg.norm(right.translation - left.translation, axis=-1) * self.rotation[i]
        else:
            pose = left @ right.inverse()
            lever = np.linalg.norm(left.translation, axis=-1) * self.rotation[j]
        translation = np.sqrt(self.translation[i] ** 2 + self.translation[j] ** 2 + lever**2)
        return pose, rotation, translation


def sigmas(candidates: Candidates) -> tuple[Floats, Floats]:
    """Sigma of rotation (rad) and of translation (m) of each candidate."""
    variance = np.einsum("kii->ki", candidates.covariance)
    return np.sqrt(variance[:, :3].sum(axis=1)), np.sqrt(variance[:, 3:].sum(axis=1))


def relative_poses(sightings: Sightings) -> list[RelativePose]:
    """The relative pose of every two items that share something."""
    by_item = _rows_of_first_view(sightings)
    relatives = []
    for (left, right), things in _sharing(by_item).items():
        rows = [(i, j) for n in things for i in by_item[left][n] for j in by_item[right][n]]
        i, j = np.array(rows).T
        pose, rotation, translation = sightings.between(i, j)
        cost = sightings.cost[i] + sightings.cost[j]
        relatives.append(_vote(left, right, pose, sightings.shared[i], rotation, translation, cost))
    return relatives


def _rows_of_first_view(sightings: Sightings) -> dict[int, dict[int, list[int]]]:
    """For each item and shared thing the candidates of its most certain View; others of a still pair repeat it."""
    item, shared, view = sightings.item.tolist(), sightings.shared.tolist(), sightings.view.tolist()
    best: dict[tuple[int, int], tuple[float, int]] = {}
    for row, sigma in enumerate(sightings.rotation.tolist()):
        key, entry = (item[row], shared[row]), (sigma, view[row])
        if key not in best or entry < best[key]:
            best[key] = entry
    found: dict[int, dict[int, list[int]]] = {}
    for row in range(len(item)):
        if best[item[row], shared[row]][1] == view[row]:
            found.setdefault(item[row], {}).setdefault(shared[row], []).append(row)
    return found


def _sharing(by_item: dict[int, dict[int, list[int]]]) -> dict[tuple[int, int], list[int]]:
    """What each two items share, at most _MOST_VOTERS of it, spread evenly over all."""
    by_shared: dict[int, list[int]] = {}
    for item, things in by_item.items():
        for thing in things:
            by_shared.setdefault(thing, []).append(item)
    common: dict[tuple[int, int], list[int]] = {}
    for thing in sorted(by_shared):
        seen = sorted(by_shared[thing])
        for position, left in enumerate(seen):
            for right in seen[position + 1 :]:
                common.setdefault((left, right), []).append(thing)
    return {
        pair: things
        if len(things) <= _MOST_VOTERS
        else [things[k * len(things) // _MOST_VOTERS] for k in range(_MOST_VOTERS)]
        for pair, things in common.items()
    }


def _vote(
    left: int, right: int, poses: Pose, shared: Ints, rotation: Floats, translation: Floats, cost: Floats
) -> RelativePose:
    """The candidate that most of what both share agrees with, averaged with all that do."""
    distance = disagreement(poses, poses, rotation, translation, rotation, translation)
    weight = np.where(distance < AGREES, np.exp(-0.5 * distance**2 - 0.25 * cost[None, :]), 0.0)
    # Candidates of one shared thing stand together.
    starts = np.flatnonzero(np.diff(shared, prepend=-1))
    by_shared = np.maximum.reduceat(weight, starts, axis=1)
    # Among equals (one shared thing) the likelihood of the candidate itself decides.
    winner = int(np.argmax(by_shared.sum(axis=1) - 1e-3 * cost))
    # One candidate each: the one nearest to the winner.
    nearest = np.repeat(by_shared[winner], np.diff(starts, append=len(shared)))
    keep = (weight[winner] > 0) & (weight[winner] >= nearest)
    share = np.where(keep, 1 / translation**2, 0.0)
    mean_rotation = nearest_rotation(np.einsum("k,kij->ij", np.where(keep, 1 / rotation**2, 0.0), poses.rotation))
    mean_position = share @ poses.translation / share.sum()
    spread = 1 / np.sqrt(np.where(keep, 1 / (rotation**2 + translation**2), 0.0).sum())
    return RelativePose(
        left,
        right,
        Pose(mean_rotation, mean_position),
        int((by_shared[winner] > 0).sum()),
        len(starts),
        float(spread),
    )


def disagreement(
    a: Pose, b: Pose, rotation_a: Floats, translation_a: Floats, rotation_b: Floats, translation_b: Floats
) -> Floats:
    """Distances (A, B) of two batches of poses in their common sigmas."""
    trace = a.rotation.reshape(-1, 9) @ b.rotation.reshape(-1, 9).T
    angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    gap = np.linalg.norm(a.translation[:, None] - b.translation[None], axis=-1)
    return np.sqrt(
        angle**2 / (rotation_a[:, None] ** 2 + rotation_b[None] ** 2)
        + gap**2 / (translation_a[:, None] ** 2 + translation_b[None] ** 2)
    )


def chain(items: int, relatives: Sequence[RelativePose], reference: int) -> tuple[Pose, Mask]:
    """item_from_reference (I,) along the path of least summed variance from the reference item, and which (I,) are
    reached."""
    import networkx

    graph = networkx.Graph()
    graph.add_nodes_from(range(items))
    for relative in relatives:
        # A pose that few of its voters support is a guess: it is taken only where no better way leads.
        trust = relative.support / max(relative.voters, 1)
        graph.add_edge(relative.left, relative.right, weight=relative.sigma**2 / trust**4, relative=relative)
    paths = networkx.single_source_dijkstra_path(graph, reference)
    rotation, translation = np.tile(np.eye(3), (items, 1, 1)), np.zeros((items, 3))
    connected = np.zeros(items, bool)
    for item, path in sorted(paths.items(), key=lambda item: len(item[1])):
        connected[item] = True
        if len(path) == 1:
            continue
        before, step = path[-2], graph.edges[path[-2], item]["relative"]
        item_from_before = step.left_from_right if step.left == item else step.left_from_right.inverse()
        pose = item_from_before @ Pose(rotation[before], translation[before])
        rotation[item], translation[item] = pose.rotation, pose.translation
    return Pose(rotation, translation), connected
