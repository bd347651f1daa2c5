"""Clocks that do not agree and shutters that roll: where a moving body was when a camera really saw it.

Between framesets the motion is interpolated through the body's poses before, at and after. A corner seen at another
instant than its frameset's is displaced along that motion: by the lag of its View's stamp, which is known, by the
offset of its camera's clock, and by the line time, from one row of a picture to the next, for every row that it lies
below the middle one. So the middle row is the one whose instant a stamp and an offset stand for: about any other,
offset and line time would be all but the same. The joint adjustment estimates both like any other parameter.
"""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.problem.build import Problem
from quadrig.rig.problem.connectivity import components
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.pose import Pose

# Framesets further apart than this (s) say little of the motion between them: a hand turns around in half a second.
LONGEST_GAP = 0.25
# A curve of the fourth order follows who walks, of ten poses a second, where a parabola is 1 % too slow; more poses
# than it needs, of cameras that are quicker, halve its noise.
_ORDER, _MOST_ASIDE = 4, 4
# The offset of a camera is determined by Views of at least this many framesets in motion.
_FEWEST_VIEWS = 6
# A camera's clock and shutter: its offset, s, and its line time, s a row.
CLOCK = 2
# What is known of both beforehand, 1/s^2, about zero. Clocks are known to a second: that holds their common offset,
# which nothing else does. Shutters read out a picture in nothing (all rows at once) up to 50 us a row, the slowest of
# webcams: two sigmas, so that the prior hardly draws on a camera that moves, and about zero, so that where nothing
# moves no picture is bent; pictures that are stored upside down are read out from below, by less than zero.
CLOCK_INFORMATION = np.array([1.0, 1 / 25e-6**2])


@dataclass(frozen=True, eq=False)
class Motion:
    """How the body of each View moves: tau seconds after its frameset it stands at the step
    tau * rate + tau^2 * bend, (V, 6) in the rig frame, from its node's pose.

    lag (V,) s: by how much later than its frameset the View was stamped; rate and bend are zero where not known.
    row (V,): the mean of the rows that the View's corners lie in, and middle (V,) the middle one of its picture.
    observable (C,) bool: cameras whose clock the motion determines. free (C, 2) bool: whose offset, and whose line
    time, are estimated: of cameras that share moving bodies one holds the clock, since only differences of offsets
    are observable.
    """

    rate: Floats
    bend: Floats
    lag: Floats
    row: Floats
    middle: Floats
    observable: Mask
    free: Mask

    @property
    def by_clock(self) -> Floats:
        """Derivative (V, 2) of when a View was taken by its camera's offset and line time."""
        return np.stack([np.ones_like(self.row), self.row - self.middle], axis=1)

    def late(self, clocks: Floats) -> Floats:
        """By how much later than its frameset each View was taken (V,) s, with the clocks (V, 2) of their cameras."""
        return self.lag + (self.by_clock * clocks).sum(axis=1)

    def step(self, clocks: Floats) -> Floats:
        """Steps (V, 6) from the nodes' poses with the clocks (V, 2) of the Views' cameras."""
        tau = self.late(clocks)[:, None]
        return tau * self.rate + tau**2 * self.bend

    def slope(self, clocks: Floats) -> Floats:
        """Derivative (V, 6) of the step by time."""
        return self.rate + 2 * self.late(clocks)[:, None] * self.bend


