"""Where to hold the sheet next: of many placements the cameras can see, the one that lowers the rig's doubt most.

The doubt is the mean variance of points triangulated in the working volume (A-optimal design for the rig's use, after
Fedorov, Theory of Optimal Experiments, 1972). A placement's drop follows from the present covariance in closed form
(Woodbury), so that a thousand placements cost some tens of milliseconds.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.rig.doubt.information import (
    camera_derivatives,
    rectangle_derivatives,
    triangulation_derivatives,
    visible,
)
from quadrig.rig.doubt.working_accuracy import similarity_basis, similarity_part
from quadrig.rig.result import CAMERA_PARAMETERS, Camera
from quadrig.single.arrays import Floats, Ints, Mask
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle, rectangle_corners
from quadrig.single.rotation import rotation_from_vector

# Parts of the picture in which a sheet is imagined: its middle, its sides and its corners, so far out that the
# sheet is still whole.
_REGIONS = tuple((column, row) for row in (-1, 0, 1) for column in (-1, 0, 1))
_REGION_REACH = 0.62
# How much of the picture's width the sheet takes: nearer is blurred and crowded, farther is badly measured.
FILLS = (0.12, 0.2, 0.32, 0.5)
# Distances of imagined sheets, as multiples of the distance at which they have been.
_AS_FAR = np.array([0.75, 1.0, 1.25])
# A tilt a person holds by eye; beyond 55 degrees tags are read less surely.
_TILT = np.deg2rad(40)
_TILTS = ((0.0, 0.0), (_TILT, 0.0), (-_TILT, 0.0), (0.0, _TILT), (0.0, -_TILT))
# A sheet seen more obliquely than this, or smaller than this, is not counted on to be found.
_MOST_OBLIQUE = np.cos(np.deg2rad(62))
_LEAST_SIDE = 28.0
_MARGIN = 12.0
# A person holds a sheet this near (m) to where a ghost is drawn, and turned this little (rad) from it.
_HAND, _WRIST = 0.06, 0.12
# The placements that look best are looked at again as a person would hold them.
_SECOND_LOOK = 24
# More cameras than this in one view of a placement add little to the order of the placements, but cost their cube.
_MOST_CAMERAS = 6
# So many points stand for a board, whose many corners only average the noise further down.
_GRID = 3
# Metres beyond where the sheet has been: farther out the covered volume would grow to where less is known, faster
# than the doubt in it falls; tried from 0 to 0.5 on simulated rigs.
_REACH = 0.2


@dataclass(frozen=True, eq=False)
class Placements:
    """B imagined placements of one rectangle. rig_from_rect: (B,) poses.

    camera (B,): index of the camera in whose picture it was imagined; region (B, 2): column and row, -1 to 1; fill
    (B,): part of the picture's width; tilt (B, 2): radians about the sheet's x and y, against that camera.
    toward (B,): index of a second camera it faces as much, or -1.
    """

    rectangle: Rectangle
    rig_from_rect: Pose
    camera: Ints
    region: Floats
    fill: Floats
    tilt: Floats
    toward: Ints

    def __len__(self) -> int:
        return len(self.camera)

    def __getitem__(self, index: Ints | Mask | slice) -> "Placements":
        """Some of the placements."""
        return Placements(
            self.rectangle,
            self.rig_from_rect[index],
            self.camera[index],
            self.region[index],
            self.fill[index],
            self.tilt[index],
            self.toward[index],
        )


def planning_points(rectangle: Rectangle) -> tuple[Floats, float]:
    """Points (P, 3) that stand for the rectangle when planning, and the factor on the pixel sigma.

    Its own points where they are few; else three by three over them, and more of them lower the sigma.
    """
    points = rectangle.marking.points(rectangle)
    if len(points) <= _GRID**2:
        return points, 1.0
    x, y, _ = np.linspace(points.min(axis=0), points.max(axis=0), _GRID).T
    grid_y, grid_x = np.meshgrid(y, x, indexing="ij")
    grid = np.stack([grid_x.ravel(), grid_y.ravel(), np.zeros(grid_x.size)], axis=-1)
    return grid, float(np.sqrt(len(grid) / len(points)))


def imagine(cameras: Sequence[Camera], rectangle: Rectangle, been: Floats | None = None) -> Placements:
    """Placements in each camera's picture, by region, size and tilt, and facing between it and each other camera.

    been (N, 3): where the sheet has been; placements as far from each camera as that are among them.
    """
    parts = [_imagine_before(cameras, index, rectangle, been) for index in range(len(cameras))]
    rotation = np.concatenate([part.rig_from_rect.rotation for part in parts])
    translation = np.concatenate([part.rig_from_rect.translation for part in parts])
    names = ("camera", "region", "fill", "tilt", "toward")
    return Placements(
        rectangle,
        Pose(rotation, translation),
        *(np.concatenate([getattr(part, name) for part in parts]) for name in names),
    )


def _fills(camera: Camera, rectangle: Rectangle, been: Floats | None) -> Floats:
    """Parts of the picture's width: the usual ones, and those at the distances where the sheet has been."""
    if been is None or not len(been):
        return np.array(FILLS)
    distance = float(np.median(np.linalg.norm(been - camera.rig_from_camera.translation, axis=-1)))
    lens = camera.intrinsics
    return np.array([*FILLS, *(lens.focal * rectangle.width / (lens.width * distance * _AS_FAR))])


