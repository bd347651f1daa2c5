"""Worlds of bodies, simulated: rectangles fixed to each other, of which nobody knows where they are.

carried: four cameras that look outward, carried through a room with twelve A4 sheets on its walls for a minute.
rolling: the same rigs in the same rooms, every other camera 20 ms late, all of them read out at 20 us a row.
turntable: a box of tags turns before two cameras that look at it. back to back: two cameras that each see their own
board of a room alone. vehicle: the same on a plane floor, where it turns about one axis alone: where the cameras
stand along it cannot be known. Noise 0.2 px, lenses not known, sheets as printers make them.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from simulated import HEIGHT, WIDTH, Simulated, facing
from worlds import Lens, Room, stack

from quadrig.single import Rectangle
from quadrig.single.arrays import Floats
from quadrig.single.lens import image_middle
from quadrig.single.markings.boards import board_points
from quadrig.single.pose import Pose
from quadrig.single.rotation import rotation_from_vector

# Noise of a corner, px; framesets a second.
NOISE, _RATE = 0.2, 10.0
# Late by so much, s, are some cameras of the rolling world; all take so long for a row, s.
LATE, LINE = 0.02, 20e-6
# Rows and the instants they are read at agree to a millionth of a pixel after so many rounds.
_ROUNDS = 4
# A4 sheets lie across; boards are those of benchmarks/worlds.py.
_A4, _BOARD = (0.297, 0.21), (9, 7, 0.06)


Path = Callable[[float], Pose]
"""Where something is at a time, s."""


def path(rng: np.random.Generator, framesets: int, reach: Floats, turn: Floats, around: bool = False) -> Path:
    """world_from_rig of a smooth walk about the world's origin: reach (3,) m along and turn (3,) rad about each axis,
    y being down, with the slow sway of somebody who walks."""
    seconds = np.arange(framesets) / _RATE

    def wander(size: Floats) -> Callable[[float], Floats]:
        rates, phases = rng.uniform(0.05, 0.4, (3, 4)), rng.uniform(0, 2 * np.pi, (3, 4))
        sizes = rng.normal(size=(3, 4))

        def sums(at: Floats) -> Floats:
            return (sizes[..., None] * np.sin(2 * np.pi * rates[..., None] * at + phases[..., None])).sum(axis=1)

        scale = size / np.abs(sums(seconds)).max(axis=1)
        return lambda time: scale * sums(np.array([time]))[:, 0]

    tilt, place = wander(turn), wander(reach)
    turns = 2 * np.pi * framesets / 200 / max(float(seconds[-1]), 1e-9) * around

    def at(time: float) -> Pose:
        sway = tilt(time)
        heading = rotation_from_vector(np.array([0.0, turns * time + sway[1], 0.0]))
        return Pose(heading @ rotation_from_vector(np.array([sway[0], 0.0, sway[2]])), place(time))

    return at


def _outward(rng: np.random.Generator, count: int) -> list[Pose]:
    """rig_from_camera of cameras on a frame that look away from each other."""
    angles = 2 * np.pi * np.arange(count) / count + 0.05 * rng.normal(size=count)
    out = [np.array([np.sin(a), 0.1 * rng.normal(), np.cos(a)]) for a in angles]
    return [facing(0.15 * o + 0.02 * rng.normal(size=3), 3 * o) for o in out]


def _room(rng: np.random.Generator, count: int, size: tuple[float, float]) -> dict[Rectangle, Pose]:
    """Sheets on the walls of a room of 5 by 4 m, by world_from_rect."""
    sheets = {}
    for number in range(count):
        angle = 2 * np.pi * (number + rng.uniform(-0.3, 0.3)) / count
        way = np.array([np.sin(angle), 0.0, np.cos(angle)])
        far = 1 / max(abs(way[0]) / 2.5, abs(way[2]) / 2.0)
        place = far * way + [0, rng.uniform(-0.6, 0.6), 0]
        wall = np.zeros(3)
        wall[[0, 2]] = -np.sign(way[[0, 2]]) * (np.abs(way[[0, 2]]) * far > [2.49, 1.99])
        turn = rotation_from_vector(0.1 * rng.normal(size=3))
        pose = Pose(turn @ facing(place + wall, place).rotation, place)
        sheets[Rectangle(f"sheet{number:02d}", *size, moving=True, body="room")] = pose
    return sheets


@dataclass(frozen=True, eq=False)
class Carried:
    """A rig and bodies that move against it, simulated; rig_from_camera (C,). clocks (C, 2): how late the middle row
    of each camera is taken, s, and the time of a row, s."""

    made: Simulated
    lenses: Floats
    rig_from_camera: Pose
    clocks: Floats = field(default_factory=lambda: np.zeros((0, 2)))

    def true(self, reference: int, camera: int) -> Pose:
        """The pose of a camera in the frame of another."""
        return self.rig_from_camera[reference].inverse() @ self.rig_from_camera[camera]


def _seen(
    rng: np.random.Generator,
    lens: Lens,
    cameras: list[Pose],
    framesets: int,
    bodies: dict[str, tuple[dict[Rectangle, Pose], Path]],
    *,
    sees: Callable[[int, Rectangle], bool] | None = None,
    points: Floats | None = None,
    clocks: Floats | None = None,
) -> Carried:
    """What cameras (rig_from_camera) see of bodies: their rectangles (body_from_rect) and rig_from_body. clocks
    (C, 2): as Carried has them; then the Views are stamped."""
    room = Room(rng, lens, cameras, NOISE)
    clocks, stamps = (np.zeros((len(cameras), 2)), np.nan) if clocks is None else (clocks, 1.0)
    for sheets, rig_from_body in bodies.values():
        for rectangle, on_body in sheets.items():
            room.add(rectangle, points)
            true, seen = room.true[rectangle.name], rectangle.corners if points is None else points
            for frameset in range(framesets):
                time = frameset / _RATE
                room.places[rectangle.name].append(rig_from_body(time) @ on_body)
                for camera in range(len(cameras)):
                    if sees is None or sees(camera, rectangle):
                        late, line = clocks[camera]
                        place = rig_from_body(time + late) @ on_body
                        moved = _read_out(room, camera, (rig_from_body, on_body), time + late, line, true)
                        room.look(camera, rectangle, seen, place, frameset, moved, time * stamps)
    made = room.made()
    return Carried(made, made.lenses, stack(cameras), clocks)


def _read_out(room: Room, camera: int, moves: tuple[Path, Pose], time: float, line: float, points: Floats) -> Floats:
    """Points (P, 3) of a sheet in the frame that it has at a time (s), where they are as their own rows are read."""
    rig_from_body, on_body = moves
    place, moved = rig_from_body(time) @ on_body, points
    if not line:
        return points
    for _ in range(_ROUNDS):
        seen = room.pixels(camera, place, moved)[:, 1]
        if not np.isfinite(seen).any():
            return points
        rows = np.nan_to_num(seen - image_middle(WIDTH, HEIGHT)[1])
        there = [
            (rig_from_body(time + line * row) @ on_body).transform(point)
            for row, point in zip(rows, points, strict=True)
        ]
        moved = place.inverse().transform(np.array(there))
    return moved


def carried(rng: np.random.Generator, lens: Lens, framesets: int = 600, clocks: Floats | None = None) -> Carried:
    """Four cameras carried through a room; clocks (C, 2): as Carried has them."""
    way = path(rng, framesets, np.array([0.7, 0.15, 0.6]), np.array([0.25, 0.2, 0.2]), around=True)
    body = _room(rng, 12, _A4), lambda time: way(time).inverse()
    return _seen(rng, lens, _outward(rng, 4), framesets, {"room": body}, clocks=clocks)


def rolling(rng: np.random.Generator, lens: Lens, framesets: int = 600) -> Carried:
    """The same, out of step and read out row by row."""
    return carried(rng, lens, framesets, np.array([[LATE * (camera % 2), LINE] for camera in range(4)]))


def back_to_back(rng: np.random.Generator, lens: Lens, framesets: int = 120) -> Carried:
    """Two cameras that look away from each other, each at its own board, turned about all axes."""
    way = path(rng, framesets, np.array([0.25, 0.2, 0.25]), np.array([0.35, 0.35, 0.35]))
    return _each_its_board(rng, lens, framesets, way)


def vehicle(rng: np.random.Generator, lens: Lens, framesets: int = 120) -> Carried:
    """The same on a plane floor, turning about one axis."""
    way = path(rng, framesets, np.array([0.25, 0.0, 0.25]), np.array([0.0, 0.35, 0.0]))
    return _each_its_board(rng, lens, framesets, way)


def spinning(rng: np.random.Generator, lens: Lens, framesets: int = 120) -> Carried:
    """The same on a turntable, about one fixed axis: what nobody could find, so no world of the benchmark."""
    way = path(rng, framesets, np.zeros(3), np.array([0.0, 0.35, 0.0]))
    return _each_its_board(rng, lens, framesets, lambda time: Pose(way(time).rotation, np.zeros(3)))


def _each_its_board(rng: np.random.Generator, lens: Lens, framesets: int, way: Path) -> Carried:
    boards = {}
    for number, side in enumerate((1.0, -1.0)):
        place = np.array([0.0, 0.0, 1.3 * side])
        pose = Pose(rotation_from_vector(0.2 * rng.normal(size=3)) @ facing(np.zeros(3), place).rotation, place)
        boards[Rectangle(f"board{number}", 0.54, 0.42, moving=True, body="room")] = pose
    body = boards, lambda time: way(time).inverse()
    return _seen(
        rng,
        lens,
        _outward(rng, 2),
        framesets,
        {"room": body},
        sees=lambda camera, rectangle: rectangle.name == f"board{camera}",
        points=board_points(*_BOARD),
    )


def turntable(rng: np.random.Generator, lens: Lens, framesets: int = 120) -> Carried:
    """A box of tags that turns before two cameras."""
    side = 0.2
    turns = [np.zeros(3), *(np.array([0.0, k * np.pi / 2, 0.0]) for k in (1, 2, 3)), np.array([np.pi / 2, 0.0, 0.0])]
    sheets = {}
    for number, turn in enumerate(turns):
        rotation = rotation_from_vector(turn) @ rotation_from_vector(0.02 * rng.normal(size=3))
        sheets[Rectangle(f"tag{number}", 0.16, 0.16, moving=True, body="box")] = Pose(
            rotation, -side / 2 * rotation[:, 2]
        )
    axis = Pose(rotation_from_vector(np.array([-0.4, 0.0, 0.0])), np.array([0.0, 0.0, 1.0]))
    speed = 2 * np.pi / framesets * _RATE

    def turning(time: float) -> Pose:
        return axis @ Pose(rotation_from_vector(np.array([0.0, speed * time, 0.0])), np.zeros(3))

    cameras = [Pose.identity(), facing(np.array([0.5, -0.1, 0.1]), np.array([0.0, 0.0, 1.0]))]
    return _seen(rng, lens, cameras, framesets, {"box": (sheets, turning)})


WORLDS = {
    "carried": carried,
    "turntable": turntable,
    "vehicle": vehicle,
    "back to back": back_to_back,
    "rolling": rolling,
}
