"""The lens that is handed out: the model that comes nearest to the lens with what it leaves over.

The smooth remainder of a lens and its model share what both can draw. As far as the model can follow the remainder
where corners were seen, with the rectangles' poses following as far as other cameras let them, it takes it over: who
has the model alone then misses least.
"""

from dataclasses import dataclass

import numpy as np

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
    model, ties = _model(joint), joint.bordered.border.units.sum(axis=0).reshape(units, size, -1)
    fields = joint.bordered.border.information.sum(axis=0)
    taken = np.zeros((units, size, len(joint.values)))
    remainder = np.zeros(cameras)
    for camera in range(cameras):
        free, own = np.flatnonzero(joint.reduced.free[camera, : len(columns)]), rows[camera]
        prior = joint.free.information[camera][np.ix_(columns[free], columns[free])]
        both, across = model[camera][np.ix_(free, free)], ties[camera][np.ix_(free, own)]
        share = np.linalg.solve(both, across)
        taken[camera][np.ix_(free, own)] = share
        values = joint.values[own]
        step = share @ values
        lens[camera, columns[free]] += step
        left = values @ fields[np.ix_(own, own)] @ values - 2 * step @ across @ values + step @ (both - prior) @ step
        remainder[camera] = np.sqrt(max(left, 0.0) / max(_weights(joint, camera), np.finfo(float).tiny))
    by_unit = joint.bordered.by_unit + taken.reshape(units * size, -1) @ joint.bordered.root
    return DeliveredLenses(lens, by_unit, remainder)


def _model(joint: Joint) -> Floats:
    """What the corners and the priors say of each camera's lens (C, K, K), where rectangles' poses follow it as far
    as other cameras let them."""
    lens, diagonal = len(joint.adjustment.columns), joint.reduced.left == joint.reduced.right
    model = np.zeros((len(joint.reduced.free), lens, lens))
    model[joint.reduced.left[diagonal]] = joint.reduced.blocks[diagonal, :lens, :lens]
    return model


def _weights(joint: Joint, camera: int) -> float:
    """Weights of both coordinates of a camera's corners, 1/px^2."""
    groups = joint.observations.groups
    return 2 * float(sum(group.weights[group.camera == camera].sum() for group in groups)) / joint.noise**2
