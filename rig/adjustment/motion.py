"""Clocks that do not agree: where a moving body was when a camera really took its picture.

Between framesets the motion is interpolated through the body's poses before, at and after. A View taken at
another instant than its frameset's sees the body displaced along that motion, by the lag of its stamp, which is
known, and by the offset of its camera's clock, which the joint adjustment estimates like any other parameter.
"""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.connectivity import components
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.pose import Pose

# Framesets further apart than this (s) say little of the motion between them: a hand turns around in half a second.
LONGEST_GAP = 0.25
# The offset of a camera is determined by Views of at least this many framesets in motion.
_FEWEST_VIEWS = 6


@dataclass(frozen=True, eq=False)
class Motion:
    """How the body of each View moves: tau seconds after its frameset it stands at the step
    tau * rate + tau^2 * bend, (V, 6) in the rig frame, from its node's pose.

    lag (V,) s: by how much later than its frameset the View was stamped; rate and bend are zero where not known.
    observable (C,) bool: cameras whose offset the motion determines. free (C,) bool: those whose offset is estimated:
    of cameras that share moving bodies one holds the clock, since only differences of offsets are observable.
    """

    rate: Floats
    bend: Floats
    lag: Floats
    observable: Mask
    free: Mask

    def step(self, offset: Floats) -> Floats:
        """Steps (V, 6) from the nodes' poses for the clock offsets (V,) s of the Views' cameras."""
        tau = (self.lag + offset)[:, None]
        return tau * self.rate + tau**2 * self.bend

    def slope(self, offset: Floats) -> Floats:
        """Derivative (V, 6) of the step by the offset."""
        return self.rate + 2 * (self.lag + offset)[:, None] * self.bend


def motion(problem: Problem, rig_from_body: Pose, offsets: Floats) -> Motion | None:
    """The motion of the body of every View, from the poses of its neighbours in time; None where none is known.

    offsets (C,) s: of the clocks. A pose is the body's at the mean of when its Views were truly taken, so that
    motion carries none of them farther than need be.
    """
    stamp = np.array([view.time for view in problem.views])
    time = stamp + offsets[problem.camera]
    stamped = np.isfinite(time)
    count = np.bincount(problem.node, stamped, len(problem.nodes))
    with np.errstate(invalid="ignore", divide="ignore"):
        total = np.bincount(problem.node, np.where(stamped, time, 0.0), len(problem.nodes))
        # What one camera alone saw may be its mirrored twin, and would mislead its neighbours.
        node_time = np.where(count > 1, total / count, np.nan)
    rows = _neighbours(problem, node_time)
    if not len(rows):
        return None
    node, one, other = rows.T
    here = rig_from_body[node]
    to_one, to_other = (node_time[one] - node_time[node])[:, None], (node_time[other] - node_time[node])[:, None]
    step_one, step_other = here.step_to(rig_from_body[one]), here.step_to(rig_from_body[other])
    rate, bend = np.zeros((len(problem.nodes), 6)), np.zeros((len(problem.nodes), 6))
    # The parabola through both neighbours and the pose itself.
    bend[node] = (step_other / to_other - step_one / to_one) / (to_other - to_one)
    rate[node] = step_other / to_other - bend[node] * to_other
    known = np.isin(problem.node, node) & stamped
    observable = np.bincount(problem.camera[known], minlength=len(problem.cameras)) >= _FEWEST_VIEWS
    free = observable.copy()
    for group in components(problem, np.flatnonzero(known & observable[problem.camera])):
        free[group[0]] = False
    return Motion(
        np.where(known[:, None], rate[problem.node], 0.0),
        np.where(known[:, None], bend[problem.node], 0.0),
        np.where(known, stamp - node_time[problem.node], 0.0),
        observable,
        free,
    )


def _neighbours(problem: Problem, node_time: Floats) -> Ints:
    """Nodes (R, 3) of one moving body, each with its two nearest in time: before and after it, but at the ends
    of a run of framesets both on one side."""
    by_body: dict[str, list[int]] = {}
    for index, node in enumerate(problem.nodes):
        if node.frameset >= 0 and np.isfinite(node_time[index]):
            by_body.setdefault(node.body, []).append(index)
    rows: dict[int, tuple[int, int, int]] = {}
    for nodes in by_body.values():
        ordered = sorted(nodes, key=lambda n: node_time[n])
        for before, node, after in zip(ordered, ordered[1:], ordered[2:], strict=False):
            gaps = node_time[node] - node_time[before], node_time[after] - node_time[node]
            if min(gaps) > 0 and max(gaps) < LONGEST_GAP:
                rows[node] = node, before, after
                rows.setdefault(before, (before, node, after))
                rows[after] = after, before, node
    return np.array(list(rows.values()), int).reshape(-1, 3)