def _imagine_before(cameras: Sequence[Camera], index: int, rectangle: Rectangle, been: Floats | None) -> Placements:
    camera = cameras[index]
    lens, pose = camera.intrinsics, camera.rig_from_camera
    fills = _fills(camera, rectangle, been)
    region, fill = (a.reshape(-1, a.shape[-1]) for a in _product(np.array(_REGIONS, float), fills[:, None]))
    half = np.array([lens.width - 1, lens.height - 1]) / 2
    ray = lens.unproject(half + region * half * _REGION_REACH)
    distance = lens.focal * rectangle.width / (fill * lens.width)
    middle = pose.transform(ray * distance)
    orientations = [
        (
            _facing(middle, pose.translation, pose.rotation[:, 0]) @ rotation_from_vector(np.array([*tilt, 0.0])),
            tilt,
            -1,
        )
        for tilt in _TILTS
    ]
    for other in range(len(cameras)):
        if other != index:
            between = _between(middle, pose.translation, cameras[other].rig_from_camera.translation)
            orientations.append((_facing(middle, between, pose.rotation[:, 0]), (0.0, 0.0), other))
    count = len(orientations)
    return Placements(
        rectangle,
        Pose(np.concatenate([rotation for rotation, _, _ in orientations]), np.tile(middle, (count, 1))),
        np.full(count * len(middle), index),
        np.tile(region, (count, 1)),
        np.tile(fill[:, 0], count),
        np.repeat(np.array([tilt for _, tilt, _ in orientations]), len(middle), axis=0),
        np.repeat(np.array([toward for _, _, toward in orientations]), len(middle)),
    )


def _product(first: Floats, second: Floats) -> tuple[Floats, Floats]:
    return np.repeat(first, len(second), axis=0), np.tile(second, (len(first), 1))


def _facing(middle: Floats, viewer: Floats, right: Floats) -> Floats:
    """Rotations (N, 3, 3) of sheets at `middle` (N, 3) that a viewer sees upright and straight on."""
    z = middle - viewer
    z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    x = right - z * (z @ right)[:, None]
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _between(middle: Floats, first: Floats, second: Floats) -> Floats:
    """Viewpoints half way, in angle, between two as seen from each `middle`."""
    directions = [(p - middle) / np.linalg.norm(p - middle, axis=-1, keepdims=True) for p in (first, second)]
    return middle + directions[0] + directions[1]


def seen(cameras: Sequence[Camera], placements: Placements) -> Mask:
    """Which camera (B, C) would find the whole sheet: in its picture, from the front, large enough."""
    poses = placements.rig_from_rect
    corners = poses[:, None].transform(rectangle_corners(placements.rectangle.width, placements.rectangle.height))
    result = np.zeros((len(placements), len(cameras)), bool)
    for index, camera in enumerate(cameras):
        sight = poses.translation - camera.rig_from_camera.translation
        distance = np.linalg.norm(sight, axis=-1)
        cosine = np.einsum("bi,bi->b", sight, poses.rotation[..., 2]) / distance
        side = min(placements.rectangle.width, placements.rectangle.height)
        large = camera.intrinsics.focal * side * cosine > _LEAST_SIDE * distance
        result[:, index] = visible(camera, corners, _MARGIN).all(-1) & (cosine > _MOST_OBLIQUE) & large
    return result


