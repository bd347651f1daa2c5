"""Cameras whose clocks differ: the offset of each is estimated together with the rig.

A moving rectangle is seen by each camera at a time of its own. Its corners' paths through one camera's images are
interpolated in time, so that every View can be had for the one instant of its frameset; the clocks with which all
cameras agree about the rectangle are found by Levenberg-Marquardt, lenses, camera poses and the rectangle's poses
being free. An image's true time is its stamp plus its camera's offset; the first camera's offset is zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.single.lens import LENS_PARAMETERS, project_with_derivatives
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.rotation import Array, cross_matrix
from quadrig.single.view import View

from .calibrate import calibrate
from .inputs import CameraInput
from .result import Rig
from .timed_path import Paths, TimedPath, paths_of, views_at
from .weaknesses import weaknesses

# Images of a frameset that are nearer than this, s, are of one instant: at 1 m/s a third of a millimetre.
_INSTANT = 3e-4
# Offsets have converged when a step is below this, s: at 1 m/s it moves a corner by a hundredth of a millimetre.
_SETTLED = 1e-5
_STEPS = 60
# An offset is one number of thousands of points: more framesets than this make it no surer than it need be.
_MOST_FRAMESETS = 60
# Clocks of one recording differ by less than this, s: it keeps offsets finite where nothing moves.
_PRIOR_SIGMA = 1.0
# An offset whose sigma is more than this part of the interval between images is not known; zero is as good.
_KNOWN = 0.25
# Residuals are weighted down beyond this many sigmas (Huber 1964): while clocks are wrong, most of them.
_HUBER = 3.0
# The valley of a clock and a focal is narrow: much damping means many steps along it.
_DAMPING, _LESS, _MORE, _HOPELESS = 1e-6, 0.1, 10.0, 1e3


@dataclass(frozen=True, eq=False)
class Clocks:
    """offsets (C,) s by camera: what is added to a stamp to have the first camera's time. sigmas (C,) s: of the
    offsets; inf where nothing that moves tells them."""

    cameras: tuple[str, ...]
    offsets: Array
    sigmas: Array

    def by_camera(self) -> dict[str, float]:
        """Offset by name, s."""
        return dict(zip(self.cameras, self.offsets.tolist(), strict=True))


def calibrate_with_clocks(
    cameras: Sequence[CameraInput],
    rectangles: Sequence[Rectangle],
    views: Sequence[View],
    reference: str | None = None,
) -> Rig:
    """The rig, solved with the clock offsets that Views of moving rectangles show; Camera.clock_offset has them.

    As calibrate, where cameras look at one instant already, where Views carry no time, or nothing moves. Views of
    consecutive images are needed: a path cannot be followed through one image in ten.
    Raises QuadrigError as calibrate does.
    """
    untimed = [replace(view, time=float("nan")) for view in views]
    stamps = stamps_of(views, [camera.name for camera in cameras])
    followed = any(rectangle.moving for rectangle in rectangles) and np.count_nonzero(np.isfinite(stamps)) > 0
    if not followed:
        return calibrate(cameras, rectangles, views, reference)
    rig = calibrate(cameras, rectangles, untimed, reference)
    clocks, retimed = retime(rig, rectangles, untimed, stamps, tuple(camera.name for camera in cameras))
    known = np.isfinite(clocks.sigmas)
    if np.count_nonzero(known) < 2:
        return calibrate(cameras, rectangles, views, reference)
    if _spread(stamps[:, known] + clocks.offsets[known]) > _INSTANT:
        rig = calibrate(cameras, rectangles, retimed, reference)
    return _with_offsets(rig, clocks, float(clocks.offsets[known].mean()))


def stamps_of(views: Sequence[View], names: Sequence[str]) -> Array:
    """Time (S, C) s of the image of each frameset and camera, from its Views; nan where there are none."""
    count = max((view.frameset for view in views), default=-1) + 1
    stamps = np.full((count, len(names)), np.nan)
    for view in views:
        stamps[view.frameset, names.index(view.camera)] = view.time
    return stamps


def _spread(times: Array) -> float:
    """How far apart (s) the images of a frameset usually are."""
    shared = times[np.count_nonzero(np.isfinite(times), axis=1) > 1]
    return float(np.median(np.nanmax(shared, axis=1) - np.nanmin(shared, axis=1))) if len(shared) else 0.0


def _with_offsets(rig: Rig, clocks: Clocks, middle: float) -> Rig:
    """The rig with its cameras' offsets about their mean, and what is weak said anew."""
    offsets, sigmas = clocks.by_camera(), dict(zip(clocks.cameras, clocks.sigmas.tolist(), strict=True))
    known = {name: offset - middle if np.isfinite(sigmas[name]) else 0.0 for name, offset in offsets.items()}
    cameras = tuple(replace(camera, clock_offset=known.get(camera.name, 0.0)) for camera in rig.cameras)
    told = replace(rig, cameras=cameras)
    return replace(told, weak=weaknesses(told))


