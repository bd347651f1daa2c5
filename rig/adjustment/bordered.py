"""The adjustment with systematic errors: few unknowns that touch many Views, as a border of the reduced system.

With C the inverse of the reduced system over the units, B what ties the errors to it and D their own part, both
after the poses of bodies are eliminated: the errors' covariance is S = (D + prior - B' C B)^-1, and the units' is
C + C B S B' C.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from quadrig.rig.adjustment.levenberg_marquardt import (
    Adjustment,
    FreeParameters,
    at_state,
    lens_covariances,
    undamped,
)
from quadrig.rig.adjustment.normal_equations import Linearised, view_rows, weighed
from quadrig.rig.adjustment.schur import Reduced, dense_where_full, node_steps, own_blocks
from quadrig.rig.adjustment.slack import eliminate_slack
from quadrig.rig.adjustment.state import State, chain_derivatives
from quadrig.rig.adjustment.systematic_errors import Moves, SystematicErrors
from quadrig.rig.adjustment.tables import Tables
from quadrig.rig.problem.observations import ObservationGroup, Observations
from quadrig.single.arrays import Floats, Ints
from quadrig.single.posterior.sheet_shape import AXES_OF_SHAPES

if TYPE_CHECKING:
    import scipy.sparse

Matrix: TypeAlias = "Floats | scipy.sparse.csr_array"

# Matrices with fewer elements are quicker dense, most of theirs being zero or not.
_DENSE = 300_000
# Points whose rows are made at a time: they fit into a processor's second-level cache.
_AT_ONCE = 8192
# Poses of bodies whose errors' doubt is worked out at a time: each takes as many numbers as there are errors, six
# times.
_NODES_AT_ONCE = 500


@dataclass(frozen=True, eq=False)
class Border:
    """What the Views say of the errors, poses of bodies eliminated, for each of F folds of the Views.

    units F times (E M, U): B above. information F times (U, U): D; gradient (F, U) down the cost; both without the
    prior. pairs (E M, 6 N) and passed (6 N, U): what leads to the steps of the nodes. All but the gradient are sparse
    where they are large. lenses (C, K + 2 B, K + 2 B): what all Views say of each camera's lens columns and of what
    its lens leaves over, all poses held and none straying.
    """

    units: tuple[Matrix, ...]
    information: tuple[Matrix, ...]
    gradient: Floats
    pairs: Matrix
    passed: Matrix
    lenses: Floats

    @cached_property
    def all_units(self) -> Matrix:
        """(E M, U): of all folds together."""
        return _total(self.units)

    @cached_property
    def all_information(self) -> Matrix:
        """(U, U): of all folds together."""
        return _total(self.information)

    def at_noise(self, before: float, after: float) -> "Border":
        """The same for another noise, px."""
        share = (before / after) ** 2
        return replace(
            self,
            units=tuple(share * each for each in self.units),
            information=tuple(share * each for each in self.information),
            gradient=share * self.gradient,
            pairs=share * self.pairs,
            lenses=share * self.lenses,
        )

    def lost(self, errors: SystematicErrors, values: Floats) -> tuple[Floats, Floats]:
        """By how much less the reduced system and its gradient say, (E M, E M) and (E M,), when the errors, now of
        these values (U,), may take any that their prior allows."""
        pull = self.gradient.sum(axis=0) - errors.pull(values)
        units = dense(self.all_units)
        right = np.column_stack([units.T, pull])
        solved = units @ np.linalg.solve(self.all_information + errors.information, right)
        return (solved[:, :-1] + solved[:, :-1].T) / 2, solved[:, -1]


@dataclass(frozen=True, eq=False)
class Expansion:
    """The least-squares problem about a state: the Views' adjustment there, its reduced system, and the border."""

    adjustment: Adjustment
    reduced: Reduced
    border: Border


