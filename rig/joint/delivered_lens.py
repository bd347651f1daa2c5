"""The lens that is handed out: the model that comes nearest to the lens with what it leaves over.

The smooth remainder of a lens and its model share what both can draw. As far as the model can follow the remainder
where corners were seen, it takes it over: who has the model alone then misses least. Of a camera by itself the
rectangles' poses follow too, since they are nothing but what its lens makes of them; in a rig others rely on them.
"""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.adjustment.bordered import dense
from quadrig.rig.joint.stages import Joint
from quadrig.single.arrays import Floats


@dataclass(frozen=True, eq=False)
class DeliveredLenses:
    """lens (C, 9): handed out. taken (E M, U): by how much each error moves them, None where no remainder was looked
    for. remainder (C,) px: of a coordinate, root mean square over the corners, what they leave over; then nan."""

    lens: Floats
    taken: Floats | None
    remainder: Floats


def delivered_lenses(joint: Joint) -> DeliveredLenses:
    """The lenses of a joint adjustment with their remainders taken over as far as their models can."""
    cameras, (units, size) = len(joint.errors.lens_rows), joint.reduced.free.shape
    columns, rows = joint.adjustment.columns, joint.errors.lens_rows
    lens = joint.adjustment.state.lens.copy()
    if not rows.size:
        return DeliveredLenses(lens, None, np.full(len(lens), np.nan))
    sums, known = _sums(joint), joint.free.information[:, columns[:, None], columns]
    taken = np.zeros((units, size, len(joint.values)))
    remainder = np.zeros(cameras)
    for camera in range(cameras):
        free, own = np.flatnonzero(joint.reduced.free[camera, : len(columns)]), rows[camera]
        model, across = sums[camera][np.ix_(free, free)], sums[camera][free, len(columns) :]
        share = np.linalg.solve(model + known[camera][np.ix_(free, free)], across)
        taken[camera][np.ix_(free, own)] = share
        values = joint.values[own]
        step = share @ values
        lens[camera, columns[free]] += step
        field = sums[camera][len(columns) :, len(columns) :]
        left = values @ field @ values - 2 * step @ across @ values + step @ model @ step
        remainder[camera] = np.sqrt(max(left, 0.0) / max(_weights(joint, camera), np.finfo(float).tiny))
    return DeliveredLenses(lens, taken.reshape(units * size, -1), remainder)


def _sums(joint: Joint) -> Floats:
    """What the corners say (C, K + 2 B, K + 2 B) of each camera's lens and of its remainder: in a rig where its pose
    and the rectangles' stand; of one camera alone, whose poses are its lens's, where they follow."""
    border, lens = joint.bordered.border, len(joint.adjustment.columns)
    if len(border.lenses) > 1:
        return border.lenses
    rows = joint.errors.lens_rows[0]
    across = dense(border.all_units)[:lens, rows]
    model = joint.reduced.blocks[0][:lens, :lens] - joint.free.information[0][np.ix_(*[joint.adjustment.columns] * 2)]
    return np.block([[model, across], [across.T, dense(border.all_information)[np.ix_(rows, rows)]]])[None]


def _weights(joint: Joint, camera: int) -> float:
    """Weights of both coordinates of a camera's corners, 1/px^2."""
    groups = joint.observations.groups
    return 2 * float(sum(group.weights[group.camera == camera].sum() for group in groups)) / joint.noise**2
