"""Lenses and the poses of the Views they took, at the maximum of their posterior: many lenses for the same Views."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.common_error import stacked_common, whitened
from quadrig.single.damping import MOST_DAMPING, Damping, gain
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import LensModel, project_with_derivatives
from quadrig.single.pose import Pose
from quadrig.single.posterior.lens_remainder import degrees_of, field_basis, shares_of, usual_variance
from quadrig.single.posterior.sheet_shape import STRETCH_SIGMA
from quadrig.single.rotation import cross_matrix
from quadrig.single.view import View

_MOST_STEPS = 30
# A step that promises less than this (in units of sigma^2) moves the answer by a thousandth of its own sigma.
_CONVERGED = 1e-6
_FIRST_DAMPING = 1e-4
# Points at a time: their derivatives, 15 numbers a coordinate, take some 15 MB.
_MOST_POINTS = 60_000
# How far the corners of a rectangle lie off its plane, of its diagonal: half a millimetre over a sheet of A4.
_BEND = 0.0014
# Numbers of a rectangle's shape.
_OWN_SHAPES = 8


@dataclass(frozen=True, eq=False)
class LensViews:
    """V Views of up to P points: points (V, P, 3) metres, pixels (V, P, 2), seen (V, P) where they are no padding,
    sigma (V) px; common (V, P, 2): what the pixels of a View share, over sigma; model: of the lens that took them.

    A shape is S numbers, each in its own sigma: R of the rectangles and F of what the lens leaves beside its model.
    by_sheet (V, P, 3, R): by how much they move points, m, in the frame of the rectangle; by_field (V, P, 2, F): and
    pixels, px.
    """

    points: Floats
    pixels: Floats
    seen: Mask
    sigma: Floats
    common: Floats
    by_sheet: Floats
    by_field: Floats
    model: LensModel = "pinhole"

    @property
    def shapes(self) -> int:
        """How many numbers S a shape has."""
        return self.by_sheet.shape[-1] + self.by_field.shape[-1]

    @property
    def coordinates(self) -> int:
        """How many numbers were measured."""
        return 2 * int(self.seen.sum())

    def noisier(self, factor: float) -> "LensViews":
        """The same with sigmas that are larger by a factor; what pixels share stays."""
        return replace(self, sigma=self.sigma * factor, common=self.common / factor)


@dataclass(frozen=True, eq=False)
class LensFits:
    """M fits of one lens each to the same V Views.

    lens (M, 9); shape (M, S) of rectangles and picture, in sigmas; camera_from_rects: a batch (M, V); chi2 (M) of the
    data over sigma^2; and the quadratic model of minus half of it there, where the poses follow: pull (M, n), its
    slope by lens and shape, and information (M, n, n); pose_gain (M, V, 6, n), the slope of the poses' steps, and
    pose_covariance (M, V, 6, 6) for lens and shape known; converged (M).
    """

    lens: Floats
    shape: Floats
    camera_from_rects: Pose
    chi2: Floats
    pull: Floats
    information: Floats
    pose_gain: Floats
    pose_covariance: Floats
    converged: Mask

    def likelihood(self, scale: float = 1.0) -> "LensLikelihood":
        """What the data say of the lens where poses and shapes are unknown and the noise is larger by a scale."""
        square = scale**2
        both = self.information / square
        # The shapes, each of unit variance beforehand.
        shapes = both[:, 9:, 9:] + np.eye(self.shape.shape[1])
        pull = self.pull[:, 9:] / square - self.shape
        inverse = np.linalg.inv(shapes)
        gain = -inverse @ both[:, 9:, :9]
        step = (inverse @ pull[..., None])[..., 0]
        by_shape = self.pose_gain[..., 9:]
        log = -0.5 * (self.chi2 / square + (self.shape**2).sum(axis=1) - (pull * step).sum(axis=1))
        return LensLikelihood(
            log - 0.5 * np.linalg.slogdet(shapes)[1],
            self.pull[:, :9] / square - (both[:, :9, 9:] @ step[..., None])[..., 0],
            both[:, :9, :9] + both[:, :9, 9:] @ gain,
            self.pose_gain[..., :9] + by_shape @ gain[:, None],
            square * self.pose_covariance + by_shape @ inverse[:, None] @ np.swapaxes(by_shape, -1, -2),
        )

    def __getitem__(self, rows: Ints) -> "LensFits":
        """Some of them."""
        return LensFits(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


@dataclass(frozen=True, eq=False)
class LensLikelihood:
    """Of M lenses: log (M), of the likelihood with poses at their likeliest and shapes averaged over; its slope pull
    (M, 9) and minus its curvature information (M, 9, 9); the slope of the poses by the lens, pose_gain (M, V, 6, 9),
    and their covariance for a lens that is known, pose_covariance (M, V, 6, 6)."""

    log: Floats
    pull: Floats
    information: Floats
    pose_gain: Floats
    pose_covariance: Floats


def joined(parts: Sequence[LensFits]) -> LensFits:
    """Fits of the same Views in one."""
    if len(parts) == 1:
        return parts[0]
    poses = [part.camera_from_rects for part in parts]
    arrays = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in LensFits.__dataclass_fields__
        if name != "camera_from_rects"
    }
    pose = Pose(np.concatenate([p.rotation for p in poses]), np.concatenate([p.translation for p in poses]))
    return LensFits(camera_from_rects=pose, **arrays)


def stacked_views(views: Sequence[View], image_size: tuple[int, int], model: LensModel = "pinhole") -> LensViews:
    """The Views of one camera in one block, their pixels padded to the same number. image_size: px; model: of their
    lens."""
    most = max(len(view.pixels) for view in views)
    points, pixels = np.zeros((len(views), most, 3)), np.zeros((len(views), most, 2))
    seen = np.zeros((len(views), most), bool)
    for row, view in enumerate(views):
        known, count = np.all(np.isfinite(view.pixels), axis=1), len(view.pixels)
        points[row, :count], pixels[row, :count] = view.points, np.where(known[:, None], view.pixels, 0.0)
        seen[row, :count] = known
    sigma = np.array([view.expected_sigma for view in views])
    common = stacked_common([view.common for view in views], sigma, most) * seen[..., None]
    by_sheet = _by_sheet([view.rectangle for view in views], points, seen)
    return LensViews(points, pixels, seen, sigma, common, by_sheet, _by_field(pixels, image_size), model)


def _by_sheet(names: Sequence[str], points: Floats, seen: Mask) -> Floats:
    """One sigma of eight numbers a rectangle: it is longer one way; and seven lift its corners alike: two twists, a
    bow, and what the sheet does on one half but not the other, in four ways (half as much)."""
    kinds = list(dict.fromkeys(names))
    moves = np.zeros((*seen.shape, 3, _OWN_SHAPES * len(kinds)))
    for number, kind in enumerate(kinds):
        own = np.array([name == kind for name in names])
        # Half the diagonal of what was seen of it.
        half = max(float(np.linalg.norm(points[own][seen[own]], axis=-1).max(initial=0)), 1e-12)
        x, y = points[own][..., 0] / half, points[own][..., 1] / half
        square = x * x + y * y
        even = [x * x - y * y, 2 * x * y, square]
        odd = [x * (square - 4 * y * y), y * (4 * x * x - square), x * square, y * square]
        first = _OWN_SHAPES * number
        moves[own, :, 0, first] = STRETCH_SIGMA * points[own][..., 0]
        moves[own, :, 1, first] = -STRETCH_SIGMA * points[own][..., 1]
        lift = np.stack([*even, *(0.5 * term for term in odd)], axis=-1)
        moves[own, :, 2, first + 1 : first + _OWN_SHAPES] = 2 * half * _BEND * lift
    return moves


def _by_field(pixels: Floats, image_size: tuple[int, int]) -> Floats:
    """One sigma of each number of the field that a usual lens leaves, across and down."""
    degrees, size = degrees_of(1), np.array(image_size, float)
    sigma = np.sqrt(usual_variance(size[:1])[0] * shares_of(degrees))
    one = np.swapaxes(field_basis(degrees, pixels, size), -1, -2) * sigma
    none = np.zeros_like(one)
    return np.stack([np.concatenate([one, none], axis=-1), np.concatenate([none, one], axis=-1)], axis=-2)


def fit_lenses(
    views: LensViews,
    lens: Floats,
    shape: Floats,
    camera_from_rects: Pose,
    free: Mask,
    mean: Floats,
    information: Floats,
) -> LensFits:
    """M lenses, each under a Gaussian prior of its own, from a start.

    lens (M, 9), shape (M, S) and camera_from_rects (M, V): the start; free (9,): which parameters of the lens are
    estimated; mean (M, 9) and information (M, 9, 9): the priors.
    Raises QuadrigError where there are fewer coordinates than poses need.
    """
    if (views.seen.sum(axis=1) < 4).any():
        raise QuadrigError("a View has fewer than four points; its pose cannot be found: give four or more")
    at_once = max(_MOST_POINTS // views.seen.size, 1)
    parts = []
    for rows in (slice(first, first + at_once) for first in range(0, len(lens), at_once)):
        prior = _LensPrior.of(free, mean[rows], information[rows], views.shapes)
        start = np.concatenate([lens[rows], shape[rows]], axis=1)
        with np.errstate(all="ignore"):
            parts.append(_search(views, start, camera_from_rects[rows], prior))
    return joined(parts)


def fits_at(views: LensViews, lens: Floats, shape: Floats, camera_from_rects: Pose) -> LensFits:
    """What the Views say of lenses (M, 9), shapes (M, S) and poses (M, V) that are given."""
    numbers = np.concatenate([lens, shape], axis=1)
    rows = _linearised(views, numbers, camera_from_rects)
    return _freed_of_poses(numbers, camera_from_rects, rows, np.ones(len(lens), bool))


def residuals_of(views: LensViews, lens: Floats, shape: Floats, camera_from_rects: Pose) -> Floats:
    """Residuals (V, P, 2) px of one lens (9,) and shape (S,); zero where there is no point."""
    points, pixels = _shaped(views, shape)
    located = points @ np.swapaxes(camera_from_rects.rotation, -1, -2) + camera_from_rects.translation[:, None]
    seen, _, _ = project_with_derivatives(lens, located, views.model)
    return np.where(views.seen[..., None], pixels - seen, 0.0)


def _shaped(views: LensViews, shape: Floats) -> tuple[Floats, Floats]:
    """Points (..., V, P, 3) and pixels (..., V, P, 2), freed of what the lens leaves, of these shapes (..., S)."""
    sheet, field = np.split(shape[..., None, :], [views.by_sheet.shape[-1]], axis=-1)
    count, points = views.seen.shape
    moved = sheet @ views.by_sheet.reshape(count * points * 3, -1).T
    shifted = field @ views.by_field.reshape(count * points * 2, -1).T
    leading = shape.shape[:-1]
    return (
        views.points + moved.reshape(*leading, count, points, 3),
        views.pixels - shifted.reshape(*leading, count, points, 2),
    )


@dataclass(frozen=True, eq=False)
class _LensPrior:
    """A Gaussian of lens and shapes, (M, n), in units (M, n) of its own sigmas, in which every number is of the same
    order: mean in those of the lens, information (M, n, n) in units; free (n,)."""

    free: Mask
    mean: Floats
    unit: Floats
    information: Floats

    @staticmethod
    def of(free: Mask, mean: Floats, information: Floats, shapes: int) -> "_LensPrior":
        sigma = 1 / np.sqrt(np.diagonal(information, axis1=1, axis2=2))
        held = information * sigma[:, :, None] * sigma[:, None, :]
        whole = np.tile(np.eye(9 + shapes), (len(mean), 1, 1))
        whole[:, :9, :9] = np.where(free[:, None] & free, held, np.eye(9))
        none = np.zeros((len(mean), shapes))
        return _LensPrior(
            np.append(free, np.ones(shapes, bool)),
            np.concatenate([mean, none], axis=1),
            np.concatenate([sigma, none + 1], axis=1),
            whole,
        )

    def off(self, numbers: Floats) -> Floats:
        """How far (M, n) numbers are from their mean, in units."""
        return np.where(self.free, (numbers - self.mean) / self.unit, 0.0)

    def cost(self, numbers: Floats) -> Floats:
        """Minus twice the logarithm (M,) of the density."""
        off = self.off(numbers)
        return np.einsum("mi,mij,mj->m", off, self.information, off)


@dataclass(frozen=True, eq=False)
class _Rows:
    """residuals (M, V, 2P), and their negative slopes by lens and shape (M, V, 2P, n) and the poses (M, V, 2P, 6),
    all over sigma and freed of what a View's pixels share; zero where unseen."""

    residuals: Floats
    own: Floats
    pose: Floats

    def take(self, other: "_Rows", rows: Mask) -> None:
        """Put those rows of another in."""
        for name in ("residuals", "own", "pose"):
            getattr(self, name)[rows] = getattr(other, name)[rows]


