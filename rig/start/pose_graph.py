"""The pose graph: cameras and rectangle poses joined by Views.

Relative poses of two cameras come from every rectangle pose that both see; all readings and twins vote, the largest
agreement wins. Then the paths of least uncertainty (Bajramovic and Denzler, "Global uncertainty-based selection of
relative poses for multi camera calibration", BMVC 2008) chain Eq. 50 into the rig frame.
"""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.problem.build import Problem
from quadrig.rig.start.lenses_and_poses import Candidates
from quadrig.rig.start.motion_averaging import RelativePose, average
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.pose import Pose
from quadrig.single.rotation import nearest_rotation

# Candidates further apart than this many of their common sigmas do not support one another.
_AGREES = 4.0
# Shared rectangle poses that vote for two cameras: the most certain ones. More would not change who wins.
_MOST_VOTERS = 32


@dataclass(frozen=True, eq=False)
class FirstRig:
    """Poses to start the joint adjustment from.

    camera_from_rig (C,): identity for cameras that are not connected; connected (C,) bool. rig_from_node (N,).
    reading (V,): of each View; agrees (V,) bool: False where no candidate of the View fits the others.
    """

    camera_from_rig: Pose
    connected: Mask
    rig_from_node: Pose
    reading: Ints
    agrees: Mask


def first_rig(problem: Problem, candidates: Candidates, reference: int) -> FirstRig:
    """Poses of all that is connected to the reference camera, in its frame."""
    relatives = relative_poses(problem, candidates)
    camera_from_rig, connected = _chain(len(problem.cameras), relatives, reference)
    camera_from_rig = average(camera_from_rig, relatives, reference)
    rig_from_node, choice, agrees = _place_nodes(problem, candidates, camera_from_rig, connected)
    reading = candidates.reading[choice]
    return FirstRig(camera_from_rig, connected, rig_from_node, reading, agrees)


def sigmas(candidates: Candidates) -> tuple[Floats, Floats]:
    """Sigma of rotation (rad) and of translation (m) of each candidate."""
    variance = np.einsum("kii->ki", candidates.covariance)
    return np.sqrt(variance[:, :3].sum(axis=1)), np.sqrt(variance[:, 3:].sum(axis=1))


def relative_poses(problem: Problem, candidates: Candidates) -> list[RelativePose]:
    """The relative pose of every two cameras that share a rectangle pose."""
    node, camera = problem.node[candidates.view], problem.camera[candidates.view]
    sigma_rotation, sigma_translation = sigmas(candidates)
    distance = np.linalg.norm(candidates.camera_from_node.translation, axis=-1)
    by_camera = _rows_of_first_view(candidates, node, camera, sigma_rotation)
    relatives = []
    for (left, right), nodes in _sharing(by_camera).items():
        rows = [(i, j) for n in nodes for i in by_camera[left][n] for j in by_camera[right][n]]
        i, j = np.array(rows).T
        chained = candidates.camera_from_node[i] @ candidates.camera_from_node[j].inverse()
        rotation = np.hypot(sigma_rotation[i], sigma_rotation[j])
        translation = np.sqrt(
            sigma_translation[i] ** 2 + sigma_translation[j] ** 2 + (distance[i] * sigma_rotation[j]) ** 2
        )
        relatives.append(
            _vote(left, right, chained, node[i], rotation, translation, candidates.cost[i] + candidates.cost[j])
        )
    return relatives


def _rows_of_first_view(
    candidates: Candidates, node: Ints, camera: Ints, sigma: Floats
) -> dict[int, dict[int, list[int]]]:
    """For each camera and node the candidates of its most certain View; other Views of a still pair repeat it."""
    best: dict[tuple[int, int], tuple[float, int]] = {}
    for row in range(len(node)):
        key = (int(camera[row]), int(node[row]))
        entry = (float(sigma[row]), int(candidates.view[row]))
        if key not in best or entry < best[key]:
            best[key] = entry
    found: dict[int, dict[int, list[int]]] = {}
    for row in range(len(node)):
        key = (int(camera[row]), int(node[row]))
        if best[key][1] == candidates.view[row]:
            found.setdefault(key[0], {}).setdefault(key[1], []).append(row)
    return found


