"""The Gram matrices of all Views, and the normal equations that they are spread to.

A View depends on the lens of its camera, on its line time where things move, and on camera_from_rect alone. So each
View is first reduced to one small Gram matrix over [lens, line time, step of camera_from_rect, residual]; Eq. 50's
chain (state.py) then spreads it over the poses.
Each View touches one pose of a body, so that their part of the normal matrix is 6x6 blocks, eliminated in one batch
(Schur complement).
"""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.adjustment.state import Readout, State, chain_derivatives
from quadrig.rig.adjustment.tables import Tables
from quadrig.rig.problem.observations import ObservationGroup, Observations
from quadrig.single.arrays import Floats, Ints
from quadrig.single.lens import fill_projection_rows, project
from quadrig.single.pose import Pose

# Cauchy's loss at 2.385 sigma keeps 95 % of the efficiency of least squares on Gaussian noise (Rey 1983).
_CAUCHY = 2.385
# Chi-square that a point behind its camera costs: more than any point in front of it (Cauchy's loss of 300 sigma),
# and flat, so that it neither pulls nor makes the whole cost undefined.
_BEHIND_COST = 55.0
# So many points are linearised at a time: what they need fits into a processor's second-level cache.
_AT_ONCE = 8192


@dataclass(frozen=True, eq=False)
class Linearised:
    """All Views at a state. gram (V, K+7, K+7) over [lens columns, step of camera_from_rect, residual], or
    (V, K+8, K+8) where things move: then the line time, as it bends each View about its own row, follows the lens.

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
    chained, readout = state.camera_from_rect(observations), state.readout(observations)
    size = len(columns) + 7 + (readout is not None)
    gram = np.zeros((len(observations.camera), size, size))
    cost, squares = 0.0, []
    for group in observations.groups:
        seen = []
        for part in group.parts(_AT_ONCE):
            rows = view_rows(part, state.lens[part.camera], chained[part.view], columns, readout)
            gram[part.view], square, own = _gram(part, *rows, noise, robust)
            seen.append(square)
            cost += own
        squares.append(seen[0] if len(seen) == 1 else np.concatenate(seen))
    return Linearised(gram, cost, tuple(squares))


def _gram(
    group: ObservationGroup, rows: Floats, square: Floats, noise: float, robust: bool
) -> tuple[Floats, Floats, float]:
    """Gram matrices (V, K+7, K+7), squared residuals (V, P) px^2 and cost of some Views, of their view_rows."""
    weights, cost = weighed(group, square, noise, robust)
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
    return tuple((left_over**2).sum(axis=-1) for left_over in residuals(observations, state))


def residuals(observations: Observations, state: State) -> tuple[Floats, ...]:
    """For each group (V, P, 2) px, seen less predicted; not finite where a point is behind its camera."""
    chained, readout, result = state.camera_from_rect(observations), state.readout(observations), []
    for group in observations.groups:
        pose = chained[group.view]
        turned = group.points @ np.swapaxes(pose.rotation, -1, -2)
        if readout is not None:
            turned = readout.part(group.view).moved(turned, group.pixels)
        with np.errstate(invalid="ignore"):
            seen = project(state.lens[group.camera][:, None], turned + pose.translation[:, None], group.model)
        result.append(group.pixels - seen)
    return tuple(result)


def weighed(group: ObservationGroup, square: Floats, noise: float, robust: bool) -> tuple[Floats, float]:
    """Weights (V, P) of the squared residuals (V, P) px^2, and their cost in units of chi-square."""
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


def view_rows(
    group: ObservationGroup,
    lens: Floats,
    camera_from_rect: Pose,
    columns: Ints,
    readout: Readout | None = None,
    more: int = 0,
) -> tuple[Floats, Floats]:
    """Rows (K + 7 + more, V, 2, P) of derivatives by lens (V, 9) and step of camera_from_rect (V,), of the residual,
    and of zeros for others to fill; and squared residuals (V, P) px^2. Unweighted; not finite where a point is behind
    its camera. readout: of all Views; then the line time follows the lens (K + 8)."""
    count, size = group.weights.shape
    turned = (camera_from_rect.rotation @ np.swapaxes(group.points, -1, -2)).transpose(1, 0, 2).copy()
    own = None if readout is None else readout.part(group.view)
    if own is not None:
        turned = np.moveaxis(own.moved(np.moveaxis(turned, 0, -1), group.pixels), -1, 0).copy()
    located = turned + camera_from_rect.translation.T[:, :, None]
    wanted = len(columns) + (own is not None)
    rows = np.zeros((wanted + 7 + more, count, 2, size))
    by_lens: list[Floats | None] = [None] * lens.shape[1]
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
    if own is not None:
        by_time = np.einsum("kvsp,vk->vsp", rows[wanted : wanted + 6], own.rate)
        rows[len(columns)] = by_time * own.rows_below(group.pixels)[:, None]
    residual = rows[wanted + 6].swapaxes(0, 1)
    square = np.zeros((count, size))
    for side in range(2):
        left_over = group.pixels[..., side] - pixels[side]
        residual[side] = left_over
        square += left_over * left_over
    return rows, square


@dataclass(frozen=True, eq=False)
class Normal:
    """The normal equations by blocks: units (E, M, M), nodes (N, 6, 6), pairs (Q, M, 6) between them, and ties (T, M,
    M) of a camera and a rectangle's pose on its body, which Views share.

    A unit is a camera, or the pose of a rectangle on its body that is to be found. M = K + 6: the lens columns, then
    the camera's twist in the rig frame; two more, offset and line time, where clocks are estimated. Of a rectangle's
    pose only its twist in the body's frame is an unknown. Gradients point down the cost.
    """

    units: Floats
    unit_gradient: Floats
    nodes: Floats
    node_gradient: Floats
    pairs: Floats
    ties: Floats


def normal_equations(observations: Observations, tables: Tables, state: State, gram: Floats) -> Normal:
    """Spread the Gram matrices over the poses of cameras, bodies and rectangles on them by the chain of Eq. 50."""
    chain = chain_derivatives(observations, state)
    # Line times are both in the Views themselves and in when they were taken.
    lines = chain.by_camera.shape[-1] // 8
    lens = gram.shape[-1] - 7 - lines
    size = lens + chain.by_camera.shape[-1]
    by_camera = chain.by_camera
    if lines:
        by_camera = np.concatenate([np.zeros_like(by_camera[:, :1]), by_camera], axis=1)
        by_camera[:, 0, -1] = 1.0
    # A node's twist moves the View as its camera's does.
    of_units = _spread(gram, by_camera, lens)
    node = [*range(lens, lens + 6), size]
    nodes = tables.view_by_node(of_units[:, lens : lens + 6, node])
    of_pairs, ties = of_units[:, :, lens : lens + 6], np.zeros((0, size, size))
    if len(tables.loose):
        rows = _layout_rows(gram, by_camera, chain.by_layout, tables, slice(lens, lens + 6))
        of_units, of_pairs = np.concatenate([of_units, rows[0]]), np.concatenate([of_pairs, rows[1]])
        ties = tables.loose_by_tie(rows[2])
    units, pairs = tables.row_by_unit(of_units), tables.row_by_pair(of_pairs)
    return Normal(units[:, :, :-1], units[:, :, -1], nodes[:, :, :-1], nodes[:, :, -1], pairs, ties)


def _spread(gram: Floats, by_camera: Floats, lens: int) -> Floats:
    """Gram matrices (V, M, M + 1) over the camera's unknowns and, by column, the residual; by_camera (V, .., M - K):
    of what stands between the lens columns and the residual by the rest of these unknowns."""
    size = lens + by_camera.shape[2]
    result = np.empty((len(gram), size, size + 1))
    moved = np.swapaxes(by_camera, 1, 2) @ gram[:, lens:-1]
    result[:, :lens, :lens], result[:, :lens, -1] = gram[:, :lens, :lens], gram[:, :lens, -1]
    result[:, lens:, :lens], result[:, lens:, -1] = moved[:, :, :lens], moved[:, :, -1]
    result[:, :lens, lens:size] = np.swapaxes(moved[:, :, :lens], 1, 2)
    np.matmul(moved[:, :, lens:-1], by_camera, out=result[:, lens:, lens:size])
    return result


def _layout_rows(
    gram: Floats, by_camera: Floats, by_layout: Floats, tables: Tables, twist: slice
) -> tuple[Floats, Floats, Floats]:
    """The part of a rectangle's pose on its body, for the Views (W,) where that is to be found: with itself and the
    residual (W, M, M + 1), with the node (W, M, 6), and of the camera with it (W, M, M). twist: where a unit has
    it."""
    by_layout, lens = by_layout[tables.loose], twist.start
    pulled = np.swapaxes(by_layout, -1, -2) @ gram[tables.loose, -7:-1]
    moved = pulled[:, :, lens:-1] @ by_camera[tables.loose]
    with_camera, size = np.concatenate([pulled[:, :, :lens], moved], axis=2), lens + moved.shape[2]
    own, nodes = np.zeros((len(pulled), size, size + 1)), np.zeros((len(pulled), size, 6))
    ties = np.zeros((len(pulled), size, size))
    own[:, twist, twist], own[:, twist, -1] = pulled[:, :, -7:-1] @ by_layout, pulled[:, :, -1]
    nodes[:, twist], ties[:, :, twist] = with_camera[:, :, twist], np.swapaxes(with_camera, -1, -2)
    return own, nodes, ties
