"""A lit room for rendered pictures: floor boards, painted walls, a window's light. No corner in it is sharp enough
to be taken for a marking."""

from dataclasses import dataclass, field

import numpy as np

from quadrig.single.arrays import Ints, Mask, Reals, Singles
from quadrig.single.pose import Pose

# Linear reflectances, blue green red.
_BOARDS = np.array([0.22, 0.32, 0.42], np.float32)
_PAINT = np.array([0.52, 0.57, 0.58], np.float32)
_ACCENT = np.array([0.47, 0.42, 0.34], np.float32)
_CEILING = np.array([0.68, 0.70, 0.70], np.float32)
_SKIRTING = np.array([0.36, 0.38, 0.40], np.float32)


@dataclass(frozen=True, eq=False)
class Room:
    """A box of width x depth x height metres; its frame has z up and its origin in the middle of the floor."""

    width: float = 6.0
    depth: float = 6.0
    height: float = 2.8
    world_from_room: Pose = field(default_factory=Pose.identity)


def room_light(rays: Singles, camera_from_world: Pose, room: Room) -> Singles:
    """What each ray (h, w, 3) of the camera frame meets: linear light (h, w, 3), blue green red, about 0 to 1.

    Rays that are nan stay dark. A camera outside the room sees one that has grown to hold it.
    """
    room_from_camera = (camera_from_world @ room.world_from_room).inverse()
    origin = room_from_camera.translation.astype(np.float32)
    direction = rays @ room_from_camera.rotation.T.astype(np.float32)
    low = np.array([-room.width / 2, -room.depth / 2, 0], np.float32)
    high = np.array([room.width / 2, room.depth / 2, room.height], np.float32)
    low, high = np.minimum(low, origin - 0.2), np.maximum(high, origin + 0.2)
    with np.errstate(divide="ignore", invalid="ignore"):
        distances = np.where(direction > 0, high - origin, low - origin) / direction
    axis = np.argmin(np.where(np.isfinite(distances), distances, np.inf), axis=-1)
    distance = np.take_along_axis(distances, axis[..., None], axis=-1)
    hit = origin + distance * direction
    light = _surface(hit, axis, direction[..., 2] > 0) * _illumination(hit, low, high)[..., None]
    return np.nan_to_num(light).astype(np.float32)


def _surface(hit: Reals, axis: Ints, up: Mask) -> Reals:
    x, y, z = hit[..., 0], hit[..., 1], hit[..., 2]
    colour = np.where((axis == 0)[..., None], _PAINT, _ACCENT)
    skirting = 1 / (1 + np.exp(np.clip((z - 0.09) * 300, -40, 40)))
    colour = colour + skirting[..., None] * (_SKIRTING - colour)
    floor = _BOARDS * _board_grain(x, y)[..., None]
    colour = np.where(((axis == 2) & ~up)[..., None], floor, colour)
    return np.where(((axis == 2) & up)[..., None], _CEILING, colour)


def _board_grain(x: Reals, y: Reals) -> Reals:
    """Floor boards 0.14 m wide: each of its own shade, with a soft grain along it and a soft joint beside it."""
    across = x / 0.14
    board = np.floor(across)
    shade = 0.10 * np.sin(board * 12.9898) + 0.05 * np.sin(board * 78.233)
    grain = 0.04 * np.sin(7 * y + 3 * np.sin(1.7 * y + board)) * np.sin(14 * across + 1.3 * board + np.sin(2.3 * y))
    joint = np.exp(-(((across - board - 0.5) ** 2 - 0.25) ** 2) / 2e-4)
    return (1 + shade + grain) * (1 - 0.35 * joint)


def _illumination(hit: Reals, low: Reals, high: Reals) -> Reals:
    """A window's light from one side, and the dusk of the edges where two faces meet."""
    share = np.clip((hit - low) / (high - low), 0, 1)
    window = 1.05 + 0.35 * np.exp(-((share[..., 0] - 0.25) ** 2 + (share[..., 1] - 0.35) ** 2) / 0.18)
    edge = 4 * share * (1 - share)
    second = np.sort(edge, axis=-1)[..., 1]
    return window * (0.72 + 0.28 * np.sqrt(np.clip(second, 0, 1)))
