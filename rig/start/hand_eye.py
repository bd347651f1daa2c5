"""Two cameras, or groups of them, that never see one thing at one time, tied by how both move.

One sees a part of a body, the other another part: a_f = X b_f Y for every frameset f, with a_f and b_f the pose of
each part in its group, X the pose of one group in the other and Y that of one part on the other. Between two
framesets Y drops out: A X = X B (Tsai and Lenz 1989; Park and Martin 1994). Turning about one axis alone leaves open
where the groups stand along it, and turning not at all where they stand; so that is looked at, and said.
"""

from dataclasses import dataclass

import numpy as np

from quadrig.rig.start.shown_by_motion import REAL, Shown, shown_by_motion
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.pose import Pose, step_by_inner_twist, step_by_left_twist
from quadrig.single.rotation import nearest_rotation, rotation_from_vector, vector_from_rotation

# Framesets that both must share: fewer motions fix X by chance.
_FEWEST = 6
# So many framesets, spread evenly, make pairs enough.
_MOST = 150
# Of two poses of one motion the angles agree to this many of their common sigmas, else one of them is a twin.
_SAME_ANGLE = 4.0
# Rotations (rad) about a second axis that are no evidence: lenses tilt what they see by a tenth of a degree.
NO_EVIDENCE = 0.0017
# Just short of a half turn (rad), past which a rotation vector may be the other way round.
_HALF_TURN = np.pi - 0.1
# Squares of turns that are this much above those of noise are a motion.
_TURNS = 4.0
# Turns about the one axis of the motion that are tried to begin with.
_TRIED = 24
_STEPS = 30
# Residuals beyond this many of their sigmas count less and less (Cauchy).
_CAUCHY = 2.4
# Of a motion at least half of the framesets must agree with the poses found.
_MAJORITY = 0.5
_AGREES = 6.0
# Added to the normal matrix of X and Y (1/rad^2, 1/m^2): what the motion leaves open stays where it is.
_HELD = 1e-2
# Where the motion leaves open how far along its axis the groups stand, both stand level: to a millimetre (1/m^2).
_LEVEL = 1e6


@dataclass(frozen=True, eq=False)
class HandEye:
    """X = one_from_other and Y = other_part_from_part. axis (3,): unit vector along which the position of X is
    weakest, in the frame of the one; share: how much of what the motion says of that is no noise, 0 where it says
    nothing; shown: of every small motion of X. support: how many framesets agree, of so many voters; sigma: of X, rad
    and m as one."""

    one_from_other: Pose
    part_from_part: Pose
    axis: Floats
    share: float
    shown: Shown
    support: int
    voters: int
    sigma: float


@dataclass(frozen=True, eq=False)
class Moving:
    """Poses (F,) of one part of a body in a group of cameras, with sigmas (F,) of rotation and position."""

    pose: Pose
    rotation: Floats
    translation: Floats

    def part(self, rows: Ints) -> "Moving":
        """At some framesets."""
        return Moving(self.pose[rows], self.rotation[rows], self.translation[rows])


def hand_eye(one: Moving, other: Moving, *, is_level: bool = False) -> HandEye | None:
    """The poses that two motions at the same framesets (F,) have in common; None where there are none, or no turning
    shows them. is_level: the motion is known to be about one axis; both groups are then as far along it."""
    count = len(one.rotation)
    if count < _FEWEST:
        return None
    rows = np.unique(np.linspace(0, count - 1, min(count, _MOST)).astype(int))
    one, other = one.part(rows), other.part(rows)
    i, j = np.triu_indices(len(rows), 1)
    a, b = (each.pose[i] @ each.pose[j].inverse() for each in (one, other))
    turn_a, turn_b = vector_from_rotation(a.rotation), vector_from_rotation(b.rotation)
    sigma = np.sqrt(
        (one.rotation[i] ** 2 + one.rotation[j] ** 2 + other.rotation[i] ** 2 + other.rotation[j] ** 2) / 3
    )
    angle = np.linalg.norm(turn_a, axis=1)
    alike = np.abs(angle - np.linalg.norm(turn_b, axis=1)) < _SAME_ANGLE * sigma
    alike &= angle < _HALF_TURN
    if alike.sum() < _FEWEST:
        return None
    a, b, turn_a, turn_b, sigma = a[alike], b[alike], turn_a[alike], turn_b[alike], sigma[alike]
    axis, share = turning(one.pose.rotation, np.hypot(one.rotation, other.rotation))
    if np.isnan(share):
        return None
    share = 0.0 if is_level else share
    level = axis if share < REAL else np.zeros(3)
    best = min(
        (_refined(one, other, start, level) for start in _starts(a, b, turn_a, turn_b, axis, level)),
        key=lambda found: found[2],
    )
    one_from_other, part_from_part, _ = best
    residual = _residuals(one, other, one_from_other, part_from_part)
    agrees = (residual**2).sum(axis=1) < _AGREES**2 * 6
    if agrees.mean() < _MAJORITY:
        return None
    spread = float(np.hypot(np.median(one.rotation), np.median(one.translation)) / np.sqrt(agrees.sum()))
    shown = _shown(one.part(np.flatnonzero(agrees)), other.part(np.flatnonzero(agrees)))
    return HandEye(one_from_other, part_from_part, axis, share, shown, int(agrees.sum()), len(rows), spread)


