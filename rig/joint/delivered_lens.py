"""The lens that is handed out: the model that comes nearest to the lens with what it leaves over.

The smooth remainder of a lens and its model share what both can draw. As far as the model can follow the remainder
where corners were seen, it takes it over: who has the model alone then misses least.
"""

from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.adjustment.bordered import extended_grams
from quadrig.rig.adjustment.normal_equations import chain_derivatives
from quadrig.rig.joint.stages import Joint
from quadrig.single.arrays import Floats


@dataclass(frozen=True, eq=False)
class DeliveredLenses:
    """lens (C, 9): handed out. by_unit (E M, U): as Bordered.by_unit has it, of these lenses. remainder (C,) px:
    of a coordinate, root mean square over the corners, what they leave over; nan where no remainder was looked
    for."""

    lens: Floats
    by_unit: Floats
    remainder: Floats


def delivered_lenses(joint: Joint) -> DeliveredLenses:
    """The lenses of a joint adjustment with their remainders taken over as far as their models can."""
    cameras, (units, size) = len(joint.errors.lens_rows), joint.reduced.free.shape
    columns, rows = joint.adjustment.columns, joint.errors.lens_rows
    lens = joint.adjustment.state.lens.copy()
    if not rows.size:
        return DeliveredLenses(lens, joint.bordered.by_unit, np.full(len(lens), np.nan))
    model, across, field, weight = _sums(joint)
    taken = np.zeros((units, size, len(joint.values)))
    remainder = np.zeros(cameras)
    for camera in range(cameras):
        free = np.flatnonzero(joint.reduced.free[camera, : len(columns)])
        prior = joint.free.information[camera][np.ix_(columns[free], columns[free])]
        share = np.linalg.solve(model[camera][np.ix_(free, free)] + prior, across[camera][free])
        taken[camera][np.ix_(free, rows[camera])] = share
        own = joint.values[rows[camera]]
        step = share @ own
        lens[camera, columns[free]] += step
        left = own @ field[camera] @ own - 2 * step @ across[camera][free] @ own
        left += step @ model[camera][np.ix_(free, free)] @ step
        remainder[camera] = np.sqrt(max(left, 0.0) / max(weight[camera], np.finfo(float).tiny))
    by_unit = joint.bordered.by_unit + taken.reshape(units * size, -1) @ joint.bordered.root
    return DeliveredLenses(lens, by_unit, remainder)


def _sums(joint: Joint) -> tuple[Floats, Floats, Floats, Floats]:
    """Weighted sums over each camera's corners: of the lens's derivatives (C, K, K), of them with the remainder's
    functions (C, K, 2 B), of those (C, 2 B, 2 B), and of the weights of both coordinates (C,). A rectangle's pose
    that one camera alone sees follows its lens; where others hold it, it stays."""
    observations, (cameras, fields) = joint.observations, joint.errors.lens_rows.shape
    lens = len(joint.adjustment.columns)
    size = lens + fields
    sums, weight = np.zeros((cameras, size, size)), np.zeros(cameras)
    ties, own = np.zeros((observations.nodes, size, 6)), np.zeros((observations.nodes, 6, 6))
    _, by_node = chain_derivatives(observations, joint.adjustment.state)
    firm = replace(joint.free, slack=None)
    for part, gram, index in extended_grams(joint.errors, observations, joint.adjustment, firm, joint.noise):
        kept = np.r_[:lens, lens + index.shape[1] - fields : lens + index.shape[1]]
        np.add.at(sums, part.camera, gram[:, kept[:, None], kept])
        np.add.at(ties, part.node, gram[:, kept, -7:-1] @ by_node[part.view])
        by_pose = by_node[part.view]
        np.add.at(own, part.node, np.swapaxes(by_pose, 1, 2) @ gram[:, -7:-1, -7:-1] @ by_pose)
        np.add.at(weight, part.camera, 2 * part.weights.sum(axis=1) / joint.noise**2)
    first, seen_by = np.unique(joint.adjustment.layout.pair_node, return_index=True, return_counts=True)[1:]
    node, camera = (at[first][seen_by == 1] for at in (joint.adjustment.layout.pair_node, joint.adjustment.layout.pair_camera))
    follows = joint.free.node[node] & (np.linalg.eigvalsh(own[node])[:, 0] > 0)
    node, camera = node[follows], camera[follows]
    followed = ties[node] @ np.linalg.solve(own[node], np.swapaxes(ties[node], 1, 2))
    np.subtract.at(sums, camera, followed)
    return sums[:, :lens, :lens], sums[:, :lens, lens:], sums[:, lens:, lens:], weight