def retime(
    rig: Rig, rectangles: Sequence[Rectangle], views: Sequence[View], stamps: Array, names: tuple[str, ...]
) -> tuple[Clocks, list[View]]:
    """The clocks, from a rig that was solved as if they agreed, and the Views as they were at one instant each.

    Views of static rectangles stay. names: the columns of stamps (S, C). Offsets are zero, and Views as they were,
    where no moving rectangle is followed by two cameras; offsets of cameras that nothing tells of are zero.
    """
    moving = {rectangle.name for rectangle in rectangles if rectangle.moving}
    read = _as_read(rig, views)
    paths = paths_of([view for view in read if view.rectangle in moving], stamps, names)
    clocks = estimate_clocks(rig, paths, stamps, names)
    if np.count_nonzero(np.isfinite(clocks.sigmas)) < 2:
        return clocks, list(views)
    still = [view for view in read if view.rectangle not in moving]
    return clocks, still + views_at(paths, instants(stamps, clocks.offsets), clocks.by_camera())


def instants(stamps: Array, offsets: Array) -> Array:
    """Time (S,) s of each frameset: the mean of its images' true times, which keeps interpolation short."""
    true = np.asarray(stamps, float) + offsets
    present = np.isfinite(true)
    with np.errstate(invalid="ignore"):
        return np.where(present, true, 0.0).sum(axis=1) / present.sum(axis=1)


def _as_read(rig: Rig, views: Sequence[View]) -> list[View]:
    """The Views in the reading that the rig chose, so that a point keeps its name from image to image."""
    chosen = {
        (fit.view.camera, fit.view.rectangle, fit.view.frameset): fit.view.readings[fit.reading] for fit in rig.fits
    }
    return [
        replace(view, points=chosen.get((view.camera, view.rectangle, view.frameset), view.points), alternatives=())
        for view in views
    ]


@dataclass(frozen=True, eq=False)
class _State:
    """What is being solved. offsets (C,), lenses (C, 9) and rig_from_camera (C,) of the rig's cameras; rig_from_rect
    (B,) of the moving rectangles' poses."""

    offsets: Array
    lenses: Array
    rig_from_camera: Pose
    rig_from_rect: Pose


@dataclass(frozen=True, eq=False)
class _Scene:
    """What stays. boards: rectangle and time of each of the B poses. free: places of the free lens parameters."""

    rig: Rig
    names: tuple[str, ...]
    paths: Paths
    boards: tuple[tuple[str, float], ...]
    free: tuple[Array, ...]

    @property
    def columns(self) -> list[int]:
        """Where each camera's unknowns begin, and their end: offset, pose (6), lens; the first's first 7 are held."""
        return [0, *np.cumsum([7 + len(free) for free in self.free]).tolist()]


def estimate_clocks(rig: Rig, paths: Paths, stamps: Array, names: tuple[str, ...]) -> Clocks:
    """The clocks with which these paths agree, from a rig that was solved as if they agreed.

    names: the columns of stamps (S, C) s.
    """
    clocks = Clocks(names, np.zeros(len(names)), np.full(len(names), np.inf))
    scene, state = _begin(rig, paths, instants(stamps, clocks.offsets))
    if not scene.boards or len(scene.names) < 2:
        return clocks
    linear, damping = _linearised(scene, state), _DAMPING
    for _ in range(_STEPS):
        step = linear.solve(damping)
        trial = _moved(scene, state, step)
        trial_linear = _linearised(scene, trial)
        if trial_linear.better_than(linear):
            settled = np.abs(trial.offsets - state.offsets).max() < _SETTLED
            state, linear, damping = trial, trial_linear, damping * _LESS
            if settled:
                break
        else:
            damping *= _MORE
            if damping > _HOPELESS:
                break
    offsets, sigmas = clocks.offsets.copy(), clocks.sigmas.copy()
    places = [names.index(name) for name in scene.names]
    found = linear.sigmas()[scene.columns[:-1]]
    interval = min(path.interval for path in paths.values())
    known = found < _KNOWN * interval
    offsets[places] = np.where(known, state.offsets, 0.0)
    sigmas[places] = np.where(known, found, np.inf)
    return Clocks(names, offsets, sigmas)