def expand(
    errors: SystematicErrors,
    observations: Observations,
    state: State,
    free: FreeParameters,
    noise: float,
    tables: Tables,
    fold: Ints | None = None,
) -> Expansion:
    """Cameras, poses of bodies and systematic errors linearised together. noise: px. fold (N,): of each node, all of
    whose Views are in it; one fold where None."""
    fold = np.zeros(observations.nodes, int) if fold is None else fold
    linearised, own = _sums(errors, observations, state, free, noise, fold)
    found = at_state(observations, state, free, noise, tables, linearised)
    reduced = undamped(found, free)
    units, size = reduced.free.shape
    row = tables.pair_unit[:, None, None] * size + np.arange(size)[:, None]
    column = tables.pair_node[:, None, None] * 6 + np.arange(6)
    row, column = np.broadcast_arrays(row, column)
    shape = (units * size, 6 * observations.nodes)
    pairs = _matrix(found.normal.pairs.ravel(), row.ravel(), column.ravel(), shape)
    passed, pull = _followed(reduced.node_inverse, own.nodes), found.normal.node_gradient.ravel()
    border, information, gradient = [], [], own.gradient
    for number in range(len(gradient)):
        rows = np.flatnonzero(np.repeat(fold == number, 6))
        chosen = passed[rows]
        border.append(own.units[number * units * size : (number + 1) * units * size] - pairs[:, rows] @ chosen)
        unknowns = gradient.shape[1]
        among = own.errors[number * unknowns : (number + 1) * unknowns]
        information.append(among - own.nodes[rows].T @ chosen)
        gradient[number] -= chosen.T @ pull[rows]
    return Expansion(found, reduced, Border(tuple(border), tuple(information), gradient, pairs, passed, own.lenses))


def _followed(inverse: Floats, nodes: Matrix) -> Matrix:
    """Inverses (N, 6, 6) of the nodes' blocks, times a matrix (6 N, U)."""
    if isinstance(nodes, np.ndarray):
        return (inverse @ nodes.reshape(*inverse.shape[:2], -1)).reshape(nodes.shape)
    from scipy.sparse import bsr_array

    count = len(inverse)
    return bsr_array((inverse, np.arange(count), np.arange(count + 1)), shape=(6 * count,) * 2).tocsr() @ nodes


@dataclass(frozen=True, eq=False)
class Bordered(ABC):
    """One step to the minimum over cameras, poses of bodies and systematic errors together, and their covariance
    there.

    values (U,): of the errors after it. step (U,), unit_steps (E, M), node_steps (N, 6): the step. fall: of
    chi-square, that is expected. effective: how many unknowns the errors count for, less what priors hold.
    """

    values: Floats
    step: Floats
    unit_steps: Floats
    node_steps: Floats
    border: Border
    fall: float
    effective: float

    def part(self, observations: Observations, found: Adjustment, share: float) -> tuple[State, Floats]:
        """State and values (U,) of the errors after a share of the step from the end of that adjustment."""
        state = found.stepped(observations, share * self.unit_steps, share * self.node_steps)
        return state, self.values - (1 - share) * self.step

    @property
    @abstractmethod
    def firm(self) -> Floats:
        """The covariance (E M, E M) of the units, were the errors known."""

    @abstractmethod
    def with_step_in_doubt(self) -> "Bordered":
        """The same with one independent error more, as large as the step: where the fit ends without it, how far the
        minimum may be is unknown by that much."""

    @abstractmethod
    def lens_covariances(self, found: Adjustment) -> Floats:
        """(C, 9, 9) of each camera's lens."""

    @abstractmethod
    def error_covariances(self, rows: Ints) -> Floats:
        """Covariances (K, J, J) of the errors at rows (K, J), those of one sheet in each."""

    @abstractmethod
    def error_products(self, vector: Floats) -> Floats:
        """The covariance (U, U) of the errors, times a vector (U,)."""

    @abstractmethod
    def columns(self, chosen: Ints) -> Floats:
        """The columns (E M + U, K) of the covariance of units and errors at those (K,)."""

    @abstractmethod
    def node_covariances(self, found: Adjustment, reduced: Reduced) -> Floats:
        """Covariance (N, 6, 6) of the twist of every pose of a body: its own Views' doubt, and what cameras, layouts
        and errors pass on to it."""

    @abstractmethod
    def widened(self, gradient: "Matrix | None", taken: Floats | None) -> Floats:
        """The covariance (E M, E M) of the units where that of their reduced gradient is not what the fit took
        it for, and where they are moved by taken (E M, U), times the errors; as they are where None."""

    def node_columns(self, reduced: Reduced, columns: Floats) -> Floats:
        """What the twists (N, 6, K) of bodies' poses have in common with K unknowns, from the columns of these."""
        first = self.unit_steps.size
        followed = self.border.pairs.T @ columns[:first]
        followed = reduced.node_inverse @ followed.reshape(len(reduced.node_inverse), 6, -1)
        return -followed - (self.border.passed @ columns[first:]).reshape(followed.shape)


