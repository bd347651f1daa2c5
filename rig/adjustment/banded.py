"""The adjustment with systematic errors of many cameras that each share with a few: nothing of all by all is made.

Units and errors stand in one system, in the order in which they are tied; steps, and the covariances of what shares
Views, take time and memory that grow with the number of cameras.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from quadrig.rig.adjustment.block_band import BlockBand
from quadrig.rig.adjustment.bordered import Border, Bordered, Matrix
from quadrig.rig.adjustment.levenberg_marquardt import Adjustment
from quadrig.rig.adjustment.schur import (
    Reduced,
    band_order,
    block_matrix,
    node_steps,
    reduced_band,
    reduced_inverse,
)
from quadrig.rig.adjustment.state import LENS
from quadrig.rig.adjustment.systematic_errors import SystematicErrors
from quadrig.single.arrays import Floats, Ints, Mask

if TYPE_CHECKING:
    import scipy.sparse

# Columns of a large covariance that are made at a time: matrix products are no quicker with more.
_COLUMNS_AT_ONCE = 512
# Poses of bodies whose covariances are made at a time.
_NODES_AT_ONCE = 5000


def is_banded(reduced: Reduced) -> bool:
    """Whether the units can be ordered so that it pays."""
    return band_order(reduced) is not None


@dataclass(frozen=True, eq=False)
class System:
    """The normal equations (T, T) of units, then errors, then one unknown more, of variance one before anything is
    seen: what the prior of the errors has in common. free (T,): which are estimated."""

    matrix: "scipy.sparse.csr_array"
    free: Mask

    @staticmethod
    def of(
        reduced: Reduced, ties: Matrix, information: Matrix, errors: SystematicErrors, shown: Mask | None = None
    ) -> "System":
        """ties (E M, U), information (U, U): as Border has them. shown (U,): which errors take part, all if None."""
        from scipy.sparse import block_array, csr_array, diags_array

        units = block_matrix(reduced.blocks, reduced.left, reduced.right, len(reduced.free))
        own, common = csr_array(information) + diags_array(errors.held), csr_array(-errors.common[:, None])
        across = csr_array(ties)
        rows = [[csr_array(units), across, None], [across.T, own, common], [None, common.T, csr_array([[1.0]])]]
        shown = np.ones(len(errors.held), bool) if shown is None else shown
        return System(csr_array(block_array(rows)), np.concatenate([reduced.free.ravel(), shown, [True]]))

    def factorised(self, change: "scipy.sparse.csr_array | None" = None, terms: int = 1) -> BlockBand:
        """The factors, of a series in the change (T - 1, T - 1) where there is one."""
        from scipy.sparse import csr_array

        last = np.zeros(len(self.free), bool)
        last[-1] = True
        if change is not None:
            # What is common to all errors is in no View.
            rows = np.append(change.indptr, change.indptr[-1])
            change = csr_array((change.data, change.indices, rows), shape=self.matrix.shape)
        return BlockBand.of(self.matrix, self.free, last, change, terms)

    def solution(self, band: BlockBand, right: Floats) -> Floats:
        """For right-hand sides (T - 1, ..) of units and errors."""
        return band.solve(np.concatenate([right, np.zeros_like(right[:1])]))[:-1]


@dataclass(frozen=True, eq=False)
class BandBordered(Bordered):
    """The same, what is asked for made of the factors. astray (E M + U,): one independent error more, by which all
    may be off together."""

    reduced: Reduced
    system: System
    band: BlockBand
    astray: Floats

    @property
    def firm(self) -> Floats:
        """The covariance (E M, E M) of the units, were the errors known."""
        return reduced_inverse(self.reduced)

    def with_step_in_doubt(self) -> "BandBordered":
        """The same with one independent error more, as large as the step."""
        return replace(self, astray=np.concatenate([self.unit_steps.ravel(), self.step]))

    def _elements(self, index: Ints) -> Floats:
        """The covariances (K, J, J) of the unknowns at (K, J), those that share Views in each."""
        own = self.astray[index]
        return self.band.elements(index[:, :, None], index[:, None]) + own[:, :, None] * own[:, None]

    def lens_covariances(self, found: Adjustment) -> Floats:
        """(C, 9, 9) of each camera's lens."""
        cameras, columns = len(found.state.lens), found.columns
        rows = np.arange(cameras)[:, None] * self.unit_steps.shape[1] + np.arange(len(columns))
        result = np.zeros((cameras, LENS, LENS))
        result[:, columns[:, None], columns] = self._elements(rows)
        return result

    def error_covariances(self, rows: Ints) -> Floats:
        """Covariances (K, J, J) of the errors at rows (K, J), those of one sheet in each."""
        return self._elements(self.unit_steps.size + rows)

    def error_products(self, vector: Floats) -> Floats:
        """The covariance of the errors, times a vector (U,)."""
        first, own = self.unit_steps.size, self.astray[self.unit_steps.size :]
        firm = self.system.solution(self.band, np.concatenate([np.zeros(first), vector]))[first:]
        return firm + own * (own @ vector)

    def columns(self, chosen: Ints) -> Floats:
        """The columns (E M + U, K) of the covariance of units and errors at those (K,)."""
        right = np.zeros((len(self.system.free) - 1, len(chosen)))
        right[chosen, np.arange(len(chosen))] = 1.0
        return self.system.solution(self.band, right) + np.outer(self.astray, self.astray[chosen])

    def node_covariances(self, found: Adjustment, reduced: Reduced) -> Floats:
        """Covariance (N, 6, 6) of the twist of every pose of a body."""
        result = reduced.node_inverse.copy()
        for nodes, index, follows in self._followed(found, reduced):
            # Many poses follow the same cameras and sheets.
            alike, which = np.unique(index, axis=0, return_inverse=True)
            own = self._elements(alike)[which.ravel()]
            result[nodes] += follows @ own @ np.swapaxes(follows, 1, 2)
        return result

    def _followed(self, found: Adjustment, reduced: Reduced) -> Iterator[tuple[Ints, Ints, Floats]]:
        """Some nodes (N',), the unknowns (N', K) that they follow, and how their twists do (N', 6, K)."""
        from scipy.sparse import coo_array

        tables, (units, size) = found.tables, reduced.free.shape
        count, unknowns = len(reduced.node_inverse), len(self.values)
        by_unit = reduced.node_inverse[tables.pair_node] @ np.swapaxes(found.normal.pairs, 1, 2)
        passed = coo_array(self.border.passed)
        key, at = np.unique(passed.row // 6 * unknowns + passed.col, return_inverse=True)
        by_error = np.zeros((len(key), 6))
        by_error[at, passed.row % 6] = passed.data
        number = np.stack([np.bincount(each, minlength=count) for each in (tables.pair_node, key // unknowns)], 1)
        begin = np.cumsum(number, axis=0) - number
        for pairs, errors in np.unique(number, axis=0):
            every = np.flatnonzero((number == [pairs, errors]).all(axis=1))
            for some in range(0, len(every), _NODES_AT_ONCE):
                nodes = every[some : some + _NODES_AT_ONCE]
                of_pair, of_error = (
                    begin[nodes, kind, None] + np.arange(length) for kind, length in enumerate((pairs, errors))
                )
                own = tables.pair_unit[of_pair][:, :, None] * size + np.arange(size)
                index = np.concatenate([own.reshape(len(nodes), -1), units * size + key[of_error] % unknowns], axis=1)
                follows = by_unit[of_pair].transpose(0, 2, 1, 3).reshape(len(nodes), 6, -1)
                yield nodes, index, np.concatenate([follows, by_error[of_error].transpose(0, 2, 1)], axis=2)

    def widened(self, gradient: "Matrix | None", taken: Floats | None) -> Floats:
        """The covariance (E M, E M) of the units with another one of their gradient, moved by taken (E M, U)."""
        from scipy.sparse import csr_array, eye_array, hstack

        total, firm = self.unit_steps.size, reduced_band(self.reduced)
        moved = csr_array((total, len(self.values)) if taken is None else taken)
        # What is delivered, of units and errors.
        chosen = csr_array(hstack([eye_array(total), moved]))
        astray, result = chosen @ self.astray, np.empty((total, total))
        for begin in range(0, total, _COLUMNS_AT_ONCE):
            run = np.arange(begin, min(begin + _COLUMNS_AT_ONCE, total))
            result[:, run] = chosen @ self.system.solution(self.band, chosen[run].toarray().T)
            result[:, run] += np.outer(astray, astray[run])
            if gradient is not None:
                right = np.zeros((total, len(run)))
                right[run, run - begin] = 1.0
                without = firm.solve(right)
                result[:, run] += firm.solve(gradient @ without) - without
        return _symmetric(result)


def _symmetric(matrix: Floats) -> Floats:
    """The same matrix, which rounding left not quite symmetric, made so where it stands."""
    for begin in range(0, len(matrix), _COLUMNS_AT_ONCE):
        end = min(begin + _COLUMNS_AT_ONCE, len(matrix))
        mean = (matrix[begin:end, begin:] + matrix[begin:, begin:end].T) / 2
        matrix[begin:end, begin:], matrix[begin:, begin:end] = mean, mean.T
    return matrix


def solve_in_band(
    border: Border, errors: SystematicErrors, values: Floats, found: Adjustment, reduced: Reduced
) -> BandBordered:
    """What solve_bordered does, of a system that is_banded."""
    system = System.of(reduced, border.all_units, border.all_information, errors)
    band = system.factorised()
    gradient = np.where(reduced.free, reduced.gradient, 0.0).ravel()
    pulled = border.gradient.sum(axis=0) - errors.pull(values)
    right = np.concatenate([gradient, pulled])
    solved = system.solution(band, right)
    steps, step = solved[: reduced.free.size].reshape(reduced.free.shape), solved[reduced.free.size :]
    poses = node_steps(found.normal, found.tables, reduced, steps) - (border.passed @ step).reshape(-1, 6)
    node_pull = found.normal.node_gradient
    of_nodes = float((node_pull[:, None] @ reduced.node_inverse @ node_pull[..., None]).sum())
    rows = reduced.free.size + np.arange(len(step) + 1)
    variances = band.elements(rows, rows)
    # What the errors' prior has in common is as unsure as it was, and as what the errors say of it.
    held = float(errors.held @ variances[:-1]) - (variances[-1] - 1)
    return BandBordered(
        values + step,
        step,
        steps,
        poses,
        border,
        float(right @ solved) + of_nodes,
        len(values) - held,
        reduced,
        system,
        band,
        np.zeros(len(right)),
    )
