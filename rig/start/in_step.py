"""Whether cameras saw a moving rectangle at the same instants at all, or were recorded one after another.

Videos that all begin at zero, and folders whose pictures are numbered, look as if they belonged together. Where they
do not, what one camera saw of a rectangle fits what another saw at that instant no better than what it saw at any
other.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from quadrig.rig.problem.build import Problem, build_problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.problem.connectivity import components, connected_groups
from quadrig.rig.start.lenses_and_poses import Candidates, first_cameras
from quadrig.rig.start.relative_poses import disagreement, sigmas
from quadrig.single.arrays import Floats, Ints
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# Fewer instants than this fit one another by chance, rightly or wrongly.
_FEWEST = 3
# Relative poses that differ by less than this many of their sigmas agree, whatever chance would have said.
_AGREES = 4.0
# Clocks that are off, and a sheet that bends, leave relative poses nearer to one another than this share of what
# instants that have nothing to do with one another give.
_BY_CHANCE = 0.5
# Other instants that each is held against, as shares of the recording.
_SHIFTS = (0.2, 0.35, 0.5, 0.65, 0.8)


def groups_in_step(problem: Problem, candidates: Candidates) -> list[list[int]]:
    """Cameras (indices) that a rectangle which stands still, or one that they saw move alike, joins directly or
    through others; the largest group first."""
    best = np.unique(candidates.view, return_index=True)[1]
    moving = np.array([node.frameset >= 0 for node in problem.nodes], bool)
    seen = [_first_views(problem, camera) for camera in range(len(problem.cameras))]
    bodies = [problem.node[problem.camera == camera] for camera in range(len(problem.cameras))]
    joined: list[tuple[int, int]] = []
    unproven: list[tuple[int, int]] = []
    refuted = False
    for left, right in combinations(range(len(problem.cameras)), 2):
        nodes = np.intersect1d(bodies[left], bodies[right])
        own = np.array(sorted(seen[left].keys() & seen[right].keys()), int)
        if not moving[nodes].all():
            joined.append((left, right))
        elif len(nodes) and len(own) < _FEWEST:
            # Other rectangles of one body say nothing before it is known how they stand to each other.
            unproven.append((left, right))
        elif len(own) and _alike(candidates, best, own, seen[left], seen[right]):
            joined.append((left, right))
        else:
            refuted |= len(own) > 0
    # Where stamps are known to mislead, an instant or two that cameras seem to share are no evidence.
    joined += [] if refuted else unproven
    item = np.array(joined, int).reshape(-1)
    return connected_groups(len(problem.cameras), item, np.repeat(np.arange(len(joined)), 2))


def cameras_in_step(
    cameras: Sequence[CameraInput], rectangles: Sequence[Rectangle], views: Sequence[View]
) -> list[set[str]]:
    """The names of the cameras that saw anything, grouped by `groups_in_step` where it finds that two of them share
    moving rectangles out of all step; all in one group where not."""
    seeing = {view.camera for view in views}
    problem = build_problem([camera for camera in cameras if camera.name in seeing], rectangles, views)
    names = [camera.name for camera in problem.cameras]
    sharing = components(problem)
    try:
        found = groups_in_step(problem, first_cameras(problem).candidates) if len(sharing) < len(names) else sharing
    except np.linalg.LinAlgError:
        found = sharing
    return [set(names)] if len(found) <= len(sharing) else [{names[i] for i in group} for group in found]


def _first_views(problem: Problem, camera: int) -> dict[int, int]:
    """A View (index) of each rectangle at each node that the camera saw."""
    own = np.flatnonzero(problem.camera == camera)
    what = problem.node[own] * len(problem.rectangles) + problem.rectangle[own]
    return dict(zip(what.tolist(), own.tolist(), strict=True))


def _alike(candidates: Candidates, best: Ints, nodes: Ints, left: dict[int, int], right: dict[int, int]) -> bool:
    """Whether two cameras agree on the nodes more than they would on other instants of the same rectangles."""
    rows, others = (best[np.array([views[n] for n in nodes.tolist()])] for views in (left, right))
    seen = _spread(candidates, rows, others)
    by_chance = min(_spread(candidates, rows, np.roll(others, round(share * len(nodes)))) for share in _SHIFTS)
    return seen < _AGREES or seen < _BY_CHANCE * by_chance


def _spread(candidates: Candidates, left: Ints, right: Ints) -> float:
    """How far apart (sigmas, in the middle) the relative poses lie that these rows of two cameras give."""
    poses = candidates.camera_from_rect[left] @ candidates.camera_from_rect[right].inverse()
    rotation, translation = sigmas(candidates)
    distance = np.linalg.norm(candidates.camera_from_rect.translation[left], axis=-1)
    turned = np.hypot(rotation[left], rotation[right])
    moved = np.sqrt(translation[left] ** 2 + translation[right] ** 2 + (distance * rotation[right]) ** 2)
    return _middle(poses, turned, moved)


def _middle(poses: Pose, rotation: Floats, translation: Floats) -> float:
    """Median distance, in common sigmas, of the poses from the one that is nearest to all."""
    apart = disagreement(poses, poses, rotation, translation, rotation, translation)
    return float(np.median(apart, axis=1).min())