@dataclass(frozen=True, eq=False)
class DenseBordered(Bordered):
    """The same, all covariances at hand.

    covariance (U, U): of the errors, and a root (U, R) of it. by_unit (E M, R): by how much units move with each of R
    independent errors of one sigma.
    """

    unit_covariance: Floats
    covariance: Floats
    root: Floats
    by_unit: Floats

    @property
    def firm(self) -> Floats:
        """The covariance (E M, E M) of the units, were the errors known."""
        return self.unit_covariance

    @cached_property
    def joint_covariance(self) -> Floats:
        """The covariance (E M + U, E M + U) of cameras and errors together."""
        first = len(self.firm)
        result = np.empty((first + len(self.values),) * 2)
        np.matmul(self.by_unit, self.by_unit.T, out=result[:first, :first])
        result[:first, :first] += self.firm
        np.matmul(self.by_unit, self.root.T, out=result[:first, first:])
        result[first:, :first], result[first:, first:] = result[:first, first:].T, self.covariance
        return result

    def lens_covariances(self, found: Adjustment) -> Floats:
        """(C, 9, 9) of each camera's lens."""
        columns, cameras = found.columns, len(found.state.lens)
        own = self.by_unit.reshape(found.tables.units, -1, self.by_unit.shape[1])[:cameras, : len(columns)]
        covariance = lens_covariances(found, own_blocks(self.firm, found.tables.units))
        covariance[:, columns[:, None], columns] += own @ np.swapaxes(own, 1, 2)
        return covariance

    def error_covariances(self, rows: Ints) -> Floats:
        """Covariances (K, J, J) of the errors at rows (K, J)."""
        return self.covariance[rows[:, :, None], rows[:, None]]

    def error_products(self, vector: Floats) -> Floats:
        """The covariance (U, U) of the errors, times a vector (U,)."""
        return self.covariance @ vector

    def with_step_in_doubt(self) -> "DenseBordered":
        """The same with one independent error more, as large as the step."""
        root = np.column_stack([self.root, self.step])
        by_unit = np.column_stack([self.by_unit, self.unit_steps.ravel()])
        return replace(self, root=root, by_unit=by_unit, covariance=root @ root.T)

    def columns(self, chosen: Ints) -> Floats:
        """The columns (E M + U, K) of the covariance of units and errors at those (K,)."""
        roots = np.concatenate([self.by_unit, self.root])
        result, units = roots @ roots[chosen].T, np.flatnonzero(chosen < len(self.firm))
        result[: len(self.firm), units] += self.firm[:, chosen[units]]
        return result

    def node_covariances(self, found: Adjustment, reduced: Reduced) -> Floats:
        """Covariance (N, 6, 6) of the twist of every pose of a body."""
        tables, (units, size) = found.tables, reduced.free.shape
        passed = reduced.node_inverse[tables.pair_node] @ np.swapaxes(found.normal.pairs, -1, -2)
        blocks = self.firm.reshape(units, size, units, size)
        left, right = tables.meeting_left, tables.meeting_right
        between = blocks[tables.pair_unit[left], :, tables.pair_unit[right], :]
        term = passed[left] @ between @ np.swapaxes(passed[right], -1, -2)
        result = reduced.node_inverse.copy()
        np.add.at(result, tables.pair_node[left], term)
        off = left != right
        np.add.at(result, tables.pair_node[left][off], np.swapaxes(term[off], -1, -2))
        for begin in range(0, len(result), _NODES_AT_ONCE):
            nodes = slice(begin, min(begin + _NODES_AT_ONCE, len(result)))
            roots = self.node_roots(reduced, nodes)
            result[nodes] += roots @ np.swapaxes(roots, -1, -2)
        return result

    def node_roots(self, reduced: Reduced, nodes: slice) -> Floats:
        """By how much some poses of bodies move (N', 6, R), against by_unit, with each of the R independent errors of
        one sigma."""
        rows, size, inverse = (
            slice(6 * nodes.start, 6 * nodes.stop),
            self.by_unit.shape[1],
            reduced.node_inverse[nodes],
        )
        followed = inverse @ (self.border.pairs[:, rows].T @ self.by_unit).reshape(len(inverse), 6, size)
        return followed + (self.border.passed[rows] @ self.root).reshape(len(inverse), 6, size)

    def widened(self, gradient: "Matrix | None", taken: Floats | None) -> Floats:
        """The covariance (E M, E M) of the units with another one of their gradient, moved by taken (E M, U)."""
        result = self.firm
        if gradient is not None:
            result = self.firm @ (gradient @ self.firm)
            result = (result + result.T) / 2
        by_unit = self.by_unit if taken is None else self.by_unit + taken @ self.root
        return result + by_unit @ by_unit.T


