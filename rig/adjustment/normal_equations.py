"""The Gram matrices of all Views, and the system over cameras that remains when rectangle poses are eliminated.

A View depends on the lens of its camera and on camera_from_rect alone. So each View is first reduced to one small
Gram matrix over [lens, step of camera_from_rect, residual]; Eq. 50's chain camera_from_rect =
camera_from_rig @ rig_from_rect then spreads it over the two poses. Each View touches one rectangle pose, so that
their part of the normal matrix is 6x6 blocks, eliminated in one batch (Schur complement).
"""

from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.adjustment.motion import Motion
from quadrig.rig.adjustment.twist_jacobians import step_by_inner_twist
from quadrig.rig.problem.observations import ObservationGroup, Observations
from quadrig.single.arrays import Floats, Ints
from quadrig.single.lens import LENS_PARAMETERS, fill_projection_rows, project
from quadrig.single.pose import Pose

LENS = len(LENS_PARAMETERS)

# Cauchy's loss at 2.385 sigma keeps 95 % of the efficiency of least squares on Gaussian noise (Rey 1983).
_CAUCHY = 2.385
# Chi-square that a point behind its camera costs: more than any point in front of it (Cauchy's loss of 300 sigma),
# and flat, so that it neither pulls nor makes the whole cost undefined.
_BEHIND_COST = 55.0
# So many points are linearised at a time: what they need fits into a processor's second-level cache.
_AT_ONCE = 8192


@dataclass(frozen=True, eq=False)
class State:
    """What is estimated: lenses (C, 9), camera_from_rig a batch (C,), rig_from_rect a batch (N,) over the nodes.

    slack (V, 6): the step by which each View strays from the chain, where cameras are out of step; None for none.
    motion and offsets (C,) s: how moving rectangles move between framesets, and by how much each camera's clock is
    off; None where clocks are taken to agree.
    """

    lens: Floats
    camera_from_rig: Pose
    rig_from_rect: Pose
    slack: Floats | None = None
    motion: Motion | None = None
    offsets: Floats | None = None

    def moved(self, lens: Floats, cameras: Floats, nodes: Floats) -> "State":
        """After steps of the lenses (C, 9) and twists in the rig frame of cameras (C, 6) and nodes (N, 6)."""
        step, count = Pose.from_twist(np.concatenate([cameras, nodes])), len(cameras)
        return replace(
            self,
            lens=self.lens + lens,
            camera_from_rig=self.camera_from_rig @ step[:count],
            rig_from_rect=step[count:] @ self.rig_from_rect,
        )

    def rig_from_seen(self, observations: Observations) -> Pose:
        """Where each View's rectangle stood when the View was taken: a batch (V,)."""
        pose = self.rig_from_rect[observations.node]
        if self.motion is None or self.offsets is None:
            return pose
        return pose.retract(self.motion.step(self.offsets[observations.camera]))

    def camera_from_rect(self, observations: Observations) -> Pose:
        """Eq. 50 for every View, with its slack: a batch (V,)."""
        chained = self.camera_from_rig[observations.camera] @ self.rig_from_seen(observations)
        return chained if self.slack is None else chained.retract(self.slack)


@dataclass(frozen=True, eq=False)
class Linearised:
    """All Views at a state. gram (V, K+7, K+7) over [lens columns, step of camera_from_rect, residual].

    cost: sum of the loss, in units of chi-square. squares: for each group (V, P), the squared residual in px^2.
    """

    gram: Floats
    cost: float
    squares: tuple[Floats, ...]


def linearise(
    observations: Observations, state: State, columns: Ints, noise: float, *, robust: bool = False
) -> Linearised:
    """Gram matrices at a state, with weights of 1/noise^2 and, where robust, of Cauchy's loss.

    columns (K,): which lens parameters take part.
    """
    chained = state.camera_from_rect(observations)
    gram = np.zeros((len(observations.camera), len(columns) + 7, len(columns) + 7))
    cost, squares = 0.0, []
    for group in observations.groups:
        seen = []
        for part in group.parts(_AT_ONCE):
            gram[part.view], square, own = _gram(part, state, chained, columns, noise, robust)
            seen.append(square)
            cost += own
        squares.append(seen[0] if len(seen) == 1 else np.concatenate(seen))
    return Linearised(gram, cost, tuple(squares))


def _gram(
    group: ObservationGroup, state: State, chained: Pose, columns: Ints, noise: float, robust: bool
) -> tuple[Floats, Floats, float]:
    """Gram matrices (V, K+7, K+7), squared residuals (V, P) px^2 and cost of some Views."""
    rows, square = view_rows(group, state.lens[group.camera], chained[group.view], columns)
    weights, cost = _weighed(group, square, noise, robust)
    if not np.isfinite(square.sum()):
        rows[~np.isfinite(rows)] = 0.0
    uniform = weights.min(initial=np.inf) == weights.max(initial=-np.inf)
    if not uniform:
        rows *= np.sqrt(weights)[:, None, :]
    flat = rows.reshape(len(rows), len(weights), -1).transpose(1, 0, 2)
    product = flat @ np.swapaxes(flat, -1, -2)
    return product * weights.flat[0] if uniform else product, square, cost


