"""Solve the normal equations: poses of bodies eliminated in 6x6 batches, the rest dense or banded.

The rest are units of M unknowns each: cameras, and rectangles' poses on their bodies that are to be found."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quadrig.rig.adjustment.block_band import BlockBand
from quadrig.rig.adjustment.normal_equations import Normal
from quadrig.rig.adjustment.tables import Tables
from quadrig.single.arrays import Floats, Ints, Mask

if TYPE_CHECKING:
    import scipy.sparse

# Added to the diagonal of each 6x6 block (1/rad^2, 1/m^2): far below any information a View carries, and enough to
# invert the block of a pose all of whose points were rejected.
_EMPTY_NODE = 1e-9
# A banded factorisation costs n b^2 against n^3 / 3: below this share of the size the band wins in practice, since
# dense blocks run on matrix products.
_BAND_SHARE = 0.2
# Beyond so many places for every pair of unit and body's pose that met, zeros cost more than they save.
_MOST_EMPTY = 4
# Above this share of elements that are not zero dense products are quicker: each element takes a tenth of the time.
_FULL = 0.1
# Below this many unknowns the dense factorisation takes no time worth saving.
_SMALL_SYSTEM = 400


@dataclass(frozen=True, eq=False)
class Reduced:
    """The system over the units: blocks (B, M, M) at (block_left <= block_right), right-hand side (E, M).

    free (E, M): which unknowns are estimated. node_inverse (N, 6, 6): zero for a node that stands fixed.
    """

    blocks: Floats
    left: Ints
    right: Ints
    gradient: Floats
    free: Mask
    node_inverse: Floats


def eliminate(normal: Normal, tables: Tables, free: Mask, free_nodes: Mask, damping: float = 0.0) -> Reduced:
    """Schur complement on the units. damping: share of each diagonal element that is added to it (Marquardt)."""
    inverse = node_inverses(normal, damping)
    inverse[~free_nodes] = 0.0
    through = normal.pairs @ inverse[tables.pair_node]
    blocks = -_met(through, normal, tables, len(free))
    diagonal = tables.diagonal
    blocks[diagonal] += _damped(normal.units, damping)[tables.block_left[diagonal]]
    blocks[tables.tie_block] += normal.ties
    pulled = (through @ normal.node_gradient[tables.pair_node][..., None])[..., 0]
    gradient = normal.unit_gradient - tables.pair_by_unit(pulled)
    return Reduced(blocks, tables.block_left, tables.block_right, gradient, free, inverse)


def _met(through: Floats, normal: Normal, tables: Tables, units: int) -> Floats:
    """Blocks (B, M, M): what the poses of bodies tie every two units together with."""
    nodes, (count, size, _) = len(normal.nodes), normal.pairs.shape
    if units * nodes > _MOST_EMPTY * count:
        meeting = through[tables.meeting_left] @ np.swapaxes(normal.pairs[tables.meeting_right], -1, -2)
        return tables.meeting_by_block(meeting)
    # Where most cameras see most bodies one large product, zeros and all, is quicker than many small ones.
    left, right = np.zeros((2, units, size, nodes, 6))
    left[tables.pair_unit, :, tables.pair_node] = through
    right[tables.pair_unit, :, tables.pair_node] = normal.pairs
    product = left.reshape(units * size, -1) @ right.reshape(units * size, -1).T
    return product.reshape(units, size, units, size)[tables.block_left, :, tables.block_right]


def node_inverses(normal: Normal, damping: float = 0.0) -> Floats:
    """Inverses (N, 6, 6) of the bodies' own blocks: covariances of their poses, were all units known."""
    return np.asarray(np.linalg.inv(_damped(normal.nodes, damping) + _EMPTY_NODE * np.eye(6)), float)


def _damped(blocks: Floats, damping: float) -> Floats:
    if damping == 0:
        return blocks
    return blocks * (1 + damping * np.eye(blocks.shape[-1]))