def solve_bordered(
    border: Border,
    errors: SystematicErrors,
    values: Floats,
    found: Adjustment,
    reduced: Reduced,
    unit_covariance: Floats,
) -> DenseBordered:
    """The step from the end of an adjustment made with errors of these values (U,) taken off.

    border, reduced: of that adjustment; unit_covariance (E M, E M): without the errors.
    """
    from scipy.linalg import get_lapack_funcs

    ties = border.all_units
    through = unit_covariance @ ties
    data = border.all_information - ties.T @ through
    information = data + errors.information
    lower = np.linalg.cholesky((information + information.T) / 2)
    (inverted,) = get_lapack_funcs(("trtri",), (lower,))
    root = inverted(lower, lower=1)[0].T
    gradient = np.where(reduced.free, reduced.gradient, 0.0).ravel()
    pulled = border.gradient.sum(axis=0) - errors.pull(values) - through.T @ gradient
    step = root @ (root.T @ pulled)
    firm = unit_covariance @ gradient
    node_pull = found.normal.node_gradient
    firm_fall = gradient @ firm + float((node_pull[:, None] @ reduced.node_inverse @ node_pull[..., None]).sum())
    steps = (firm - through @ step).reshape(reduced.free.shape)
    poses = node_steps(found.normal, found.tables, reduced, steps) - (border.passed @ step).reshape(-1, 6)
    by_unit = -through @ root
    covariance = root @ root.T
    return DenseBordered(
        values + step,
        step,
        steps,
        poses,
        border,
        float(step @ pulled + firm_fall),
        len(values) - float((errors.information * covariance).sum()),
        unit_covariance,
        covariance,
        root,
        by_unit,
    )


@dataclass(frozen=True, eq=False)
class _Sums:
    """The errors' part of the normal equations: with units (F E M, U), among themselves (F U, U) and the gradient (F,
    U), for each fold; with nodes (6 N, U). lenses: as Border has them."""

    units: Matrix
    nodes: Matrix
    errors: Matrix
    gradient: Floats
    lenses: Floats


