"""The adjustment with systematic errors: few unknowns that touch many Views, as a border of the reduced system.

With C the inverse of the reduced system over the units, B what ties the errors to it and D their own part, both
after the poses of bodies are eliminated: the errors' covariance is S = (D + prior - B' C B)^-1, and the units' is
C + C B S B' C.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from quadrig.rig.adjustment.levenberg_marquardt import Adjustment, FreeParameters
from quadrig.rig.adjustment.normal_equations import view_rows
from quadrig.rig.adjustment.schur import Reduced, node_steps
from quadrig.rig.adjustment.slack import eliminate_slack
from quadrig.rig.adjustment.state import State, chain_derivatives
from quadrig.rig.adjustment.systematic_errors import Moves, SystematicErrors
from quadrig.rig.problem.observations import ObservationGroup, Observations
from quadrig.single.arrays import Floats, Ints
from quadrig.single.pose import Pose

if TYPE_CHECKING:
    import scipy.sparse

# Matrices with fewer elements are quicker dense, most of theirs being zero or not.
_DENSE = 3_000_000
# Views whose Gram matrices are made at a time: 0.1 MB each.
_AT_ONCE = 500
_NO_LENS = np.zeros(0, int)


@dataclass(frozen=True, eq=False)
class Border:
    """What the Views say of the errors, poses of bodies eliminated, for each of F folds of the Views.

    units (F, E M, U): B above. information (F, U, U): D; gradient (F, U) down the cost; both without the prior.
    pairs (E M, 6 N) sparse, and passed (6 N, U), sparse where it is large: what leads to the steps of the nodes.
    lenses (C, K + 2 B, K + 2 B): what all Views say of each camera's lens columns and of what its lens leaves over,
    all poses held and none straying.
    """

    units: Floats
    information: Floats
    gradient: Floats
    pairs: "scipy.sparse.csr_array"
    passed: "Floats | scipy.sparse.csr_array"
    lenses: Floats

    def at_noise(self, before: float, after: float) -> "Border":
        """The same for another noise, px."""
        share = (before / after) ** 2
        return replace(
            self, units=share * self.units, information=share * self.information, gradient=share * self.gradient,
            pairs=share * self.pairs, lenses=share * self.lenses,
        )  # fmt: skip

    def lost(self, errors: SystematicErrors, values: Floats) -> tuple[Floats, Floats]:
        """By how much less the reduced system and its gradient say, (E M, E M) and (E M,), when the errors, now of
        these values (U,), may take any that their prior allows."""
        pull = self.gradient.sum(axis=0) - errors.information @ values
        units = self.units.sum(axis=0)
        right = np.column_stack([units.T, pull])
        solved = units @ np.linalg.solve(self.information.sum(axis=0) + errors.information, right)
        return (solved[:, :-1] + solved[:, :-1].T) / 2, solved[:, -1]


def border_of(
    errors: SystematicErrors,
    observations: Observations,
    found: Adjustment,
    free: FreeParameters,
    noise: float,
    reduced: Reduced,
    fold: Ints | None = None,
) -> Border:
    """The border at the end of an adjustment by least squares. reduced: of that adjustment. noise: px. fold (N,): of
    each node, all of whose Views are in it; one fold where None."""
    from scipy.sparse import bsr_array, coo_array

    units, size = reduced.free.shape
    nodes, tables = observations.nodes, found.tables
    fold = np.zeros(nodes, int) if fold is None else fold
    own = _Sums.of(errors, observations, found, free, noise, size, fold)
    node_inverse = bsr_array((reduced.node_inverse, np.arange(nodes), np.arange(nodes + 1)), shape=(6 * nodes,) * 2)
    row = tables.pair_unit[:, None, None] * size + np.arange(size)[:, None]
    column = tables.pair_node[:, None, None] * 6 + np.arange(6)
    at = [axis.ravel() for axis in np.broadcast_arrays(row, column)]
    pairs = coo_array((found.normal.pairs.ravel(), at), shape=(units * size, 6 * nodes)).tocsr()
    passed = node_inverse.tocsr() @ own.nodes
    border, information, gradient = own.units, own.errors, own.gradient
    pull = found.normal.node_gradient.ravel()
    for number in range(len(information)):
        rows = np.flatnonzero(np.repeat(fold == number, 6))
        chosen = passed[rows]
        border[number] -= _dense(pairs[:, rows] @ chosen)
        information[number] -= _dense(own.nodes[rows].T @ chosen)
        gradient[number] -= chosen.T @ pull[rows]
    border[:, ~reduced.free.ravel()] = 0.0
    return Border(border, information, gradient, pairs, passed, own.lenses)


def border_near(
    before: Border,
    errors: SystematicErrors,
    observations: Observations,
    found: Adjustment,
    noise: float,
) -> Border:
    """The border, of one fold, at the end of an adjustment so near to that of another, at the same noise, that only
    the gradient differs. No View strays. noise: px."""
    gradient, chained = np.zeros(len(errors.information)), found.state.camera_from_rect(observations)
    for group, moves in zip(observations.groups, errors.moves, strict=True):
        pose = chained[group.view]
        rows, _ = view_rows(group, found.state.lens[group.camera], pose, _NO_LENS)
        pull = np.where(np.isfinite(rows), rows, 0.0)
        left_over = pull[-1] * (group.weights / noise**2)[:, None]
        on_sheet = np.swapaxes(pose.rotation, 1, 2) @ (pull[3:6] * left_over).sum(axis=2).swapaxes(0, 1)
        own = (
            np.einsum("vpsa,vap->vs", moves.by_shape, on_sheet),
            np.einsum("vpta,vap->vt", moves.by_tone, left_over),
            (left_over @ moves.by_lens).reshape(len(left_over), -1),
        )
        np.add.at(gradient, moves.index, np.concatenate(own, axis=1))
    gradient -= before.passed.T @ found.normal.node_gradient.ravel()
    return replace(before, gradient=gradient[None])


@dataclass(frozen=True, eq=False)
class Bordered:
    """One step to the minimum over cameras, poses of bodies and systematic errors together.

    values (U,): of the errors after it; covariance (U, U), and a root (U, U) of it. step (U,), unit_steps (E, M),
    node_steps (N, 6): the step. by_unit (E M, U): by how much units move with each of U independent errors of one
    sigma. fall: of chi-square, that is expected. effective: how many unknowns the errors count for, less what priors
    hold. data_information (U, U), data_pull (U,): what the Views alone say of the errors, quadratic about errors of
    zero, cameras and poses following.
    """

    values: Floats
    covariance: Floats
    step: Floats
    unit_steps: Floats
    node_steps: Floats
    by_unit: Floats
    border: Border
    root: Floats
    fall: float
    effective: float
    data_information: Floats
    data_pull: Floats

    def part(self, observations: Observations, found: Adjustment, share: float) -> tuple[State, Floats]:
        """State and values (U,) of the errors after a share of the step from the end of that adjustment."""
        state = found.stepped(observations, share * self.unit_steps, share * self.node_steps)
        return state, self.values - (1 - share) * self.step

    def with_errors(self, unit_covariance: Floats) -> Floats:
        """The covariance (E M, E M) of the cameras with the errors' doubt, from that without."""
        return unit_covariance + self.by_unit @ self.by_unit.T

    def joint_covariance(self, unit_covariance: Floats) -> Floats:
        """The covariance (E M + U, E M + U) of cameras and errors together, from that of the cameras without
        errors."""
        across = self.by_unit @ self.root.T
        return np.block([[self.with_errors(unit_covariance), across], [across.T, self.covariance]])

    def node_roots(self, reduced: Reduced) -> Floats:
        """By how much every pose of a body moves (N, 6, U), against by_unit, with each of the U independent errors of
        one sigma."""
        size, nodes = len(self.values), len(reduced.node_inverse)
        followed = reduced.node_inverse @ (self.border.pairs.T @ self.by_unit).reshape(nodes, 6, size)
        return followed + (self.border.passed @ self.root).reshape(nodes, 6, size)