def solve_units(reduced: Reduced) -> Floats:
    """The steps (E, M) of the units. Raises numpy.linalg.LinAlgError where they are not determined."""
    return solve_for(reduced, np.where(reduced.free, reduced.gradient, 0.0).ravel()).reshape(reduced.free.shape)


def solve_for(reduced: Reduced, right: Floats) -> Floats:
    """The reduced system solved for right-hand sides (E M,) or (E M, R)."""
    band = band_order(reduced)
    return _solve_dense(reduced, right) if band is None else _solve_banded(reduced, right, *band)


def node_steps(normal: Normal, tables: Tables, reduced: Reduced, unit_steps: Floats) -> Floats:
    """The steps (N, 6) of the bodies' poses that go with steps of the units."""
    pulled = (np.swapaxes(normal.pairs, -1, -2) @ unit_steps[tables.pair_unit][..., None])[..., 0]
    gradient = normal.node_gradient - tables.pair_by_node(pulled)
    return (reduced.node_inverse @ gradient[..., None])[..., 0]


def dense_matrix(reduced: Reduced) -> Floats:
    """The reduced matrix (E M, E M); rows and columns that are not free are those of the unit matrix."""
    matrix = _dense(reduced.blocks, reduced.left, reduced.right, len(reduced.free))
    free = reduced.free.ravel()
    matrix[~free] = 0.0
    matrix[:, ~free] = 0.0
    matrix[~free, ~free] = 1.0
    return matrix


def _dense(blocks: Floats, left: Ints, right: Ints, units: int) -> Floats:
    size = blocks.shape[-1]
    matrix = np.zeros((units, size, units, size))
    matrix[left, :, right, :] = blocks
    matrix[right, :, left, :] = np.swapaxes(blocks, -1, -2)
    return matrix.reshape(units * size, units * size)


def block_matrix(blocks: Floats, left: Ints, right: Ints, units: int) -> "Floats | scipy.sparse.csr_array":
    """The symmetric matrix (E M, E M) of blocks (B, M, M) at (left <= right), sparse where it is large."""
    size = blocks.shape[-1]
    if units * size < _SMALL_SYSTEM:
        return _dense(blocks, left, right, units)
    from scipy.sparse import coo_array

    off = left != right
    values = np.concatenate([blocks, np.swapaxes(blocks[off], -1, -2)])
    row = np.concatenate([left, right[off]])[:, None, None] * size + np.arange(size)[:, None]
    column = np.concatenate([right, left[off]])[:, None, None] * size + np.arange(size)
    at = [axis.ravel() for axis in np.broadcast_arrays(row, column)]
    return dense_where_full(coo_array((values.ravel(), at), shape=(units * size, units * size)).tocsr())


def dense_where_full(matrix: "scipy.sparse.csr_array") -> "Floats | scipy.sparse.csr_array":
    """The matrix as it is, or with all its zeros where these are few."""
    return matrix.toarray() if matrix.nnz > _FULL * float(np.prod(np.array(matrix.shape))) else matrix


def _solve_dense(reduced: Reduced, right: Floats) -> Floats:
    # LAPACK itself: of a small system scipy's wrappers take longer than the work.
    from scipy.linalg import get_lapack_funcs

    free, solution = np.flatnonzero(reduced.free), np.zeros_like(right)
    if not len(free):
        return solution
    matrix = _dense(reduced.blocks, reduced.left, reduced.right, len(reduced.free))
    if len(free) < len(matrix):
        matrix = matrix[np.ix_(free, free)]
    scale = 1 / np.sqrt(np.maximum(np.diagonal(matrix), np.finfo(float).tiny))
    of_right = scale if right.ndim == 1 else scale[:, None]
    (solve,) = get_lapack_funcs(("posv",), (matrix,))
    _, solved, failed = solve(matrix * scale * scale[:, None], right[free] * of_right, lower=1)
    if failed:
        raise np.linalg.LinAlgError("the reduced system is not positive definite")
    solution[free] = solved * of_right
    return solution


