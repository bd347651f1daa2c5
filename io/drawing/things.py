"""What is drawn as one thing: a rectangle by itself, or all rectangles of a body that moves; and a room as a map."""

from dataclasses import dataclass

import numpy as np

from quadrig.io.drawing.geometry import RING, Eye, up_direction
from quadrig.rig.result import PlacedBody, Rig, pose_sigmas
from quadrig.single.arrays import Floats, Ints
from quadrig.single.pose import Pose

# A path is not drawn on where nothing was seen for so many times longer than usual.
_LONG_GAP = 4


@dataclass(frozen=True, eq=False)
class Thing:
    """Outlines (F, K, 5, 3) in the rig frame of the K rectangles of one thing: at each of its framesets (F,), or once
    where it stands still and has none."""

    name: str
    rings: Floats
    framesets: Ints

    @property
    def moves(self) -> bool:
        """Whether it has another place in each frameset."""
        return len(self.framesets) > 0

    def at(self, frameset: int) -> Floats | None:
        """Its outlines (K, 5, 3) at a frameset; None where it was not seen there."""
        rows = np.flatnonzero(self.framesets == frameset)
        return self.rings[rows[0]] if len(rows) else None


def things(rig: Rig) -> list[Thing]:
    """All that a rig has around it, but for a room that it is carried through: that has a map. What stands on a body
    that stands still is drawn by itself."""
    bodies = [body for body in rig.bodies if len(body.framesets)]
    joined = {name for body in bodies for name in body.rectangles}
    result = [_body(rig, body) for body in bodies if body is not rig.room]
    for placed in rig.rectangles:
        if placed.name not in joined:
            pose = placed.rig_from_rect if len(placed.framesets) else placed.rig_from_rect[None]
            rings = pose[:, None, None].transform(placed.rectangle.corners[RING])
            result.append(Thing(placed.name, rings, np.asarray(placed.framesets)))
    return result


def _body(rig: Rig, body: PlacedBody) -> Thing:
    _, rings = layout(rig, body)
    return Thing(body.name, body.rig_from_body[:, None, None].transform(rings), np.asarray(body.framesets))


def layout(rig: Rig, body: PlacedBody) -> tuple[list[int], Floats]:
    """The rows of rectangles whose size is known, and their outlines (K, 5, 3) in the body's frame."""
    corners = {placed.name: placed.rectangle.corners[RING] for placed in rig.rectangles}
    rows = [row for row, name in enumerate(body.rectangles) if name in corners]
    rings = [body.body_from_rect[row].transform(corners[body.rectangles[row]]) for row in rows]
    return rows, np.array(rings).reshape(-1, 5, 3)


@dataclass(frozen=True, eq=False)
class RoomMap:
    """A room that a rig was carried through, in its frame. names (K,) and rings (K, 5, 3) of its rectangles,
    covariances (K, 3, 3) of where they are; room_from_rig (F,) and framesets (F,), sigmas (F,) of its positions, m;
    axes: rows right, ahead and up (3, 3), with most walls along them."""

    names: tuple[str, ...]
    rings: Floats
    covariances: Floats
    room_from_rig: Pose
    framesets: Ints
    sigmas: Floats
    axes: Floats

    def stretches(self) -> list[Floats]:
        """The path of the rig (N, 3), in stretches without long gaps."""
        if len(self.framesets) < 2:
            return [self.room_from_rig.translation]
        gaps = np.diff(self.framesets)
        return np.split(self.room_from_rig.translation, 1 + np.flatnonzero(gaps > _LONG_GAP * np.median(gaps)))

    def points(self) -> Floats:
        """All corners and places (N, 3)."""
        return np.concatenate([self.rings.reshape(-1, 3), self.room_from_rig.translation])

    @property
    def extent(self) -> float:
        """Diagonal of its bounds, m."""
        return float(np.linalg.norm(np.ptp(self.points(), axis=0)))

    def eye(self) -> Eye:
        """From high above one side, into it."""
        points, (right, ahead, up) = self.points(), self.axes
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        return Eye(middle + self.extent * (0.1 * right - 0.44 * ahead + 0.52 * up), middle, up)


def room_map(rig: Rig, body: PlacedBody) -> RoomMap:
    """The map of a body that is a room."""
    rows, rings = layout(rig, body)
    path, covariance = body.path()
    count = len(body.rectangles)
    blocks = body.layout_covariance.reshape(count, 6, count, 6)[rows, :, rows]
    axes = _level_axes(path, body.body_from_rect.rotation[:, :, 2], up_direction(rig))
    names = tuple(body.rectangles[row] for row in rows)
    return RoomMap(names, rings, blocks[:, 3:, 3:], path, body.framesets, pose_sigmas(covariance)[1], axes)


def _level_axes(room_from_rig: Pose, facing: Floats, rig_up: Floats) -> Floats:
    """Up is where the rig has it on the whole; right and ahead are turned to the walls (facing (K, 3): into them)."""
    up = (room_from_rig.rotation @ rig_up).mean(axis=0)
    size = np.linalg.norm(up)
    up = up / size if size > 0 else np.array([0.0, -1.0, 0.0])
    right = np.cross([1.0, 0.0, 0.0] if abs(up[0]) < 0.7 else [0.0, 0.0, 1.0], up)
    right = right / np.linalg.norm(right)
    ahead = np.cross(up, right)
    # Walls stand at right angles: the mean of four times their angle says where.
    across = facing @ right + 1j * (facing @ ahead)
    turn = np.angle(np.sum(across**4)) / 4
    right, ahead = np.cos(turn) * right + np.sin(turn) * ahead, np.cos(turn) * ahead - np.sin(turn) * right
    return np.stack([right, ahead, up])
