"""Matrices whose unknowns can be ordered so that those that are tied stand near: solved, and inverted where they are.

The inverse of such a matrix is full, but its elements where the matrix has its own follow from the factors alone
(Takahashi, Fagan and Chin 1973; Erisman and Tinney 1975), in time that grows with the number of unknowns.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask

if TYPE_CHECKING:
    import scipy.sparse

# An unknown that is tied to so many times as many others as most are would widen the band for all.
_TIED_TO_ALL = 4


@dataclass(frozen=True, eq=False)
class BlockBand:
    """A symmetric, positive definite matrix (T, T), factorised; or how its inverse changes as it does, as a series.

    place (T,): where each unknown stands, -1 for those that are left out. Those that are tied to most others stand
    last, G of them; those before are cut into K blocks of b, each tied to the next alone. scale (K b + G,): what they
    are multiplied by, so that the diagonal is one.
    The matrix is M + e E, and all is a series of S terms in e: inverses (S, K, b, b) of the blocks once those before
    are eliminated; through (S, K, b, b + G): those, times what ties each to the next and the last; last (S, G, G):
    inverse of what is left of the last.
    """

    place: Ints
    scale: Floats
    inverses: Floats
    through: Floats
    last: Floats

    @staticmethod
    def of(
        matrix: "scipy.sparse.csr_array",
        free: Mask,
        last: Mask,
        change: "scipy.sparse.csr_array | None" = None,
        terms: int = 1,
    ) -> "BlockBand":
        """free (T,): which unknowns take part; last (T,): which of them stand last in any case. change (T, T): E
        above. Raises numpy.linalg.LinAlgError where the matrix is not positive definite."""
        place, size, count = _order(matrix, free, last)
        diagonal = np.ones(max(size * count, int(place.max(initial=-1)) + 1))
        diagonal[place[free]] = matrix.diagonal()[free]
        if not (diagonal > 0).all():
            raise np.linalg.LinAlgError("the matrix is not positive definite")
        scale = 1 / np.sqrt(diagonal)
        parts = [_cut(matrix, place, scale, size, count)]
        # Where blocks are longer than what stands in them, the rest of the diagonal is one.
        empty = np.ones(size * count, bool)
        empty[place[free & (place < size * count)]] = False
        at = np.flatnonzero(empty)
        parts[0][0][at // size, at % size, at % size] = 1.0
        if change is not None:
            parts.append(_cut(change, place, scale, size, count))
        own, after, arrow, corner = (_padded(np.stack(each), terms) for each in zip(*parts, strict=True))
        return BlockBand(place, scale, *_factorised(own, after, arrow, corner))

    def solve(self, right: Floats) -> Floats:
        """The solution of the matrix itself for right-hand sides (T,) or (T, R); zero for what is left out."""
        among, (count, size) = self.place >= 0, self.inverses.shape[1:3]
        inside = self.place[among]
        by_column = right.reshape(len(right), -1)
        found = np.zeros((len(self.scale), by_column.shape[1]))
        found[inside] = by_column[among] * self.scale[inside, None]
        first = count * size
        blocks, end = found[:first].reshape(count, size, -1), found[first:]
        for number, through in enumerate(self.through[0]):
            pulled = through.T @ blocks[number]
            end -= pulled[size:]
            if number + 1 < count:
                blocks[number + 1] -= pulled[:size]
        end[:] = self.last[0] @ end
        for number in reversed(range(count)):
            through = self.through[0, number]
            blocks[number] = self.inverses[0, number] @ blocks[number] - through[:, size:] @ end
            if number + 1 < count:
                blocks[number] -= through[:, :size] @ blocks[number + 1]
        found *= self.scale[:, None]
        result = np.zeros_like(by_column)
        result[among] = found[inside]
        return result.reshape(right.shape)

    def elements(self, row: Ints, column: Ints, term: int = 0) -> Floats:
        """Elements of the inverse, or of a term of its series, at rows and columns of one shape, which may stand in
        one block, in two that follow one another, or last; zero for what is left out. Raises ValueError elsewhere."""
        count, size = self.inverses.shape[1:3]
        one, other = np.broadcast_arrays(self.place[row], self.place[column])
        known = (one >= 0) & (other >= 0)
        low, high = np.minimum(one, other)[known], np.maximum(one, other)[known]
        first, own, across = count * size, self._own[term], self._across[term]
        (block, at), (to, beside) = np.divmod(low, size), np.divmod(high, size)
        ends, alike = high >= first, block == to
        if not (ends | alike | (to == block + 1)).all():
            raise ValueError("such elements of the inverse are not worked out")
        found = np.empty(len(low))
        both = ends & (low >= first)
        found[both] = self.last[term][low[both] - first, high[both] - first]
        alike &= ~ends
        found[alike] = own[block[alike], at[alike], beside[alike]]
        apart = ~alike & ~both
        beside = np.where(ends, high - first + size, beside)
        found[apart] = across[block[apart], at[apart], beside[apart]]
        result = np.zeros(one.shape)
        result[known] = found * self.scale[low] * self.scale[high]
        return result

    def times(self, matrix: "scipy.sparse.csr_array", term: int = 0) -> float:
        """The trace of the inverse, or of a term of its series, times a symmetric matrix (T, T) that has no elements
        but where this one has."""
        at = matrix.tocoo()
        return float(at.data @ self.elements(at.row, at.col, term))

    @property
    def _own(self) -> Floats:
        return self._selected[0]

    @property
    def _across(self) -> Floats:
        return self._selected[1]

    @cached_property
    def _selected(self) -> tuple[Floats, Floats]:
        """Of the inverse each block (S, K, b, b), and what it has with the next and the last (S, K, b, b + G)."""
        terms, count, size = self.through.shape[:3]
        own, across = np.empty_like(self.inverses), np.empty_like(self.through)
        later = np.zeros((terms, self.through.shape[3], self.through.shape[3]))
        later[:, size:, size:] = self.last
        for number in reversed(range(count)):
            through = self.through[:, number]
            across[:, number] = -_product(through, later)
            own[:, number] = self.inverses[:, number] - _product(across[:, number], np.swapaxes(through, 1, 2))
            later[:, :size, :size], later[:, :size, size:] = own[:, number], across[:, number, :, size:]
            later[:, size:, :size] = np.swapaxes(later[:, :size, size:], 1, 2)
        return own, across


def _order(matrix: "scipy.sparse.csr_array", free: Mask, last: Mask) -> tuple[Ints, int, int]:
    """Where each unknown stands (T,), and length and number of the blocks."""
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    tied = np.diff(matrix.indptr)
    last = free & (last | (tied > _TIED_TO_ALL * np.median(tied[free]))) if free.any() else free
    inner = np.flatnonzero(free & ~last)
    graph = matrix[inner][:, inner]
    place = np.full(len(free), -1)
    place[inner[reverse_cuthill_mckee(graph, symmetric_mode=True)]] = np.arange(len(inner))
    ties = graph.tocoo()
    away = np.abs(place[inner[ties.row]] - place[inner[ties.col]])
    # No unknown is then tied to more than the next block; blocks of a few would be many for no gain.
    size = max(int(away.max(initial=1)), 1)
    count = max(-(-len(inner) // size), 1)
    place[np.flatnonzero(last)] = size * count + np.arange(int(last.sum()))
    return place, size, count


def _cut(
    matrix: "scipy.sparse.csr_array", place: Ints, scale: Floats, size: int, count: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """The scaled matrix in blocks: on the diagonal (K, b, b), with the next (K, b, b), with the last (K, b, G), and
    of the last (G, G)."""
    ties, first = matrix.tocoo(), size * count
    row, column = place[ties.row], place[ties.col]
    chosen = (row >= 0) & (column >= row // size * size)
    row, column, value = row[chosen], column[chosen], ties.data[chosen]
    value = value * scale[row] * scale[column]
    own, after = np.zeros((2, count, size, size))
    arrow, corner = np.zeros((count, size, len(scale) - first)), np.zeros((len(scale) - first,) * 2)
    (block, at), (to, beside) = np.divmod(row, size), np.divmod(column, size)
    ends, apart = column >= first, row < first
    for part, target in ((~ends & (block == to), own), (~ends & (block != to), after)):
        target[block[part], at[part], beside[part]] = value[part]
    part = ends & apart
    arrow[block[part], at[part], column[part] - first] = value[part]
    corner[row[~apart] - first, column[~apart] - first] = value[~apart]
    return own, after, arrow, np.triu(corner) + np.triu(corner, 1).T


def _factorised(own: Floats, after: Floats, arrow: Floats, corner: Floats) -> tuple[Floats, Floats, Floats]:
    """What BlockBand holds, of series (S, ...) of what _cut says."""
    terms, count, size = own.shape[:3]
    inverses, through = np.empty_like(own), np.empty((terms, count, size, size + arrow.shape[3]))
    here, with_last = own[:, 0], arrow[:, 0]
    for number in range(count):
        ties = np.concatenate([after[:, number], with_last], axis=2)
        inverses[:, number], through[:, number], passed = _eliminated(here, ties)
        corner = corner - passed[:, size:, size:]
        if number + 1 < count:
            here = own[:, number + 1] - passed[:, :size, :size]
            with_last = arrow[:, number + 1] - passed[:, :size, size:]
    return inverses, through, _eliminated(corner, corner[:, :, :0])[0]


def _eliminated(own: Floats, ties: Floats) -> tuple[Floats, Floats, Floats]:
    """The inverse of a block (S, N, N), that times its ties (S, N, R), and what it passes on to what it is tied to
    (S, R, R)."""
    from scipy.linalg import solve_triangular

    lower = np.linalg.cholesky(own[0])
    # By halves: what the inverse loses to rounding would leave the next block not positive.
    half = solve_triangular(lower, np.eye(len(lower)), lower=True, check_finite=False)
    half_ties = solve_triangular(lower, ties[0], lower=True, check_finite=False)
    inverses, through, passed = [half.T @ half], [half.T @ half_ties], [half_ties.T @ half_ties]
    for number in range(1, len(own)):
        changed = sum(own[i] @ inverses[number - i] for i in range(1, number + 1))
        inverses.append(-inverses[0] @ changed)
        inverses[-1] = (inverses[-1] + inverses[-1].T) / 2
        follows = sum(own[i] @ through[number - i] for i in range(1, number + 1))
        through.append(inverses[0] @ (ties[number] - follows))
        passed.append(sum(ties[i].T @ through[number - i] for i in range(number + 1)))
    return np.stack(inverses), np.stack(through), np.stack(passed)


def _padded(series: Floats, terms: int) -> Floats:
    """The same series with so many terms, the further ones zero."""
    return np.concatenate([series, np.zeros((terms - len(series), *series.shape[1:]))])


def _product(left: Floats, right: Floats) -> Floats:
    """The product of two series (S, ...) of matrices."""
    terms = range(len(left))
    return np.stack([sum((left[i] @ right[n - i] for i in range(1, n + 1)), left[0] @ right[n]) for n in terms])