def band_order(reduced: Reduced) -> tuple[Ints, int] | None:
    """An order of units that keeps who meets whom near the diagonal, and its width; None where dense is as good."""
    units, size = reduced.free.shape
    if units * size < _SMALL_SYSTEM:
        return None
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    left, right = np.concatenate([reduced.left, reduced.right]), np.concatenate([reduced.right, reduced.left])
    graph = coo_array((np.ones(len(left)), (left, right)), shape=(units, units)).tocsr()
    rank = np.empty(units, int)
    rank[reverse_cuthill_mckee(graph, symmetric_mode=True)] = np.arange(units)
    width = int(np.abs(rank[reduced.left] - rank[reduced.right]).max())
    return (rank, width) if width < _BAND_SHARE * units else None


def _solve_banded(reduced: Reduced, right: Floats, rank: Ints, width: int) -> Floats:
    from scipy.linalg import solveh_banded

    units, size = reduced.free.shape
    band = np.zeros(((width + 1) * size, units * size))
    swap = rank[reduced.left] < rank[reduced.right]
    low = np.where(swap, rank[reduced.right], rank[reduced.left])
    high = np.where(swap, rank[reduced.left], rank[reduced.right])
    masked = reduced.blocks * reduced.free[reduced.left][:, :, None] * reduced.free[reduced.right][:, None, :]
    blocks = np.where(swap[:, None, None], np.swapaxes(masked, -1, -2), masked)
    row = low[:, None, None] * size + np.arange(size)[:, None]
    column = high[:, None, None] * size + np.arange(size)
    row, column = np.broadcast_arrays(row, column)
    lower = row >= column
    band[(row - column)[lower], column[lower]] = blocks[lower]
    index = (rank[:, None] * size + np.arange(size)).ravel()
    band[0, index[~reduced.free.ravel()]] = 1.0
    scale = 1 / np.sqrt(np.maximum(band[0], np.finfo(float).tiny))
    for offset in range(len(band)):
        band[offset, : band.shape[1] - offset] *= scale[offset:] * scale[: band.shape[1] - offset]
    ordered = np.zeros_like(right)
    ordered[index] = right
    column_scale = scale if right.ndim == 1 else scale[:, None]
    solution = solveh_banded(band, ordered * column_scale, lower=True, overwrite_ab=True, check_finite=False)
    return (solution * column_scale)[index]


def unit_covariances(reduced: Reduced) -> Floats:
    """Of the inverse of the reduced matrix the blocks (E, M, M) of each unit with itself; zero where not free."""
    units, size = reduced.free.shape
    if band_order(reduced) is None:
        return own_blocks(reduced_inverse(reduced), units)
    rows = np.arange(units * size).reshape(units, size)
    return reduced_band(reduced).elements(rows[:, :, None], rows[:, None])


def own_blocks(matrix: Floats, units: int) -> Floats:
    """The blocks (E, M, M) on the diagonal of a matrix (E M, E M)."""
    blocks, every = matrix.reshape(units, len(matrix) // units, units, -1), np.arange(units)
    return blocks[every, :, every]


def reduced_band(reduced: Reduced) -> BlockBand:
    """The reduced matrix factorised in its band."""
    from scipy.sparse import csr_array

    free = reduced.free.ravel()
    matrix = csr_array(block_matrix(reduced.blocks, reduced.left, reduced.right, len(reduced.free)))
    return BlockBand.of(matrix, free, np.zeros(len(free), bool))


def reduced_inverse(reduced: Reduced) -> Floats:
    """Inverse (E M, E M) of the reduced matrix: the covariance of the units; zero where not free."""
    inverse = solve_for(reduced, np.diag(reduced.free.ravel().astype(float)))
    return (inverse + inverse.T) / 2