def motion(problem: Problem, rig_from_body: Pose, clocks: Floats) -> Motion | None:
    """The motion of the body of every View, from the poses of its neighbours in time; None where none is known.

    clocks (C, 2): of the cameras. A pose is the body's at the mean of when its Views were truly taken, so that motion
    carries none of them farther than need be.
    """
    stamp, row = problem.times, problem.mean_rows
    middle = np.array([(camera.height - 1) / 2 for camera in problem.cameras])[problem.camera]
    time = stamp + clocks[problem.camera, 0] + clocks[problem.camera, 1] * (row - middle)
    stamped = np.isfinite(time)
    count = np.bincount(problem.node, stamped, len(problem.nodes))
    with np.errstate(invalid="ignore", divide="ignore"):
        total = np.bincount(problem.node, np.where(stamped, time, 0.0), len(problem.nodes))
        # What one camera alone saw may be its mirrored twin, and would mislead its neighbours.
        node_time = np.where(count > 1, total / count, np.nan)
    rate, bend = np.zeros((len(problem.nodes), 6)), np.zeros((len(problem.nodes), 6))
    moves = np.zeros(len(problem.nodes), bool)
    for rows in _neighbours(problem, node_time):
        node, others = rows[:, 0], rows[:, 1:]
        here, there = rig_from_body[np.repeat(node, others.shape[1])], rig_from_body[others.ravel()]
        steps = here.step_to(there).reshape(*others.shape, 6)
        rate[node], bend[node] = _through(node_time[others] - node_time[node][:, None], steps)
        moves[node] = True
    if not moves.any():
        return None
    known = moves[problem.node] & stamped
    observable = np.bincount(problem.camera[known], minlength=len(problem.cameras)) >= _FEWEST_VIEWS
    estimated = np.array([camera.line_time is None for camera in problem.cameras])
    free = np.stack([observable, observable & estimated], axis=1)
    for group in components(problem, np.flatnonzero(known & observable[problem.camera])):
        free[group[0], 0] = False
    return Motion(
        np.where(known[:, None], rate[problem.node], 0.0),
        np.where(known[:, None], bend[problem.node], 0.0),
        np.where(known, stamp - node_time[problem.node], 0.0),
        row,
        middle,
        observable,
        free,
    )


def _neighbours(problem: Problem, node_time: Floats) -> list[Ints]:
    """Nodes (R, 1 + K) of one moving body, each with K others near to it in time: as many before as after it, but at
    the ends of a run of framesets two on one side."""
    body = np.unique([node.body for node in problem.nodes], return_inverse=True)[1]
    usable = np.array([node.frameset >= 0 for node in problem.nodes]) & np.isfinite(node_time)
    found: dict[tuple[int, ...], list[Ints]] = {}
    for one in np.unique(body[usable]):
        nodes = np.flatnonzero(usable & (body == one))
        nodes = nodes[np.argsort(node_time[nodes], kind="stable")]
        for way, rows in _ways(node_time[nodes]).items():
            found.setdefault(way, []).append(nodes[rows[:, None] + (0, *way)])
    return [np.concatenate(rows) for rows in found.values()]


def _ways(time: Floats) -> dict[tuple[int, ...], Ints]:
    """Rows of rising times (N,), by where the others are that tell of the motion there, counted from their own."""
    count, gaps = len(time), np.diff(time)
    close = np.concatenate([[False] * 2, (gaps > 0) & (gaps < LONGEST_GAP), [False] * 2])
    # By place: a gap before the time of that number, with two more that are none at both ends.
    before, after = close[1 : count + 1], close[2 : count + 2]
    sides = (before & after).astype(int)
    for side in range(2, _MOST_ASIDE + 1):
        row = np.flatnonzero(sides == side - 1)
        row = row[(row >= side) & (row < count - side)]
        reach = np.maximum(time[row + side] - time[row], time[row] - time[row - side])
        whole = close[row - side + 2] & close[row + side + 1] & (reach < LONGEST_GAP)
        sides[row[whole]] = side
    ways = {(*range(-side, 0), *range(1, side + 1)): sides == side for side in range(1, _MOST_ASIDE + 1)}
    ways[1, 2] = (sides == 0) & after & close[3 : count + 3]
    ways[-1, -2] = (sides == 0) & before & close[:count] & ~ways[1, 2]
    return {way: np.flatnonzero(chosen) for way, chosen in ways.items() if chosen.any()}


def _through(times: Floats, steps: Floats) -> tuple[Floats, Floats]:
    """Rate and bend (R, 6) of the smoothest curves, of the fourth order where there are enough, through zero and near
    to steps (R, K, 6) at times (R, K) s."""
    scale = np.abs(times).max(axis=1)[:, None]
    powers = (times / scale)[..., None] ** np.arange(1, min(times.shape[1], _ORDER) + 1)
    found = np.linalg.pinv(powers) @ steps
    return found[:, 0] / scale, found[:, 1] / scale**2