def solve_bordered(
    border: Border,
    errors: SystematicErrors,
    values: Floats,
    found: Adjustment,
    reduced: Reduced,
    unit_covariance: Floats,
) -> Bordered:
    """The step from the end of an adjustment made with errors of these values (U,) taken off.

    border, reduced: of that adjustment; unit_covariance (E M, E M): without the errors.
    """
    from scipy.linalg import solve_triangular

    ties = border.units.sum(axis=0)
    through = unit_covariance @ ties
    data = border.information.sum(axis=0) - ties.T @ through
    information = data + errors.information
    lower = np.linalg.cholesky((information + information.T) / 2)
    root = solve_triangular(lower, np.eye(len(values)), lower=True).T
    gradient = np.where(reduced.free, reduced.gradient, 0.0).ravel()
    pulled = border.gradient.sum(axis=0) - errors.information @ values - through.T @ gradient
    step = root @ (root.T @ pulled)
    firm = unit_covariance @ gradient
    node_pull = found.normal.node_gradient
    firm_fall = gradient @ firm + float((node_pull[:, None] @ reduced.node_inverse @ node_pull[..., None]).sum())
    steps = (firm - through @ step).reshape(reduced.free.shape)
    poses = node_steps(found.normal, found.tables, reduced, steps) - (border.passed @ step).reshape(-1, 6)
    by_unit = -through @ root
    covariance = root @ root.T
    return Bordered(
        values + step,
        covariance,
        step,
        steps,
        poses,
        by_unit,
        border,
        root,
        float(step @ pulled + firm_fall),
        len(values) - float((errors.information * covariance).sum()),
        data,
        pulled + errors.information @ values + data @ values,
    )


