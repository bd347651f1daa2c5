"""Which Views share cameras, poses of bodies and poses of rectangles on bodies: the sums of the normal equations."""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.problem.observations import Observations
from quadrig.single.arrays import Floats, Ints


@dataclass(frozen=True, eq=False)
class Tables:
    """Who meets whom, worked out once for a set of Views.

    A unit is a camera, or a rectangle's pose on its body that is to be found; those come after all cameras. A row is
    a View with its camera, or, after all of those, one of the `loose` (W,) Views with its rectangle's pose. A pair
    is a (node, unit) that share rows; a meeting is two pairs of one node, hence two units that the node ties
    together; a block is where the meetings of two units are summed, on the diagonal where they are one. A tie is a
    camera and a rectangle's pose that share Views, and stands in the block tie_block (T,).
    camera (V,), layout (W,): the unit of each View's camera, and of each loose View's rectangle.
    Sums over equal keys run along sorted orders (np.add.reduceat).
    """

    units: int
    camera: Ints
    loose: Ints
    layout: Ints
    row_by_unit: "Sum"
    view_by_node: "Sum"
    row_by_pair: "Sum"
    loose_by_tie: "Sum"
    tie_block: Ints
    pair_node: Ints
    pair_unit: Ints
    pair_by_node: "Sum"
    pair_by_unit: "Sum"
    meeting_left: Ints
    meeting_right: Ints
    meeting_by_block: "Sum"
    block_left: Ints
    block_right: Ints
    diagonal: Ints


@dataclass(frozen=True, eq=False)
class Sum:
    """Sums rows that carry one key: result[keys] = sum of rows; `total` rows in all."""

    order: Ints
    starts: Ints
    keys: Ints
    total: int

    @staticmethod
    def over(key: Ints, total: int | None = None) -> "Sum":
        """Sums over equal keys (R,); total: how many there may be, where those without rows count as zero."""
        order = np.argsort(key, kind="stable")
        ordered = key[order]
        starts = np.flatnonzero(np.diff(ordered, prepend=-1))
        keys = ordered[starts]
        return Sum(order, starts, keys, len(keys) if total is None else total)

    def compact(self) -> "Sum":
        """The same sums one after another, keys left out."""
        return Sum(self.order, self.starts, np.arange(len(self.keys)), len(self.keys))

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


def tables_of(observations: Observations, fold: Ints | None = None) -> Tables:
    """Work out the sums of a set of Views. fold (V,): of each View; then every fold has a copy of all units for
    itself, one after another."""
    joins = observations.joins
    count = joins.cameras + joins.found
    first = np.zeros_like(joins.node) if fold is None else fold * count
    units = count * (int(first.max(initial=0)) // max(count, 1) + 1)
    loose = np.flatnonzero((joins.layout >= 0) & (joins.layout < joins.found))
    camera, layout = first + joins.camera, (first + joins.cameras + joins.layout)[loose]
    unit = np.concatenate([camera, layout])
    by_pair = Sum.over(np.concatenate([joins.node, joins.node[loose]]) * units + unit)
    pair_node, pair_unit = np.divmod(by_pair.keys, units)
    left, right = _meetings(pair_node)
    blocks = Sum.over(pair_unit[left] * units + pair_unit[right])
    block = np.divmod(blocks.keys, units)
    ties = Sum.over(camera[loose] * units + layout)
    return Tables(
        units,
        camera,
        loose,
        layout,
        Sum.over(unit, units),
        Sum.over(joins.node, joins.nodes),
        by_pair.compact(),
        ties.compact(),
        np.searchsorted(blocks.keys, ties.keys),
        pair_node,
        pair_unit,
        Sum.over(pair_node, joins.nodes),
        Sum.over(pair_unit, units),
        left,
        right,
        blocks.compact(),
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