def _sharing(by_camera: dict[int, dict[int, list[int]]]) -> dict[tuple[int, int], list[int]]:
    """The nodes that each two cameras share, at most _MOST_VOTERS, spread evenly over all they share."""
    by_node: dict[int, list[int]] = {}
    for camera, nodes in by_camera.items():
        for node in nodes:
            by_node.setdefault(node, []).append(camera)
    shared: dict[tuple[int, int], list[int]] = {}
    for node in sorted(by_node):
        seen = sorted(by_node[node])
        for position, left in enumerate(seen):
            for right in seen[position + 1 :]:
                shared.setdefault((left, right), []).append(node)
    return {
        pair: nodes
        if len(nodes) <= _MOST_VOTERS
        else [nodes[k * len(nodes) // _MOST_VOTERS] for k in range(_MOST_VOTERS)]
        for pair, nodes in shared.items()
    }


def _vote(
    left: int, right: int, poses: Pose, node: Ints, rotation: Floats, translation: Floats, cost: Floats
) -> RelativePose:
    """The candidate that most rectangle poses agree with, averaged with all that do."""
    distance = disagreement(poses, poses, rotation, translation, rotation, translation)
    weight = np.where(distance < _AGREES, np.exp(-0.5 * distance**2 - 0.25 * cost[None, :]), 0.0)
    # Candidates of one rectangle pose stand together.
    starts = np.flatnonzero(np.diff(node, prepend=-1))
    by_node = np.maximum.reduceat(weight, starts, axis=1)
    # Among equals (one shared rectangle pose) the likelihood of the candidate itself decides.
    winner = int(np.argmax(by_node.sum(axis=1) - 1e-3 * cost))
    # One candidate a rectangle pose: the one nearest to the winner.
    nearest = np.repeat(by_node[winner], np.diff(starts, append=len(node)))
    keep = (weight[winner] > 0) & (weight[winner] >= nearest)
    share = np.where(keep, 1 / translation**2, 0.0)
    mean_rotation = nearest_rotation(np.einsum("k,kij->ij", np.where(keep, 1 / rotation**2, 0.0), poses.rotation))
    mean_position = share @ poses.translation / share.sum()
    spread = 1 / np.sqrt(np.where(keep, 1 / (rotation**2 + translation**2), 0.0).sum())
    return RelativePose(
        left, right, Pose(mean_rotation, mean_position), int((by_node[winner] > 0).sum()), len(starts), float(spread)
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


def _chain(cameras: int, relatives: list[RelativePose], reference: int) -> tuple[Pose, Mask]:
    """camera_from_rig along the path of least summed variance from the reference camera."""
    import networkx

    graph = networkx.Graph()
    graph.add_nodes_from(range(cameras))
    for relative in relatives:
        # A pose that few of its voters support is a guess: it is taken only where no better way leads.
        trust = relative.support / max(relative.voters, 1)
        graph.add_edge(relative.left, relative.right, weight=relative.sigma**2 / trust**4, relative=relative)
    paths = networkx.single_source_dijkstra_path(graph, reference)
    rotation, translation = np.tile(np.eye(3), (cameras, 1, 1)), np.zeros((cameras, 3))
    connected = np.zeros(cameras, bool)
    for camera, path in sorted(paths.items(), key=lambda item: len(item[1])):
        connected[camera] = True
        if len(path) == 1:
            continue
        before, step = path[-2], graph.edges[path[-2], camera]["relative"]
        camera_from_before = step.left_from_right if step.left == camera else step.left_from_right.inverse()
        pose = camera_from_before @ Pose(rotation[before], translation[before])
        rotation[camera], translation[camera] = pose.rotation, pose.translation
    return Pose(rotation, translation), connected


def _place_nodes(
    problem: Problem, candidates: Candidates, camera_from_rig: Pose, connected: Mask
) -> tuple[Pose, Ints, Mask]:
    """rig_from_node (N,), the candidate chosen of every View (V,), and whether it agrees with its node (V,)."""
    node, camera = problem.node[candidates.view], problem.camera[candidates.view]
    rig_from_node = camera_from_rig[camera].inverse() @ candidates.camera_from_node
    rotation, translation = sigmas(candidates)
    usable = connected[camera]
    left, right = _same_node_pairs(node)
    apart = _distance_rows(rig_from_node, rotation, translation, left, right)
    likely = np.exp(-0.5 * apart**2 - 0.25 * candidates.cost[right])
    agree = np.where((apart < _AGREES) & usable[left] & usable[right], likely, 0.0)
    # Each other View supports a candidate once, with the likeliest of its own candidates.
    key = left * len(problem.views) + candidates.view[right]
    order = np.argsort(key, kind="stable")
    keys, starts = np.unique(key[order], return_index=True)
    largest = np.maximum.reduceat(agree[order], starts) if len(starts) else np.zeros(0)
    row, view = np.divmod(keys, len(problem.views))
    own = problem.camera[view] == camera[row]
    other_cameras = np.bincount(row[~own], largest[~own], len(node))
    same_camera = np.bincount(row[own], largest[own], len(node))
    # A camera sees the same twin again and again: all its other Views together say less than one of another camera.
    support = other_cameras + 0.5 * same_camera / (1 + same_camera)
    score = np.where(usable, support - 1e-3 * candidates.cost - 1e-3 * np.minimum(rotation, 100.0), -np.inf)
    best = _best_by_key(score, node, len(problem.nodes))
    chosen = rig_from_node[best]
    gap = _distance_rows(rig_from_node, rotation, translation, np.arange(len(node)), best[node])
    choice = _best_by_key(
        np.where(usable, -gap - 1e-6 * candidates.cost, -np.inf), candidates.view, len(problem.views)
    )
    return chosen, choice, gap[choice] < _AGREES


def _same_node_pairs(node: Ints) -> tuple[Ints, Ints]:
    """All ordered pairs of rows with one node."""
    order = np.argsort(node, kind="stable")
    _, starts, counts = np.unique(node[order], return_index=True, return_counts=True)
    left, right = [], []
    for size in np.unique(counts):
        a, b = np.nonzero(~np.eye(size, dtype=bool))
        of_size = starts[counts == size][:, None]
        left.append(order[(of_size + a).ravel()])
        right.append(order[(of_size + b).ravel()])
    return (np.concatenate(left), np.concatenate(right)) if left else (np.zeros(0, int), np.zeros(0, int))


def _distance_rows(poses: Pose, rotation: Floats, translation: Floats, left: Ints, right: Ints) -> Floats:
    trace = np.einsum("kij,kij->k", poses.rotation[left], poses.rotation[right])
    angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    gap = np.linalg.norm(poses.translation[left] - poses.translation[right], axis=-1)
    return np.sqrt(
        angle**2 / (rotation[left] ** 2 + rotation[right] ** 2)
        + gap**2 / (translation[left] ** 2 + translation[right] ** 2)
    )


def _best_by_key(score: Floats, key: Ints, total: int) -> Ints:
    """Row of the highest score for each key 0 .. total-1; the first of equals."""
    order = np.lexsort((np.arange(len(key)), -score, key))
    keys, starts = np.unique(key[order], return_index=True)
    best = np.zeros(total, int)
    best[keys] = order[starts]
    return best