@dataclass(frozen=True, eq=False)
class _Sums:
    """The errors' part of the normal equations: with units (F, E M, U), among themselves (F, U, U) and the gradient
    (F, U), for each fold; with nodes (6 N, U). lenses: as Border has them."""

    units: Floats
    nodes: "Floats | scipy.sparse.csr_array"
    errors: Floats
    gradient: Floats
    lenses: Floats

    @staticmethod
    def of(
        errors: SystematicErrors,
        observations: Observations,
        found: Adjustment,
        free: FreeParameters,
        noise: float,
        size: int,
        fold: Ints,
    ) -> "_Sums":
        """size: M, of a camera's unknowns; fold (N,): of each node."""
        from scipy.sparse import coo_array

        lens, unknowns, folds = len(found.columns), len(errors.information), int(fold.max(initial=0)) + 1
        result = np.zeros((folds, found.tables.units, size, unknowns))
        own, gradient, parts = np.zeros((folds, unknowns, unknowns)), np.zeros((folds, unknowns)), []
        chain, joins = chain_derivatives(observations, found.state), observations.joins
        fields = errors.lens_rows.shape[1]
        lenses = np.zeros((observations.cameras, lens + fields, lens + fields))
        for part, gram, index in extended_grams(errors, observations, found, noise):
            held = np.r_[:lens, lens + index.shape[1] - fields : lens + index.shape[1]]
            np.add.at(lenses, part.camera, gram[:, held[:, None], held])
            if free.slack is not None and found.state.slack is not None:
                gram = eliminate_slack(gram, found.state.slack[part.view], free.slack.information[part.view]).gram
            of_errors = gram[:, lens : lens + index.shape[1]]
            by_pose = of_errors[:, :, -7:-1]
            with_camera = np.concatenate([of_errors[:, :, :lens], by_pose @ chain.by_camera[part.view]], axis=2)
            # Views of one camera, one sheet and one fold have the same errors: they are summed first.
            key = (index[:, 0] * observations.cameras + part.camera) * folds + fold[part.node]
            order = np.argsort(key, kind="stable")
            starts = np.flatnonzero(np.diff(key[order], prepend=-1))
            first = order[starts]
            at, camera, number = index[first], part.camera[first], fold[part.node[first]]

            place = (number[:, None, None], camera[:, None, None], np.arange(size)[:, None], at[:, None, :])
            np.add.at(result, place, np.swapaxes(np.add.reduceat(with_camera[order], starts), 1, 2))
            if joins.found:
                layout = joins.layout[part.view[first]]
                loose = np.flatnonzero((layout >= 0) & (layout < joins.found))
                with_layout = np.add.reduceat((by_pose @ chain.by_layout[part.view])[order], starts)
                unit = joins.cameras + layout[loose, None, None]
                place = (number[loose, None, None], unit, lens + np.arange(6)[:, None], at[loose][:, None, :])
                np.add.at(result, place, np.swapaxes(with_layout[loose], 1, 2))
            among = np.add.reduceat(of_errors[order, :, lens : lens + index.shape[1]], starts)
            np.add.at(own, (number[:, None, None], at[:, :, None], at[:, None, :]), among)
            np.add.at(gradient, (fold[part.node][:, None], index), of_errors[:, :, -1])
            row = part.node[:, None, None] * 6 + np.arange(6)[:, None]
            with_node = np.swapaxes(by_pose @ chain.by_node[part.view], 1, 2)
            parts.append([axis.ravel() for axis in np.broadcast_arrays(with_node, row, index[:, None, :])])
        value, row, column = (np.concatenate(each) for each in zip(*parts, strict=True))
        nodes = coo_array((value, (row, column)), shape=(6 * observations.nodes, unknowns))
        nodes = nodes.toarray() if 6 * observations.nodes * unknowns < _DENSE else nodes.tocsr()
        return _Sums(result.reshape(folds, -1, unknowns), nodes, own, gradient, lenses)