def _sums(
    errors: SystematicErrors,
    observations: Observations,
    state: State,
    free: FreeParameters,
    noise: float,
    fold: Ints,
) -> tuple[Linearised, _Sums]:
    """fold (N,): of each node."""
    columns, joins, chain = free.columns, observations.joins, chain_derivatives(observations, state)
    lens, unknowns, folds = len(columns), len(errors.held), int(fold.max(initial=0)) + 1
    size, fields = lens + chain.by_camera.shape[2], errors.lens_rows.shape[1]
    # Lens and line time act on the Views themselves.
    itself = lens + (state.readout(observations) is not None)
    count = joins.cameras + joins.found
    units, own, nodes, gradient = [], [], [], np.zeros((folds, unknowns))
    lenses = np.zeros((observations.cameras, lens + fields, lens + fields))
    grams, cost = np.zeros((len(joins.camera), itself + 7, itself + 7)), 0.0
    squares: list[list[Floats]] = [[] for _ in observations.groups]
    for one in error_rows(errors, observations, state, columns):
        part, index = one.part, one.moves.index
        weights, lost = weighed(part, one.square, noise, robust=False)
        # Views of one camera, one sheet and one fold have the same errors, and stand in a row: they are summed first.
        key = (index[:, 0] * observations.cameras + part.camera) * folds + fold[part.node]
        starts = np.flatnonzero(np.diff(key, prepend=-1))
        gram = _Gram.of(one, weights, itself, starts)
        camera, number, at = part.camera[starts], fold[part.node[starts]], index[starts]
        np.add.at(lenses, camera, gram.held(lens, fields, starts))
        if free.slack is not None and state.slack is not None:
            gram = gram.without_slack(state.slack[part.view], free.slack.information[part.view], starts)
        grams[part.view], cost = gram.own, cost + lost
        squares[one.group].append(one.square)
        moved = np.swapaxes(chain.by_camera[part.view], 1, 2) @ gram.step
        with_camera = np.concatenate([gram.across[:, :lens], np.add.reduceat(moved, starts)], axis=1)
        with_camera[:, size - itself + lens :] += gram.across[:, lens:itself]
        np.add.at(gradient, (number[:, None], at), gram.across[:, -1])
        units.append(_placed(with_camera, (number * count + camera) * size, at))
        own.append(_placed(gram.errors, number[:, None] * unknowns + at, at))
        nodes.append(_placed(moved[:, :6], 6 * part.node, index))
        if joins.found:
            layout = joins.layout[part.view[starts]]
            loose = np.flatnonzero((layout >= 0) & (layout < joins.found))
            with_layout = np.add.reduceat(np.swapaxes(chain.by_layout[part.view], 1, 2) @ gram.step, starts)
            first = (number * count + joins.cameras + layout) * size + lens
            units.append(_placed(with_layout[loose], first[loose], at[loose]))
    linearised = Linearised(grams, cost, tuple(np.concatenate(each) for each in squares))
    return linearised, _Sums(
        _gathered(units, (folds * count * size, unknowns)),
        _gathered(nodes, (6 * observations.nodes, unknowns)),
        _gathered(own, (folds * unknowns, unknowns)),
        gradient,
        lenses,
    )


def _placed(blocks: Floats, row: Ints, column: Ints) -> tuple[Floats, Ints, Ints]:
    """The elements of blocks (S, R, E), and their places: row (S,) of each block's first row, or (S, R) of all of
    them, column (S, E)."""
    rows = row[:, None] + np.arange(blocks.shape[1]) if row.ndim == 1 else row
    value, at, to = np.broadcast_arrays(blocks, rows[:, :, None], column[:, None])
    return value.ravel(), at.ravel(), to.ravel()


def _gathered(parts: Sequence[tuple[Floats, Ints, Ints]], shape: tuple[int, int]) -> Matrix:
    values, row, column = (np.concatenate(each) for each in zip(*parts, strict=True))
    return _matrix(values, row, column, shape)