def _linearised(views: LensViews, numbers: Floats, poses: Pose) -> _Rows:
    points, pixels = _shaped(views, numbers[:, 9:])
    rotated = points @ np.swapaxes(poses.rotation, -1, -2)
    seen, by_lens, by_point = project_with_derivatives(
        numbers[:, None, None, :9], rotated + poses.translation[..., None, :], views.model
    )
    by_field = np.broadcast_to(views.by_field, (len(numbers), *views.by_field.shape))
    scale = np.where(views.seen, 1 / views.sigma[:, None], 0.0)[..., None, None]
    # One array, so that all are freed together of what a View's pixels share.
    rows = np.concatenate(
        [
            (pixels - seen)[..., None],
            by_lens,
            by_point @ poses.rotation[:, :, None] @ views.by_sheet,
            by_field,
            -by_point @ cross_matrix(rotated),
            by_point,
        ],
        axis=-1,
    )
    # Behind the camera there is no pixel: the sum of squares is none either, and the step is not taken.
    rows = np.where(views.seen[..., None, None], rows * scale, 0.0)
    members, count, points = rows.shape[:3]
    if views.common.any():
        flat = rows.reshape(members * count, points, 2, -1)
        rows = whitened(flat, np.tile(views.common, (members, 1, 1))).reshape(rows.shape)
    rows = rows.reshape(members, count, 2 * points, -1)
    return _Rows(rows[..., 0].copy(), rows[..., 1:-6], rows[..., -6:])