def _shown(one: Moving, other: Moving) -> Shown:
    """What the motion shows of X, with the noise of both, and what first lenses may tilt."""
    turn = np.repeat((one.rotation**2 + other.rotation**2)[:, None] / 3 + NO_EVIDENCE**2 / 2, 3, axis=1)
    shift = np.repeat((one.translation**2 + other.translation**2)[:, None] / 3, 3, axis=1)
    root = np.linalg.inv(step_by_left_twist(one.pose)) * np.sqrt(np.concatenate([turn, shift], axis=1))[:, None]
    return shown_by_motion(one.pose, root @ np.swapaxes(root, -1, -2))


def turning(rotations: Floats, sigma: Floats) -> tuple[Floats, float]:
    """The axis (3,) that poses of these rotations (F, 3, 3) turn about most, in the frame that they lead to, and how
    much of the turning about any other is no noise, 0 to 1; nan where they turn about none. sigma (F,): of the
    rotations, rad, root of the sum over three axes."""
    i, j = np.triu_indices(len(rotations), 1)
    turns = vector_from_rotation(rotations[i] @ np.swapaxes(rotations[j], -1, -2))
    turns = turns[np.linalg.norm(turns, axis=1) < _HALF_TURN]
    values, axes = np.linalg.eigh(turns.T @ turns / max(len(turns), 1))
    noise = 2 * float(np.median(sigma**2)) / 3 + NO_EVIDENCE**2
    if values[2] < _TURNS * noise:
        return axes[:, 2], float("nan")
    return axes[:, 2], float(np.clip(1 - noise / max(values[1], np.finfo(float).tiny), 0, 1))


def _starts(a: Pose, b: Pose, turn_a: Floats, turn_b: Floats, axis: Floats, level: Floats) -> list[Pose]:
    """First guesses of X: from the axes of all motions; where these are one, level (3,), for every turn about it."""
    rotation = nearest_rotation(np.einsum("pi,pj->ij", turn_a, turn_b))
    angles = 2 * np.pi * np.arange(_TRIED) / _TRIED if level.any() else [0.0]
    found = []
    for angle in angles:
        turned = rotation_from_vector(angle * axis) @ rotation
        left = (a.rotation - np.eye(3)).reshape(-1, 3)
        right = (b.translation @ turned.T - a.translation).reshape(-1)
        normal = left.T @ left + _HELD * np.eye(3) + _LEVEL * np.outer(level, level)
        found.append(Pose(turned, np.asarray(np.linalg.solve(normal, left.T @ right), float)))
    return found


def _residuals(one: Moving, other: Moving, x: Pose, y: Pose) -> Floats:
    """Steps (F, 6) from X b Y to a, in their sigmas."""
    return (x @ other.pose @ y).step_to(one.pose) / _sigmas(one, other)


def _sigmas(one: Moving, other: Moving) -> Floats:
    """Of the steps (F, 6)."""
    far = np.linalg.norm(one.pose.translation, axis=-1)
    rotation = np.hypot(one.rotation, other.rotation)
    translation = np.sqrt(one.translation**2 + other.translation**2 + (far * other.rotation) ** 2)
    return np.repeat(np.stack([rotation, translation], axis=1), 3, axis=1)


def _refined(one: Moving, other: Moving, x: Pose, level: Floats) -> tuple[Pose, Pose, float]:
    """X and Y of least cost from a guess of X, and the cost: Gauss-Newton with Cauchy's loss. level (3,): the axis
    along which X stays at zero, zero where there is none."""
    y = _middle((x @ other.pose).inverse() @ one.pose)
    best = x, y, np.inf
    for _ in range(_STEPS):
        residual = _residuals(one, other, x, y)
        square = (residual**2).sum(axis=1) / 6
        cost = float(np.log1p(square / _CAUCHY**2).sum())
        if not cost < best[2]:
            break
        best = x, y, cost
        predicted = x @ other.pose @ y
        position = np.broadcast_to(y.translation, predicted.translation.shape)
        inner = step_by_inner_twist(x.rotation @ other.pose.rotation, position)
        jacobian = np.concatenate([step_by_left_twist(predicted), inner], axis=2)
        loose = 1 / np.sqrt(1 + square / _CAUCHY**2)[:, None]
        weighted = jacobian * (loose / _sigmas(one, other))[:, :, None]
        normal = np.einsum("fki,fkj->ij", weighted, weighted) + _HELD * np.eye(12)
        right = np.einsum("fki,fk->i", weighted, loose * residual)
        along = np.concatenate([np.cross(x.translation, level), level])
        normal[:6, :6] += _LEVEL * np.outer(along, along)
        right[:6] -= _LEVEL * (level @ x.translation) * along
        step = np.linalg.solve(normal, right)
        x, y = Pose.from_twist(step[:6]) @ x, Pose.from_twist(step[6:]) @ y
    return best


def _middle(poses: Pose) -> Pose:
    """A pose amid some (F,): the median position, and the rotation nearest to most."""
    mean = nearest_rotation(poses.rotation.sum(axis=0))
    off = np.linalg.norm(vector_from_rotation(mean.T @ poses.rotation), axis=-1)
    near: Mask = off <= np.median(off)
    return Pose(nearest_rotation(poses.rotation[near].sum(axis=0)), np.median(poses.translation, axis=0))