@dataclass(frozen=True, eq=False)
class _Gram:
    """Products of the rows of V Views, S runs of which have the same errors: own (V, L, L) over [lens columns, line
    time where things move, step of camera_from_rect, residual]; of the step with the errors (V, 6, E); and sums over
    each run of what comes before the step and of the residual with the errors, across (S, K + 1, E), and of the
    errors (S, E, E)."""

    own: Floats
    step: Floats
    across: Floats
    errors: Floats

    @staticmethod
    def of(one: "ErrorRows", weights: Floats, lens: int, starts: Ints) -> "_Gram":
        """weights (V, P), which the rows are made to carry; lens: how many come before the step; starts (S,): where
        each run begins."""
        count, size = weights.shape
        first, root = lens + 7, np.sqrt(weights)[:, None]
        rows, field = np.multiply(one.rows, root, out=one.rows), one.moves.by_lens * root
        flat, field_across = np.swapaxes(rows.reshape(len(rows), count, 2 * size), 0, 1), np.swapaxes(field, 1, 2)
        # A field moves either coordinate by itself: what is not zero of it is one of two halves.
        halves = rows.transpose(1, 2, 0, 3) @ field_across[:, None]
        step = slice(lens, lens + 6)
        of_step = flat[:, step] @ np.swapaxes(flat[:, first:], 1, 2)
        of_runs = [
            rows[first:, begin:end].reshape(len(rows) - first, -1) @ rows[:, begin:end].reshape(len(rows), -1).T
            for begin, end in pairwise([*starts, count])
        ]
        few, summed = np.stack(of_runs), np.add.reduceat(halves, starts)
        kept = [*range(lens), first - 1]
        across = [np.swapaxes(few[:, :, kept], 1, 2), summed[:, 0, kept], summed[:, 1, kept]]
        upper = np.concatenate([few[:, :, first:], summed[:, 0, first:], summed[:, 1, first:]], axis=2)
        shapes, errors = upper.shape[1], np.zeros((len(starts), upper.shape[2], upper.shape[2]))
        errors[:, :shapes], errors[:, shapes:, :shapes] = upper, np.swapaxes(upper[:, :, shapes:], 1, 2)
        among, fields = np.add.reduceat(field @ field_across, starts), field.shape[1]
        for begin in (shapes, shapes + fields):
            errors[:, begin : begin + fields, begin : begin + fields] = among
        return _Gram(
            flat[:, :first] @ np.swapaxes(flat[:, :first], 1, 2),
            np.concatenate([of_step, halves[:, 0, step], halves[:, 1, step]], axis=2),
            np.concatenate(across, axis=2),
            errors,
        )

    def held(self, lens: int, fields: int, starts: Ints) -> Floats:
        """Sums over each run (S, K + fields, K + fields), poses held, of lens columns and fields of lenses."""
        first = self.errors.shape[1] - fields
        across = self.across[:, :lens, first:]
        own = np.add.reduceat(self.own[:, :lens, :lens], starts)
        upper, lower = np.concatenate([own, across], 2), (np.swapaxes(across, 1, 2), self.errors[:, first:, first:])
        return np.concatenate([upper, np.concatenate(lower, 2)], 1)

    def without_slack(self, slack: Floats, information: Floats, starts: Ints) -> "_Gram":
        """The errors' part where every View strays by slack (V, 6), with prior information (V, 6), as it must."""
        lens, eliminated = self.across.shape[1] - 1, eliminate_slack(self.own, slack, information)
        followed, rows = eliminated.inverse @ self.step, np.swapaxes(eliminated.rows, 1, 2)
        kept, step = [*range(lens), -1], slice(lens, lens + 6)
        return replace(
            self,
            step=self.step - rows[:, step] @ followed,
            across=self.across - np.add.reduceat(rows[:, kept] @ followed, starts),
            errors=self.errors - np.add.reduceat(np.swapaxes(self.step, 1, 2) @ followed, starts),
        )