def _search(views: LensViews, numbers: Floats, poses: Pose, prior: _LensPrior) -> LensFits:
    """Levenberg and Marquardt's method, each member with its own damping, the poses eliminated (Schur complement)."""
    poses = Pose(poses.rotation.copy(), poses.translation.copy())
    numbers, rows = numbers.copy(), _linearised(views, numbers, poses)
    data, damping = (rows.residuals**2).sum(axis=(1, 2)), Damping.of(np.full(len(numbers), _FIRST_DAMPING))
    cost, moving = data + prior.cost(numbers), np.isfinite(data)
    converged = np.zeros(len(numbers), bool)
    for _ in range(_MOST_STEPS):
        step, pose_step, promised = _step(_quadratic(rows), prior, numbers, damping.value)
        step, pose_step = np.where(moving[:, None], step, 0.0), np.where(moving[:, None, None], pose_step, 0.0)
        new_numbers, new_poses = numbers + step, poses.retract(pose_step)
        new = _linearised(views, new_numbers, new_poses)
        new_data = (new.residuals**2).sum(axis=(1, 2))
        new_cost = new_data + prior.cost(new_numbers)
        gained = gain(cost, new_cost, promised)
        better = moving & (gained > 0) & (new_numbers[:, 0] > 0)
        numbers[better], data[better], cost[better] = new_numbers[better], new_data[better], new_cost[better]
        poses.rotation[better], poses.translation[better] = new_poses.rotation[better], new_poses.translation[better]
        rows.take(new, better)
        done = moving & (promised >= 0) & (promised < _CONVERGED)
        damping = damping.after(gained)
        converged |= done
        moving = moving & ~done & (damping.value < MOST_DAMPING) & np.isfinite(promised)
        if not moving.any():
            break
    return _freed_of_poses(numbers, poses, rows, converged)