def accuracy_weight(cameras: Sequence[Camera], points: Floats) -> Floats:
    """M (15 C, 15 C): trace(M covariance) is the mean variance, m^2, of the points (N, 3) that two cameras see.

    As in the working accuracy, a motion or an enlargement of all points together counts nothing.
    """
    size = len(cameras) * CAMERA_PARAMETERS
    if not len(points):
        return np.zeros((size, size))
    sees = np.stack([visible(camera, points) for camera in cameras])
    derivatives = triangulation_derivatives(cameras, points, sees)
    possible = np.isfinite(derivatives).all((1, 2))
    rows = derivatives[possible].reshape(-1, size)
    shape = rows - similarity_part(points[possible], rows)
    return shape.T @ shape / max(1, int(possible.sum()))


def expected_drop(
    cameras: Sequence[Camera],
    covariance: Floats,
    weight: Floats,
    placements: Placements,
    sees: Mask,
    sigma: float,
) -> Floats:
    """By how much (B,) each placement, once seen, lowers trace(weight covariance), m^2. sees (B, C); sigma in px."""
    rows, columns, noise = _information_rows(cameras, placements, sees, sigma)
    doubt = covariance[columns[:, :, None], columns[:, None, :]]
    target = (covariance @ weight @ covariance)[columns[:, :, None], columns[:, None, :]]
    transposed = np.swapaxes(rows, -1, -2)
    drop = np.linalg.solve(rows @ doubt @ transposed + noise, rows @ target @ transposed)
    return np.where(sees.any(1), np.trace(drop, axis1=-2, axis2=-1), 0.0)


def _information_rows(
    cameras: Sequence[Camera], placements: Placements, sees: Mask, sigma: float
) -> tuple[Floats, Ints, Floats]:
    """What each placement shows: rows (B, n, m) by the parameters at `columns` (B, m), and the noise (n, n), px^2."""
    points, factor = planning_points(placements.rectangle)
    chosen = np.argsort(~sees, axis=1, kind="stable")[
        :, : min(_MOST_CAMERAS, max(1, int(sees.sum(1).max(initial=1))))
    ]
    taken = np.take_along_axis(sees, chosen, 1)
    by_cameras, by_rectangle = _stacked_derivatives(cameras, placements, points, chosen, taken)
    # What the unknown pose of the sheet itself takes away: the part of the rows in the span of its derivatives.
    basis = np.linalg.qr(by_rectangle)[0]
    rows = by_cameras - basis @ (np.swapaxes(basis, -1, -2) @ by_cameras)
    columns = (chosen[..., None] * CAMERA_PARAMETERS + np.arange(CAMERA_PARAMETERS)).reshape(len(chosen), -1)
    return rows, columns, (sigma * factor) ** 2 * np.eye(rows.shape[1])


def own_variance(
    cameras: Sequence[Camera], covariance: Floats, volume: Floats, placements: Placements, sees: Mask, sigma: float
) -> tuple[Floats, Floats]:
    """Once each placement is seen: summed variance (B,), m^2, of its own corners and middle against the volume's
    (N, 3) frame, and how many (B,) of them two cameras have in their pictures."""
    corners = rectangle_corners(placements.rectangle.width, placements.rectangle.height)
    points = np.concatenate([corners, np.zeros((1, 3))])
    own = placements.rig_from_rect[:, None].transform(points).reshape(-1, 3)
    shape, counted = _against(cameras, volume, own)
    shape = shape.reshape(len(placements), 3 * len(points), -1)
    rows, columns, noise = _information_rows(cameras, placements, sees, sigma)
    doubt = covariance[columns[:, :, None], columns[:, None, :]]
    across = np.swapaxes(rows @ np.swapaxes(covariance[:, columns].transpose(1, 0, 2), -1, -2), -1, -2)
    inner = np.linalg.solve(rows @ doubt @ np.swapaxes(rows, -1, -2) + noise, np.swapaxes(shape @ across, -1, -2))
    before = np.einsum("bij,jk,bik->b", shape, covariance, shape, optimize=True)
    drop = np.einsum("bij,bji->b", shape @ across, inner)
    return np.maximum(before - drop, 0), counted.reshape(len(placements), -1).sum(1)