def _begin(rig: Rig, paths: Paths, times: Array) -> tuple[_Scene, _State]:
    """The framesets in which at least two cameras follow a rectangle, and where the rig says that it was."""
    names = tuple(camera.name for camera in rig.cameras)
    boards = []
    for placed in rig.rectangles:
        for k, frameset in enumerate(placed.framesets.tolist()):
            time = float(times[frameset])
            followers = [name for name in names if _follows(paths.get((name, placed.name)), time)]
            if len(followers) >= 2:
                boards.append((placed.name, time, placed.rig_from_rect[k]))
    kept = np.unique(np.linspace(0, len(boards) - 1, _MOST_FRAMESETS).round().astype(int)) if boards else []
    chosen = [boards[k] for k in kept]
    free = tuple(np.array([LENS_PARAMETERS.index(name) for name in one.free_lens], int) for one in rig.cameras)
    lenses = np.array([camera.intrinsics.parameters for camera in rig.cameras])
    state = _State(
        np.zeros(len(names)),
        lenses,
        _stacked([camera.rig_from_camera for camera in rig.cameras]),
        _stacked([pose for _, _, pose in chosen]),
    )
    return _Scene(rig, names, paths, tuple((name, time) for name, time, _ in chosen), free), state


def _follows(path: TimedPath | None, time: float) -> bool:
    return path is not None and bool(path.times[0] < time < path.times[-1])


def _stacked(poses: Sequence[Pose]) -> Pose:
    if not poses:
        return Pose(np.zeros((0, 3, 3)), np.zeros((0, 3)))
    return Pose(np.stack([pose.rotation for pose in poses]), np.stack([pose.translation for pose in poses]))


@dataclass(frozen=True, eq=False)
class _Linear:
    """Normal equations of the cameras' unknowns, the rectangle's poses eliminated, and what leads back to those.

    normal (U, U), right (U,); coupling (B, 6, U), own (B, 6, 6), own_right (B, 6); held (U,) bool. losses: of each
    point, by rectangle pose and camera.
    """

    normal: Array
    right: Array
    coupling: Array
    own: Array
    own_right: Array
    held: Array
    losses: dict[tuple[int, int], Array]

    def solve(self, damping: float) -> tuple[Array, Array]:
        """Steps of the cameras' unknowns (U,) and of the rectangle's poses (B, 6)."""
        own = self.own + damping * np.einsum("bii->bi", self.own)[:, :, None] * np.eye(6)
        back = np.linalg.solve(own, np.concatenate([self.coupling, self.own_right[:, :, None]], axis=2))
        normal = self.normal + damping * np.diag(np.diag(self.normal))
        reduced = normal - np.einsum("bku,bkv->uv", self.coupling, back[:, :, :-1])
        right = self.right - np.einsum("bku,bk->u", self.coupling, back[:, :, -1])
        shared = np.zeros(len(right))
        free = ~self.held
        shared[free] = _solve_scaled(reduced[np.ix_(free, free)], right[free])
        return shared, back[:, :, -1] - back[:, :, :-1] @ shared

    def better_than(self, other: "_Linear") -> bool:
        """Over the points that both see: at the end of its path a point comes and goes with the offset."""
        change = [np.nansum(losses - other.losses[key]) for key, losses in self.losses.items() if key in other.losses]
        return float(np.sum(change)) < 0

    def sigmas(self) -> Array:
        """Standard deviations (U,) of the cameras' unknowns; 0 where held."""
        back = np.linalg.solve(self.own, self.coupling)
        reduced = self.normal - np.einsum("bku,bkv->uv", self.coupling, back)
        free = ~self.held
        result = np.zeros(len(self.right))
        scale = 1 / np.sqrt(np.diag(reduced)[free])
        inverse = np.linalg.pinv(reduced[np.ix_(free, free)] * np.outer(scale, scale), hermitian=True)
        result[free] = np.sqrt(np.maximum(np.diag(inverse), 0.0)) * scale
        return result


def _solve_scaled(matrix: Array, right: Array) -> Array:
    """Of unknowns whose units differ by many powers of ten."""
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    return scale * np.linalg.lstsq(matrix * np.outer(scale, scale), scale * right, rcond=1e-13)[0]