def _freed_of_poses(numbers: Floats, poses: Pose, rows: _Rows, converged: Mask) -> LensFits:
    """The fits with what their rows say of lens and shape when the poses follow.

    By projection: differences of normal equations would leave information below zero where lens and pose are hard to
    separate. Where a search ended short of its maximum, along a curved valley, the poses have a step left.
    """
    whole = np.all(np.isfinite(rows.pose), axis=(-1, -2)) & np.all(np.isfinite(rows.own), axis=(-1, -2))
    pose_rows = np.where(whole[..., None, None], rows.pose, 0.0)
    both = np.where(whole[..., None, None], np.concatenate([rows.own, rows.residuals[..., None]], axis=-1), 0.0)
    base, triangle = np.linalg.qr(pose_rows)
    # The sign of each row is free.
    sign = np.where(np.diagonal(triangle, axis1=-2, axis2=-1) < 0, -1.0, 1.0)
    base, triangle = base * sign[..., None, :], triangle * sign[..., None]
    along = np.swapaxes(base, -1, -2) @ both
    across = both - base @ along
    across_t = np.swapaxes(across, -1, -2)
    square = (across_t @ across).sum(axis=1)
    inverse = np.asarray(np.linalg.inv(_regular(triangle)), float)
    lost = ~np.all(whole, axis=1)
    return LensFits(
        numbers[:, :9],
        numbers[:, 9:],
        poses,
        np.where(lost, np.inf, square[:, -1, -1]),
        square[:, :-1, -1],
        square[:, :-1, :-1],
        -inverse @ along[..., :-1],
        inverse @ np.swapaxes(inverse, -1, -2),
        converged,
    )