def extended_grams(
    errors: SystematicErrors, observations: Observations, found: Adjustment, noise: float
) -> Iterator[tuple[ObservationGroup, Floats, Ints]]:
    """Some Views at a time, their Gram matrices (V, K+E+7, K+E+7) over [lens columns, errors, step of
    camera_from_rect, residual], and which errors (V, E) act on them."""
    chained = found.state.camera_from_rect(observations)
    for group, moves in zip(observations.groups, errors.moves, strict=True):
        for rows in _batches(len(group.view)):
            part = group.part(rows)
            yield part, _gram(part, moves, rows, found, chained[part.view], noise), moves.index[rows]


def _dense(matrix: "Floats | scipy.sparse.csr_array") -> Floats:
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def _batches(count: int) -> list[slice]:
    return [slice(begin, begin + _AT_ONCE) for begin in range(0, count, _AT_ONCE)]


def _gram(group: ObservationGroup, moves: Moves, rows: slice, found: Adjustment, pose: Pose, noise: float) -> Floats:
    """Gram matrices (V, K+E+7, K+E+7) over [lens columns, errors, step of camera_from_rect, residual] of some Views
    of a group; pose: camera_from_rect of each."""
    lens, (count, size) = len(found.columns), group.weights.shape
    own, _ = view_rows(group, found.state.lens[group.camera], pose, found.columns)
    own = np.where(np.isfinite(own), own, 0.0)
    by_point = np.swapaxes(own[lens + 3 : lens + 6], 0, 1).reshape(count, 3, 2, size)
    by_rect = np.swapaxes(pose.rotation, -1, -2) @ by_point.reshape(count, 3, 2 * size)
    by_shape = moves.by_shape[rows].transpose(3, 2, 0, 1)
    of_shapes = (by_rect.reshape(count, 3, 1, 2, size).transpose(1, 2, 0, 3, 4) * by_shape[:, :, :, None]).sum(axis=0)
    few = np.concatenate([own[:lens], of_shapes, moves.by_tone[rows].transpose(2, 0, 3, 1), own[lens:]])
    weights, field = group.weights / noise**2, moves.by_lens[rows]
    weighted = weights[..., None] * field
    first = lens + len(of_shapes) + moves.by_tone.shape[2]
    fields, total = field.shape[2], len(few) + 2 * field.shape[2]
    gram = np.zeros((count, total, total))
    kept = np.r_[:first, first + 2 * fields : total]
    flat = few.reshape(len(few), count, -1).transpose(1, 0, 2)
    scaled = flat * np.tile(weights, (1, 2))[:, None]
    gram[:, kept[:, None], kept] = flat @ np.swapaxes(scaled, -1, -2)
    if not fields:
        return gram
    among = np.swapaxes(field, -1, -2) @ weighted
    for side in range(2):
        at = slice(first + side * fields, first + (side + 1) * fields)
        crossed = few[:, :, side].transpose(1, 0, 2) @ weighted
        gram[:, kept, at], gram[:, at, kept] = crossed, np.swapaxes(crossed, -1, -2)
        gram[:, at, at] = among
    return gram