def residual_squares(observations: Observations, state: State) -> tuple[Floats, ...]:
    """For each group (V, P) the squared residual in px^2, as `linearise` has it."""
    chained, squares = state.camera_from_rect(observations), []
    for group in observations.groups:
        pose = chained[group.view]
        located = group.points @ np.swapaxes(pose.rotation, -1, -2) + pose.translation[:, None]
        with np.errstate(invalid="ignore"):
            seen = project(state.lens[group.camera][:, None], located, group.model)
        squares.append(((group.pixels - seen) ** 2).sum(axis=-1))
    return tuple(squares)


def _weighed(group: ObservationGroup, square: Floats, noise: float, robust: bool) -> tuple[Floats, float]:
    """Weights (V, P) of the squared residuals and their cost in units of chi-square."""
    weights = group.weights / noise**2
    behind = ~np.isfinite(square)
    lost = behind.any()
    scaled = np.where(behind, 0.0, square) * weights if lost else square * weights
    if robust:
        cost = _CAUCHY**2 * float(np.log1p(scaled / _CAUCHY**2).sum())
        weights = weights / (1 + scaled / _CAUCHY**2)
    else:
        cost = float(scaled.sum())
    if lost:
        cost += _BEHIND_COST * float((behind & (group.weights > 0)).sum())
        weights = np.where(behind, 0.0, weights)
    return weights, cost


def view_rows(group: ObservationGroup, lens: Floats, camera_from_rect: Pose, columns: Ints) -> tuple[Floats, Floats]:
    """Rows (K + 7, V, 2, P) of derivatives by lens (V, 9) and step of camera_from_rect (V,), and of the residual; and
    squared residuals (V, P) px^2. Unweighted; not finite where a point is behind its camera."""
    count, size = group.weights.shape
    turned = (camera_from_rect.rotation @ np.swapaxes(group.points, -1, -2)).transpose(1, 0, 2).copy()
    located = turned + camera_from_rect.translation.T[:, :, None]
    wanted = len(columns)
    rows = np.zeros((wanted + 7, count, 2, size))
    by_lens: list[Floats | None] = [None] * LENS
    for place, column in enumerate(columns):
        by_lens[column] = rows[place].swapaxes(0, 1)
    by_point = rows[wanted + 3 : wanted + 6].swapaxes(1, 2)
    pixels = fill_projection_rows(lens.T[:, :, None], located, by_lens, by_point, group.model)
    for axis in range(3):
        # The step turns q = R p by omega x q; its product with the derivative by the point is omega . (q x g).
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for side in range(2):
            across = turned[a] * by_point[b, side]
            across -= turned[b] * by_point[a, side]
            rows[wanted + axis, :, side] = across
    residual = rows[-1].swapaxes(0, 1)
    square = np.zeros((count, size))
    for side in range(2):
        left_over = group.pixels[..., side] - pixels[side]
        residual[side] = left_over
        square += left_over * left_over
    return rows, square


@dataclass(frozen=True, eq=False)
class Layout:
    """Who meets whom, worked out once for a set of Views.

    A pair is a (node, camera) that share Views; a meeting is two pairs of one node, hence two cameras that the
    node ties together; a block is where the meetings of two cameras are summed, on the diagonal where they are one.
    Sums over equal keys run along sorted orders (np.add.reduceat).
    """

    view_by_camera: "_Sum"
    view_by_node: "_Sum"
    view_by_pair: "_Sum"
    pair_node: Ints
    pair_camera: Ints
    pair_by_node: "_Sum"
    pair_by_camera: "_Sum"
    meeting_left: Ints
    meeting_right: Ints
    meeting_by_block: "_Sum"
    block_left: Ints
    block_right: Ints
    diagonal: Ints


@dataclass(frozen=True, eq=False)
class _Sum:
    """Sums rows that carry one key: result[keys] = sum of rows; `total` rows in all."""

    order: Ints
    starts: Ints
    keys: Ints
    total: int

    @staticmethod
    def over(key: Ints, total: int | None = None) -> "_Sum":
        order = np.argsort(key, kind="stable")
        ordered = key[order]
        starts = np.flatnonzero(np.diff(ordered, prepend=-1))
        keys = ordered[starts]
        return _Sum(order, starts, keys, len(keys) if total is None else total)

    def __call__(self, rows: Floats) -> Floats:
        ordered = rows[self.order]
        # Where no two rows share a key there is nothing to add.
        alone = len(self.starts) == len(self.order)
        sums = ordered if alone else np.add.reduceat(ordered, self.starts, axis=0)
        if len(self.keys) == self.total:
            return sums
        result = np.zeros((self.total, *rows.shape[1:]))
        result[self.keys] = sums
        return result


