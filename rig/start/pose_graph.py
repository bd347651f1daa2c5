"""The pose graph: cameras, bodies and the rectangles on them, joined by Views.

Relative poses of two cameras come from everything that both see, of two rectangles from every camera that sees both;
all readings and twins vote, the largest agreement wins, and the paths of least uncertainty chain Eq. 50 into the rig
frame (together.py, relative_poses.py).
"""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.problem.build import Problem
from quadrig.rig.start.lenses_and_poses import Candidates
from quadrig.rig.start.relative_poses import AGREES
from quadrig.rig.start.together import Together, camera_from_cluster, seen_together
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.pose import Pose


@dataclass(frozen=True, eq=False)
class FirstRig:
    """Poses to start the joint adjustment from.

    camera_from_rig (C,): identity for cameras that are not connected; connected (C,) bool. rig_from_body (N,).
    body_from_rect (L,) of the problem's layouts; together: what ties cameras and rectangles.
    reading (V,): of each View; agrees (V,) bool: False where no candidate of the View fits the others.
    """

    camera_from_rig: Pose
    connected: Mask
    rig_from_body: Pose
    body_from_rect: Pose
    together: Together
    reading: Ints
    agrees: Mask


def first_rig(problem: Problem, candidates: Candidates, reference: int) -> FirstRig:
    """Poses of all that is connected to the reference camera, in its frame."""
    together = seen_together(problem, candidates, reference)
    connected = together.cameras.group == reference
    camera_from_rig = together.cameras.item_from_group[np.where(connected, np.arange(len(connected)), reference)]
    names = {name: row for row, name in enumerate(problem.rectangles)}
    on_bodies = np.array([names[name] for name in problem.layouts.names], int)
    body_from_rect = together.rectangles.item_from_group[on_bodies].inverse()
    rig_from_body, choice, agrees = _place_nodes(problem, candidates, camera_from_rig, connected, together)
    reading = candidates.reading[choice]
    return FirstRig(camera_from_rig, connected, rig_from_body, body_from_rect, together, reading, agrees)


def _place_nodes(
    problem: Problem, candidates: Candidates, camera_from_rig: Pose, connected: Mask, together: Together
) -> tuple[Pose, Ints, Mask]:
    """rig_from_body (N,), the candidate chosen of every View (V,), and whether it agrees with its node (V,)."""
    node, camera = problem.node[candidates.view], problem.camera[candidates.view]
    pose, rotation, translation = camera_from_cluster(problem, candidates, together.rectangles)
    rig_from_body = camera_from_rig[camera].inverse() @ pose
    usable = connected[camera] & in_frame(problem, together)[problem.rectangle[candidates.view]]
    left, right = _same_node_pairs(node)
    apart = _distance_rows(rig_from_body, rotation, translation, left, right)
    likely = np.exp(-0.5 * apart**2 - 0.25 * candidates.cost[right])
    agree = np.where((apart < AGREES) & usable[left] & usable[right], likely, 0.0)
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
    chosen = rig_from_body[best]
    gap = _distance_rows(rig_from_body, rotation, translation, np.arange(len(node)), best[node])
    choice = _best_by_key(
        np.where(usable, -gap - 1e-6 * candidates.cost, -np.inf), candidates.view, len(problem.views)
    )
    return chosen, choice, gap[choice] < AGREES


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


def in_frame(problem: Problem, together: Together) -> Mask:
    """Which rectangles (R,) are tied to the frame of their body."""
    given = np.array([rectangle.body_from_rect is not None for rectangle in problem.rectangles.values()])
    is_frame = (problem.layouts.number < 0) | given
    return is_frame[together.rectangles.group]


def loose_rectangles(problem: Problem, together: Together) -> dict[str, str]:
    """The rectangles that were seen, but that nothing ties to the frame of their body, each with a name for the body
    that it makes with those tied to it."""
    tied, names = in_frame(problem, together), list(problem.rectangles)
    root = together.rectangles.group
    return {
        names[row]: f"{problem.rectangles[names[row]].body} ({names[root[row]]})"
        for row in np.unique(problem.rectangle)
        if not tied[row]
    }
