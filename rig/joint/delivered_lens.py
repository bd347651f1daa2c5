"""The lens that is handed out: the model that comes nearest to the lens with what it leaves over.

The smooth remainder of a lens and its model share what both can draw. As far as the model can follow the remainder
where corners were seen, it takes it over: who has the model alone then misses least.
"""

from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.adjustment.bordered import extended_grams
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
    functions (C, K, 2 B), of those (C, 2 B, 2 B), and of the weights of both coordinates (C,)."""
    cameras, lens, fields = (
        len(joint.errors.lens_rows),
        len(joint.adjustment.columns),
        joint.errors.lens_rows.shape[1],
    )
    model, across = np.zeros((cameras, lens, lens)), np.zeros((cameras, lens, fields))
    field, weight = np.zeros((cameras, fields, fields)), np.zeros(cameras)
    firm = replace(joint.free, slack=None)
    for part, gram, index in extended_grams(joint.errors, joint.observations, joint.adjustment, firm, joint.noise):
        at = slice(lens + index.shape[1] - fields, lens + index.shape[1])
        np.add.at(model, part.camera, gram[:, :lens, :lens])
        np.add.at(across, part.camera, gram[:, :lens, at])
        np.add.at(field, part.camera, gram[:, at, at])
        np.add.at(weight, part.camera, 2 * part.weights.sum(axis=1) / joint.noise**2)
    return model, across, field, weight