def _against(cameras: Sequence[Camera], volume: Floats, points: Floats) -> tuple[Floats, Mask]:
    """How points (M, 3) move with the parameters (M, 3, 15 C) when the volume's own rigid motion is taken out, zero
    for those that fewer than two cameras see; and which (M,) are seen by two."""
    sees = [np.stack([visible(camera, p) for camera in cameras]) for p in (volume, points)]
    known, moved = (triangulation_derivatives(cameras, p, s) for p, s in zip((volume, points), sees, strict=True))
    kept = np.all(np.isfinite(known), axis=(1, 2))
    middle = volume[kept].mean(0) if kept.any() else np.zeros(3)
    motion = np.linalg.lstsq(
        similarity_basis(volume[kept] - middle).reshape(-1, 7),
        known[kept].reshape(3 * int(kept.sum()), -1),
        rcond=None,
    )[0]
    counted = np.all(np.isfinite(moved), axis=(1, 2))
    shape = np.where(counted[:, None, None], moved - similarity_basis(points - middle) @ motion, 0.0)
    return shape, counted


def _stacked_derivatives(
    cameras: Sequence[Camera], placements: Placements, points: Floats, chosen: Ints, taken: Mask
) -> tuple[Floats, Floats]:
    """Of all pixels of each placement: by its chosen cameras (B, 2KP, 15K) and by the sheet's pose (B, 2KP, 6)."""
    count, kept, rows = len(placements), chosen.shape[1], 2 * len(points)
    in_rig = placements.rig_from_rect[:, None].transform(points)
    by_cameras = np.zeros((count, kept, rows, kept, CAMERA_PARAMETERS))
    by_rectangle = np.zeros((count, kept, rows, 6))
    for index, camera in enumerate(cameras):
        which, slot = np.nonzero((chosen == index) & taken)
        if not len(which):
            continue
        _, by_camera, by_point = camera_derivatives(camera, in_rig[which])
        by_step = rectangle_derivatives(by_point, placements.rig_from_rect[which], points)
        by_cameras[which, slot, :, slot] = by_camera.reshape(len(which), rows, -1)
        by_rectangle[which, slot] = by_step.reshape(len(which), rows, 6)
    return by_cameras.reshape(count, kept * rows, -1), by_rectangle.reshape(count, kept * rows, 6)


def within_reach(placements: Placements, been: Floats, reach: float = _REACH) -> Mask:
    """Which placements (B,) a person can be asked for without going elsewhere: in the box of the positions (N, 3) the
    sheet has been, widened by `reach` metres. All of them where none is."""
    everywhere = np.ones(len(placements), bool)
    if not len(been):
        return everywhere
    middle = placements.rig_from_rect.translation
    inside = ((middle >= been.min(0) - reach) & (middle <= been.max(0) + reach)).all(-1)
    return inside if inside.any() else everywhere


def expected_drop_in_hand(
    cameras: Sequence[Camera],
    covariance: Floats,
    weight: Floats,
    placements: Placements,
    exact: Floats,
    sigma: float,
) -> Floats:
    """expected_drop (B,) as a person holds the sheet, of what `exact` (B,) says of a sheet held without error.

    The best placements are averaged over small errors of hand and wrist, so that one at the very edge of a picture
    loses against one that is seen for sure; the others are not improved on and count nothing.
    """
    best = np.argsort(-exact, kind="stable")[:_SECOND_LOOK]
    steps = _hand_errors()
    held = placements[np.repeat(best, len(steps))]
    held = replace(held, rig_from_rect=held.rig_from_rect.retract(np.tile(steps, (len(best), 1))))
    drops = expected_drop(cameras, covariance, weight, held, seen(cameras, held), sigma)
    result = np.zeros(len(placements))
    result[best] = drops.reshape(len(best), len(steps)).mean(1)
    return result


def _hand_errors() -> Floats:
    """Steps (7, 6): none, and each way along three axes, and a rotation with each."""
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    turned = np.roll(axes, 1, axis=1)
    return np.concatenate([np.zeros((1, 6)), np.concatenate([_WRIST * turned, _HAND * axes], axis=1)])
