"""The likeliest of all poses of one thing that candidates of Views have, by the vote of all."""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.problem.build import Problem
from quadrig.rig.start.lenses_and_poses import Candidates
from quadrig.rig.start.relative_poses import AGREES
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.pose import Pose


@dataclass(frozen=True, eq=False)
class SeenPoses:
    """Poses (K,) in one frame by each candidate of a View: key (K,): of what; rotation, translation (K,): sigmas;
    usable (K,): which count."""

    key: Ints
    pose: Pose
    rotation: Floats
    translation: Floats
    usable: Mask


def likeliest(problem: Problem, candidates: Candidates, seen: SeenPoses, total: int) -> Ints:
    """The row of the candidate that most others agree with, for each key 0 .. total-1."""
    camera = problem.camera[candidates.view]
    left, right = _same_key_pairs(seen.key)
    apart = distance_rows(seen, left, right)
    likely = np.exp(-0.5 * apart**2 - 0.25 * candidates.cost[right])
    agree = np.where((apart < AGREES) & seen.usable[left] & seen.usable[right], likely, 0.0)
    # Each other View supports a candidate once, with the likeliest of its own candidates.
    key = left * len(problem.views) + candidates.view[right]
    order = np.argsort(key, kind="stable")
    keys, starts = np.unique(key[order], return_index=True)
    largest = np.maximum.reduceat(agree[order], starts) if len(starts) else np.zeros(0)
    row, view = np.divmod(keys, len(problem.views))
    own = problem.camera[view] == camera[row]
    other_cameras = np.bincount(row[~own], largest[~own], len(camera))
    same_camera = np.bincount(row[own], largest[own], len(camera))
    # A camera sees the same twin again and again: all its other Views together say less than one of another camera.
    support = other_cameras + 0.5 * same_camera / (1 + same_camera)
    score = support - 1e-3 * candidates.cost - 1e-3 * np.minimum(seen.rotation, 100.0)
    return best_by_key(np.where(seen.usable, score, -np.inf), seen.key, total)


def distance_rows(seen: SeenPoses, left: Ints, right: Ints) -> Floats:
    """How far apart, in their common sigmas, rows of poses lie from others."""
    poses, rotation, translation = seen.pose, seen.rotation, seen.translation
    trace = np.einsum("kij,kij->k", poses.rotation[left], poses.rotation[right])
    angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    gap = np.linalg.norm(poses.translation[left] - poses.translation[right], axis=-1)
    return np.sqrt(
        angle**2 / (rotation[left] ** 2 + rotation[right] ** 2)
        + gap**2 / (translation[left] ** 2 + translation[right] ** 2)
    )


def _same_key_pairs(key: Ints) -> tuple[Ints, Ints]:
    """All ordered pairs of rows with one key."""
    order = np.argsort(key, kind="stable")
    _, starts, counts = np.unique(key[order], return_index=True, return_counts=True)
    left, right = [], []
    for size in np.unique(counts):
        a, b = np.nonzero(~np.eye(size, dtype=bool))
        of_size = starts[counts == size][:, None]
        left.append(order[(of_size + a).ravel()])
        right.append(order[(of_size + b).ravel()])
    return (np.concatenate(left), np.concatenate(right)) if left else (np.zeros(0, int), np.zeros(0, int))


def best_by_key(score: Floats, key: Ints, total: int) -> Ints:
    """Row of the highest score for each key 0 .. total-1; the first of equals."""
    order = np.lexsort((np.arange(len(key)), -score, key))
    keys, starts = np.unique(key[order], return_index=True)
    best = np.zeros(total, int)
    best[keys] = order[starts]
    return best