def layout(observations: Observations) -> Layout:
    """Work out the sums of a set of Views."""
    camera, node = observations.camera, observations.node
    pair_key = node * observations.cameras + camera
    by_pair = _Sum.over(pair_key)
    pairs = by_pair.keys
    pair_keys = _Sum(by_pair.order, by_pair.starts, np.arange(len(pairs)), len(pairs))
    pair_node, pair_camera = pairs // observations.cameras, pairs % observations.cameras
    left, right = _meetings(pair_node)
    blocks = _Sum.over(pair_camera[left] * observations.cameras + pair_camera[right])
    block = np.divmod(blocks.keys, observations.cameras)
    return Layout(
        _Sum.over(camera, observations.cameras),
        _Sum.over(node, observations.nodes),
        pair_keys,
        pair_node,
        pair_camera,
        _Sum.over(pair_node, observations.nodes),
        _Sum.over(pair_camera, observations.cameras),
        left,
        right,
        _Sum(blocks.order, blocks.starts, np.arange(len(blocks.keys)), len(blocks.keys)),
        *block,
        np.flatnonzero(block[0] == block[1]),
    )


def _meetings(pair_node: Ints) -> tuple[Ints, Ints]:
    """All (left <= right) of positions in the sorted pair_node that carry the same node."""
    _, starts, counts = np.unique(pair_node, return_index=True, return_counts=True)
    left, right = [], []
    for size in np.unique(counts):
        upper_left, upper_right = np.triu_indices(size)
        of_size = starts[counts == size][:, None]
        left.append((of_size + upper_left).ravel())
        right.append((of_size + upper_right).ravel())
    return (np.concatenate(left), np.concatenate(right)) if left else (np.zeros(0, int), np.zeros(0, int))


@dataclass(frozen=True, eq=False)
class Normal:
    """The normal equations by blocks: cameras (C, M, M), nodes (N, 6, 6), pairs (Q, M, 6) between them.

    M = K + 6: the lens columns, then the camera's twist in the rig frame; one more, the offset, where clocks are
    estimated. Gradients point down the cost.
    """

    cameras: Floats
    camera_gradient: Floats
    nodes: Floats
    node_gradient: Floats
    pairs: Floats


def chain_derivatives(observations: Observations, state: State) -> tuple[Floats, Floats]:
    """Derivatives of the step of camera_from_rect: by its camera's twist, and clock where one is estimated,
    (V, 6, 6 or 7), and by its node's twist (V, 6, 6).

    Cameras and rectangles are moved by twists in the rig frame: camera_from_rig @ exp(twist), exp(twist) @
    rig_from_rect. A cluster of both that turns about a far point so follows its arc, and the twist of a camera is
    worth the same as that of the rectangles it sees.
    """
    rotation = state.camera_from_rig.rotation[observations.camera]
    by_twist = step_by_inner_twist(rotation, state.rig_from_seen(observations).translation)
    if state.motion is None or state.offsets is None:
        return by_twist, by_twist
    slope = state.motion.slope(state.offsets[observations.camera])
    parts = [(rotation @ part[..., None])[..., 0] for part in (slope[:, :3], slope[:, 3:])]
    by_offset = np.concatenate(parts, axis=1)
    return np.concatenate([by_twist, by_offset[..., None]], axis=-1), by_twist


def normal_equations(observations: Observations, layout: Layout, state: State, gram: Floats) -> Normal:
    """Spread the Gram matrices over camera and rectangle poses by the chain of Eq. 50."""
    lens = gram.shape[-1] - 7
    by_camera, _ = chain_derivatives(observations, state)
    size = lens + by_camera.shape[-1]
    # By the camera's unknowns and the residual; a node's twist moves the View as its camera's does.
    by_unknown = np.zeros((len(gram), lens + 7, size + 1))
    by_unknown[:, range(lens), range(lens)] = 1.0
    by_unknown[:, lens : lens + 6, lens:size] = by_camera
    by_unknown[:, -1, -1] = 1.0
    spread = np.swapaxes(by_unknown, -1, -2) @ gram @ by_unknown
    cameras = layout.view_by_camera(spread[:, :size])
    node = [*range(lens, lens + 6), size]
    nodes = layout.view_by_node(spread[:, lens : lens + 6, node])
    pairs = layout.view_by_pair(spread[:, :size, lens : lens + 6])
    return Normal(cameras[:, :, :-1], cameras[:, :, -1], nodes[:, :, :-1], nodes[:, :, -1], pairs)