_Quadratic = tuple[Floats, Floats, Floats, Floats, Floats]


def _quadratic(rows: _Rows) -> _Quadratic:
    """Information on lens and shape (M, n, n), between them and the poses (M, V, n, 6), on the poses (M, V, 6, 6);
    the slopes (M, n) and (M, V, 6)."""
    own_t, pose_t = np.swapaxes(rows.own, -1, -2), np.swapaxes(rows.pose, -1, -2)
    residuals = rows.residuals[..., None]
    return (
        (own_t @ rows.own).sum(axis=1),
        own_t @ rows.pose,
        pose_t @ rows.pose,
        (own_t @ residuals)[..., 0].sum(axis=1),
        (pose_t @ residuals)[..., 0],
    )


def _step(
    quadratic: _Quadratic, prior: _LensPrior, numbers: Floats, damping: Floats
) -> tuple[Floats, Floats, Floats]:
    """Steps of lens and shape (M, n) and of the poses (M, V, 6), and by how much they are to lower the cost (M,)."""
    own, mixed, pose_blocks, pull, pose_pull = quadratic
    unit, free = prior.unit, prior.free
    own = np.where(free[:, None] & free, own * unit[:, :, None] * unit[:, None, :], 0.0) + prior.information
    mixed = np.where(free[:, None], mixed * unit[:, None, :, None], 0.0)
    pull = np.where(free, pull * unit, 0.0) - (prior.information @ prior.off(numbers)[..., None])[..., 0]
    more = damping[:, None, None]
    damped = pose_blocks * (1 + more[:, None] * np.eye(6))
    right = np.concatenate([np.swapaxes(mixed, -1, -2), pose_pull[..., None]], axis=-1)
    solved = np.linalg.solve(_regular(damped), right)
    reduced = own * (1 + more * np.eye(own.shape[1])) - (mixed @ solved[..., :-1]).sum(axis=1)
    rest = pull - (mixed @ solved[..., -1:])[..., 0].sum(axis=1)
    step = np.linalg.solve(_regular(reduced), rest[..., None])[..., 0]
    pose_step = solved[..., -1] - (solved[..., :-1] @ step[:, None, :, None])[..., 0]
    promised = (pull * step).sum(axis=1) + (pose_pull * pose_step).sum(axis=(1, 2))
    return step * unit, pose_step, promised


def _regular(matrices: Floats) -> Floats:
    """The matrices (..., n, n), but where they are none (points behind the camera) the unit matrix: its member is
    lost anyway, and must not cost the others an answer."""
    usable = np.isfinite(matrices).all(axis=(-1, -2)) & (matrices[..., 0, 0] > 0)
    return np.where(usable[..., None, None], matrices, np.eye(matrices.shape[-1]))