@dataclass(frozen=True, eq=False)
class ErrorRows:
    """Some Views of a group, by its number: rows (K + 7 + S, V, 2, P), unweighted, of derivatives by lens columns
    (K,), line time where things move, and step of camera_from_rect, of the residual, and of derivatives by shapes and
    tones; squared residuals (V, P) px^2; and how errors move these Views, of which fields of lenses are to be added
    to the rows."""

    group: int
    part: ObservationGroup
    rows: Floats
    square: Floats
    moves: Moves


def error_rows(
    errors: SystematicErrors, observations: Observations, state: State, columns: Ints
) -> Iterator[ErrorRows]:
    """The rows of all Views at a state, some at a time."""
    chained, readout = state.camera_from_rect(observations), state.readout(observations)
    for number, (group, moves) in enumerate(zip(observations.groups, errors.moves, strict=True)):
        step = max(_AT_ONCE // max(group.weights.shape[1], 1), 1)
        for begin in range(0, len(group.view), step):
            chosen = slice(begin, begin + step)
            part, own = group.part(chosen), moves.part(chosen)
            more, pose = own.by_shape.shape[1] + own.by_tone.shape[1], chained[part.view]
            rows, square = view_rows(part, state.lens[part.camera], pose, columns, readout, more)
            _fill_error_rows(rows, own, pose.rotation)
            if not np.isfinite(square.sum()):
                rows[~np.isfinite(rows)] = 0.0
            yield ErrorRows(number, part, rows, square, own)


def _fill_error_rows(rows: Floats, moves: Moves, rotation: Floats) -> None:
    """Fill the last of the rows (.., V, 2, P) with the derivatives by shapes and tones; rotation (V, 3, 3): of
    camera_from_rect."""
    shapes, tones = moves.by_shape.shape[1], moves.by_tone.shape[1]
    first, (count, _, size) = len(rows) - shapes - tones, rows.shape[1:]
    by_point = np.swapaxes(rows[first - 4 : first - 1].reshape(3, count, 2 * size), 0, 1)
    by_rect = (np.swapaxes(rotation, -1, -2) @ by_point).reshape(count, 3, 2, size)
    for shape, axes in enumerate(AXES_OF_SHAPES):
        np.multiply(moves.by_shape[:, shape, axes[0], None], by_rect[:, axes[0]], out=rows[first + shape])
        for axis in axes[1:]:
            rows[first + shape] += moves.by_shape[:, shape, axis, None] * by_rect[:, axis]
    rows[first + shapes :] = np.swapaxes(moves.by_tone, 0, 1)


def dense(matrix: Matrix) -> Floats:
    """The matrix with all its zeros."""
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def bordered_matrix(inner: Matrix, ties: Matrix, outer: Matrix) -> Matrix:
    """The symmetric matrix of two kinds of unknowns (A, A), (B, B) and their ties (A, B); sparse where one is."""
    if isinstance(inner, np.ndarray) and isinstance(ties, np.ndarray) and isinstance(outer, np.ndarray):
        return np.block([[inner, ties], [ties.T, outer]])
    from scipy.sparse import block_array, csr_array

    rows = [[csr_array(each) for each in row] for row in ([inner, ties], [ties.T, outer])]
    return dense_where_full(csr_array(block_array(rows)))


def _total(parts: Sequence[Matrix]) -> Matrix:
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    return total


def _matrix(values: Floats, row: Ints, column: Ints, shape: tuple[int, int]) -> Matrix:
    """A matrix of values, those at one place summed, sparse where it is large."""
    if shape[0] * shape[1] < _DENSE:
        return np.asarray(np.bincount(row * shape[1] + column, values, shape[0] * shape[1]), float).reshape(shape)
    from scipy.sparse import coo_array

    return dense_where_full(coo_array((values, (row, column)), shape=shape).tocsr())
