"""Two calibrations of one rig, brought into one frame: what differs, and whether their sigmas allow it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.result import CAMERA_PARAMETERS, Camera, Rig
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import LENS_PARAMETERS
from quadrig.single.pose import Pose, step_by_left_twist

PARTS = ("focal", "lens", "position", "rotation", "pose")
"""What is tested of each camera: its focal, all of its lens, position and rotation, and these two together."""

_LENS = len(LENS_PARAMETERS)
_OF_POSE = frozenset(PARTS[2:])
# Weights of cameras settle to a per cent in this many rounds; more would change no printed digit.
_ROUNDS = 10
# Of a hundred comparisons of sound rigs one calls anything different: as seldom as `rig check` gives a false alarm.
_UNLIKELY = 0.01
# Below this share of the largest variance, each number in its own sigma, is rounding.
_ROUNDING = 1e-10
# Of so many cameras one at a time is taken out of the frame.
_AT_ONCE = 32
# Numbers of a lens that are given in both rigs are the same up to how files write them.
_SAME = 1e-6


@dataclass(frozen=True)
class Distance:
    """How far apart two rigs have one thing: Mahalanobis distance, and in how many directions there is any doubt of
    it. chance: of so large a one, by chi-square. nan, nan and 0 where the doubt is not known, or there is none."""

    sigmas: float = float("nan")
    freedoms: int = 0
    chance: float = float("nan")


@dataclass(frozen=True, eq=False)
class CameraDifference:
    """Second rig minus first for one camera, in the first's frame.

    focal px; shift m; rotation rad. Each sigma is that of the difference, from both rigs, along it: their ratio is
    what it is judged by. step (6,) of rig_from_camera. apart: by each of PARTS. differs: those that are called
    different; "lens" is not said beside "focal", nor "pose" beside position or rotation.
    """

    name: str
    focal: float
    focal_sigma: float
    shift: float
    shift_sigma: float
    rotation: float
    rotation_sigma: float
    step: Floats
    apart: Mapping[str, Distance]
    differs: tuple[str, ...] = ()

    @property
    def least_likely(self) -> tuple[str, float]:
        """The part that differs most for its sigmas, and the chance of that; ("", nan) where none is known."""
        known = [(part, one.chance) for part, one in self.apart.items() if np.isfinite(one.chance)]
        return min(known, key=lambda one: one[1], default=("", float("nan")))


@dataclass(frozen=True, eq=False)
class _Aligned:
    """steps (C, 6): what is left of each camera. doubt (6C, 6C): their covariance. kept (6C, 6C): takes steps of the
    cameras of either rig to those that are left."""

    first_from_second: Pose
    steps: Floats
    doubt: Floats
    kept: Floats


@dataclass(frozen=True, eq=False)
class Comparison:
    """first_from_second: takes the second rig's frame to the first's. only_first, only_second: names without a
    partner. tests: how many parts of cameras were compared."""

    cameras: tuple[CameraDifference, ...]
    first_from_second: Pose
    only_first: tuple[str, ...]
    only_second: tuple[str, ...]
    tests: int

    def chance(self, camera: CameraDifference) -> float:
        """That any part of any camera of two sound rigs differs as much as this one; nan where it is not known."""
        return min(self.tests * camera.least_likely[1], 1.0) if self.tests else float("nan")

    @property
    def worst(self) -> CameraDifference:
        """The camera that differs most for its sigmas."""
        return min(self.cameras, key=lambda one: np.nan_to_num(one.least_likely[1], nan=1.0))


def compare(first: Rig, second: Rig) -> Comparison:
    """Align two rigs on the cameras they share, and state their differences with sigmas.

    Each part of each camera is tested by the chi-square of its numbers, all tests at one common level (Bonferroni's).
    Cameras that disagree pull less on the frame (Huber's weights), and those whose pose differs not at all, so that
    one that moved does not smear over the others. The two calibrations are taken to rest on different Views. Raises
    QuadrigError where they share no camera.
    """
    names = [camera.name for camera in first.cameras if any(camera.name == other.name for other in second.cameras)]
    if not names:
        raise QuadrigError(
            f"the two rigs share no camera by name: the first has {_names(first)}; the second {_names(second)}; "
            "compare calibrations of one rig, and pair cameras that are called otherwise (--rename OLD=NEW)"
        )
    holding = np.ones(len(names), bool)
    while True:
        aligned = _aligned(first, second, names, holding)
        found = [_difference(pair, *rest) for pair, rest in _parts(first, second, names, aligned)]
        tests = sum(bool(np.isfinite(part.chance)) for one in found for part in one.apart.values())
        judged = [_judged(one, tests) for one in found]
        apart = any(held and _OF_POSE & {*one.differs} for held, one in zip(holding, judged, strict=True))
        # Of two cameras nobody can say which it was.
        if not apart or holding.sum() == 2:
            break
        holding[_most_apart(aligned, holding)] = False
    return Comparison(
        tuple(judged),
        aligned.first_from_second,
        tuple(camera.name for camera in first.cameras if camera.name not in names),
        tuple(camera.name for camera in second.cameras if camera.name not in names),
        tests,
    )


def renamed(rig: Rig, names: Mapping[str, str]) -> Rig:
    """The rig with some of its cameras, or all, under new names. Raises QuadrigError where it has no such camera, or
    two would share a name."""
    for old in names:
        if old not in {camera.name for camera in rig.cameras}:
            raise QuadrigError(f"there is no camera {old!r} to rename; the second rig has {_names(rig)}")
    cameras = tuple(replace(camera, name=names.get(camera.name, camera.name)) for camera in rig.cameras)
    called = [camera.name for camera in cameras]
    twice = [name for name in called if called.count(name) > 1]
    if twice:
        raise QuadrigError(f"two cameras of the second rig would be called {twice[0]!r}; rename both")
    return replace(rig, cameras=cameras, reference=names.get(rig.reference, rig.reference))


def _names(rig: Rig) -> str:
    return ", ".join(camera.name for camera in rig.cameras)


def _judged(one: CameraDifference, tests: int) -> CameraDifference:
    unlikely = {part for part in PARTS if tests * one.apart[part].chance < _UNLIKELY}
    unlikely -= {"lens"} if "focal" in unlikely else set()
    unlikely -= {"pose"} if unlikely & {"position", "rotation"} else set()
    return replace(one, differs=tuple(part for part in PARTS if part in unlikely))


def _aligned(first: Rig, second: Rig, names: Sequence[str], holding: Mask) -> _Aligned:
    """The second rig in the frame of the first, by the cameras that hold it (C,)."""
    stored = [first.camera(name).rig_from_camera for name in names]
    other = [second.camera(name).rig_from_camera for name in names]
    first_from_second = stored[0] @ other[0].inverse()
    positions = np.array([pose.translation for pose in stored])
    # A radian counts as much as the size of the rig, so that the frame does not hang on its unit of length.
    size = max(float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max()), 1e-3)
    scale = np.array([size, size, size, 1.0, 1.0, 1.0])
    weight, gauge, pull = holding.astype(float), np.zeros((0, 6)), np.zeros((6, 0))
    for _ in range(_ROUNDS):
        placed = [first_from_second @ pose for pose in other]
        steps = np.array([a.step_to(b) for a, b in zip(stored, placed, strict=True)])
        rows = (np.sqrt(weight)[:, None] * scale).ravel()
        gauge = np.concatenate([step_by_left_twist(pose) for pose in placed])
        pull = np.asarray(np.linalg.pinv(gauge * rows[:, None]) * rows, float)
        first_from_second = Pose.from_twist(-(pull @ steps.ravel())) @ first_from_second
        miss = np.linalg.norm(steps * scale, axis=1)
        usual = max(float(np.median(miss[holding])), 1e-12)
        weight = holding / np.maximum(miss / usual, 1.0)
    placed = [first_from_second @ pose for pose in other]
    steps = np.array([a.step_to(b) for a, b in zip(stored, placed, strict=True)])
    kept = np.eye(len(gauge)) - gauge @ pull
    doubt = kept @ (_poses(first, names, Pose.identity()) + _poses(second, names, first_from_second)) @ kept.T
    return _Aligned(first_from_second, steps, doubt, kept)


def _most_apart(aligned: _Aligned, holding: Mask) -> Ints:
    """Of the cameras that hold the frame those (K,) that explain most of what is left, were they free: one, but a
    share of very many, or large rigs would take minutes. Generalised least squares, whatever the frame."""
    held = np.flatnonzero(holding)
    rows = (6 * held[:, None] + np.arange(6)).ravel()
    information = np.linalg.pinv(aligned.doubt[np.ix_(rows, rows)], rcond=_ROUNDING, hermitian=True)
    pull = information @ aligned.steps[held].ravel()
    gains = np.zeros(len(held))
    for index, camera in enumerate(held):
        own = aligned.kept[np.ix_(rows, 6 * camera + np.arange(6))]
        by_step = own.T @ pull
        gains[index] = by_step @ np.linalg.pinv(own.T @ information @ own, hermitian=True) @ by_step
    return held[np.argsort(gains)[-max(len(held) // _AT_ONCE, 1) :]]


def _poses(rig: Rig, names: Sequence[str], frame_from_rig: Pose) -> Floats:
    """Joint covariance (6C, 6C) of the cameras' steps, in another frame."""
    index = np.concatenate([rig.camera_index(name) * CAMERA_PARAMETERS + _LENS + np.arange(6) for name in names])
    rotation = np.kron(np.eye(2 * len(names)), frame_from_rig.rotation)
    return rotation @ rig.covariance[np.ix_(index, index)] @ rotation.T


def _parts(
    first: Rig, second: Rig, names: Sequence[str], aligned: _Aligned
) -> Iterator[tuple[tuple[Camera, Camera], tuple[Floats, Floats, Floats]]]:
    """Each camera of both rigs, with the covariance of the difference of its lens, its step, and that of it."""
    for index, name in enumerate(names):
        own = slice(6 * index, 6 * index + 6)
        # One camera is aligned on itself: there is no pose to compare.
        doubt = aligned.doubt[own, own] if len(names) > 1 else np.full((6, 6), np.nan)
        lens = first.lens_covariance(name) + second.lens_covariance(name)
        yield (first.camera(name), second.camera(name)), (lens, aligned.steps[index], doubt)


def _difference(pair: tuple[Camera, Camera], lens: Floats, step: Floats, doubt: Floats) -> CameraDifference:
    """Of a camera of both rigs. lens (9, 9), doubt (6, 6): covariances of the differences of lens and pose."""
    one, two = (camera.intrinsics for camera in pair)
    turn, shift = slice(0, 3), slice(3, 6)
    position, rotation, pose = (_distance(step[part], doubt[part, part]) for part in (shift, turn, slice(0, 6)))
    focal = whole = Distance()
    # Coefficients of another model, and pixels of another size, are other numbers.
    if (one.model, one.width, one.height) == (two.model, two.width, two.height):
        numbers = two.parameters - one.parameters
        focal, whole = _distance(numbers[:1], lens[:1, :1]), _distance(numbers, lens)
    return CameraDifference(
        pair[0].name,
        two.focal - one.focal,
        float(np.sqrt(lens[0, 0])),
        float(np.linalg.norm(step[shift])),
        _along(step[shift], doubt[shift, shift], position),
        float(np.linalg.norm(step[turn])),
        _along(step[turn], doubt[turn, turn], rotation),
        step,
        dict(zip(PARTS, (focal, whole, position, rotation, pose), strict=True)),
    )


def _along(step: Floats, doubt: Floats, apart: Distance) -> float:
    """The sigma of a difference along itself; where there is none, the mean of all directions."""
    if apart.sigmas > 0:
        return float(np.linalg.norm(step)) / apart.sigmas
    return float(np.sqrt(np.maximum(np.trace(doubt), 0) / len(doubt)))


def _distance(step: Floats, doubt: Floats) -> Distance:
    """Of a difference from none. step (N,), doubt (N, N): its covariance."""
    from scipy.special import chdtrc

    free = np.diag(doubt) > 0
    if not np.isfinite(doubt).all():
        return Distance()
    if (np.abs(step[~free]) > _SAME).any():
        return Distance(float("inf"), 0, 0.0)
    if not free.any():
        return Distance()
    sigmas = np.sqrt(np.diag(doubt)[free])
    values, axes = np.linalg.eigh(doubt[np.ix_(free, free)] / np.outer(sigmas, sigmas))
    known = values > _ROUNDING * values.max()
    square = float(np.sum((axes.T @ (step[free] / sigmas))[known] ** 2 / values[known]))
    return Distance(float(np.sqrt(square)), int(known.sum()), float(chdtrc(int(known.sum()), square)))