def _linearised(scene: _Scene, state: _State) -> _Linear:
    columns = scene.columns
    unknowns, boards = columns[-1], len(scene.boards)
    normal, right = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    coupling, own, own_right = np.zeros((boards, 6, unknowns)), np.zeros((boards, 6, 6)), np.zeros((boards, 6))
    losses: dict[tuple[int, int], Array] = {}
    for board in range(boards):
        for camera in range(len(scene.names)):
            rows = _rows(scene, state, board, camera)
            if rows is None:
                continue
            residual, by_rectangle, by_camera, loss = rows
            here = slice(columns[camera], columns[camera + 1])
            normal[here, here] += by_camera.T @ by_camera
            right[here] += by_camera.T @ residual
            coupling[board, :, here] += by_rectangle.T @ by_camera
            own[board] += by_rectangle.T @ by_rectangle
            own_right[board] += by_rectangle.T @ residual
            losses[board, camera] = loss
    held = np.diag(normal) == 0
    held[:7] = True
    clocks = columns[:-1]
    normal[clocks, clocks] += _PRIOR_SIGMA**-2
    right[clocks] -= state.offsets * _PRIOR_SIGMA**-2
    return _Linear(normal, right, coupling, own, own_right, held, losses)


def _rows(scene: _Scene, state: _State, board: int, camera: int) -> tuple[Array, Array, Array, Array] | None:
    """Of one View, weighted: residual (2P,), its derivatives by the rectangle's pose (2P, 6) and by the camera's
    unknowns (2P, U_c), and the loss of every point, nan where it is not seen.

    None where the camera does not follow the rectangle then.
    """
    rectangle, instant = scene.boards[board]
    path = scene.paths.get((scene.names[camera], rectangle))
    time = instant - state.offsets[camera]
    if path is None or not _follows(path, time):
        return None
    (pixels, share), velocity = path.at(time), path.velocity(time)
    seen = np.isfinite(pixels).all(axis=1) & np.isfinite(velocity).all(axis=1)
    rig_from_rect, rig_from_camera = state.rig_from_rect[board], state.rig_from_camera[camera]
    turned = path.points @ rig_from_rect.rotation.T
    in_rig = turned + rig_from_rect.translation
    in_camera = (in_rig - rig_from_camera.translation) @ rig_from_camera.rotation
    model = scene.rig.cameras[camera].intrinsics.model
    predicted, by_lens, by_point = project_with_derivatives(state.lenses[camera], in_camera, model)
    seen &= np.isfinite(predicted).all(axis=1)
    if not np.any(seen):
        return None
    sigma = (path.sigma * share[seen])[:, None]
    error = (pixels - predicted)[seen] / sigma
    size = np.linalg.norm(error, axis=1)
    weight = np.sqrt(np.minimum(1.0, _HUBER / np.maximum(size, 1e-12)))
    loss = np.full(len(path.points), np.nan)
    # The likelihood of two coordinates: where interpolation smooths less, more error is no worse.
    loss[seen] = np.where(size <= _HUBER, size**2, 2 * _HUBER * size - _HUBER**2) + 4 * np.log(share[seen])
    by_rig = by_point[seen] @ rig_from_camera.rotation.T
    arm = in_rig[seen] - rig_from_camera.translation
    by_rectangle = np.concatenate([-by_rig @ cross_matrix(turned[seen]), by_rig], axis=2)
    by_pose = np.concatenate([by_rig @ cross_matrix(arm), -by_rig], axis=2)
    # The more a camera's clock lags, the earlier on its path is the place that belongs to the instant.
    by_camera = np.concatenate([velocity[seen][:, :, None], by_pose, by_lens[seen][:, :, scene.free[camera]]], axis=2)
    scale = (weight[:, None] / sigma)[:, :, None]
    flat = 2 * len(error)
    return (
        (weight[:, None] * error).ravel(),
        (scale * by_rectangle).reshape(flat, 6),
        (scale * by_camera).reshape(flat, -1),
        loss,
    )


def _moved(scene: _Scene, state: _State, step: tuple[Array, Array]) -> _State:
    shared, boards = step
    columns = scene.columns
    by_camera = np.array([shared[start : start + 7] for start in columns[:-1]])
    lenses = state.lenses.copy()
    for camera, free in enumerate(scene.free):
        lenses[camera, free] += shared[columns[camera] + 7 : columns[camera + 1]]
    return _State(
        state.offsets + by_camera[:, 0],
        lenses,
        state.rig_from_camera.retract(by_camera[:, 1:]),
        state.rig_from_rect.retract(boards),
    )
