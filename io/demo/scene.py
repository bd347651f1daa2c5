"""The room of `rig demo`: four distorted cameras, tags on a table and on the walls, a board in somebody's hands.

Its world has z up and its origin in the middle of the floor. Everything here is the truth the demo is judged by.
"""

from dataclasses import dataclass

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.lens import Intrinsics, image_middle
from quadrig.single.markings.blank_sheet import PlainMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.picture import Sheet
from quadrig.single.render.room import Room

WIDTH, HEIGHT = 1280, 720
ROOM = Room(width=6.0, depth=6.0, height=2.8)
BOARD = "board"

_TABLE_HEIGHT = 0.74
_DICTIONARY = "apriltag_36h11"
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class SceneCamera:
    """A camera of the room as it truly is."""

    name: str
    intrinsics: Intrinsics
    world_from_camera: Pose


@dataclass(frozen=True, eq=False)
class Scene:
    """The room as it truly is. static: the sheets that stay; board: the hand-held board; furniture: what is only
    seen; board_poses: world_from_rect of the board, one for each frameset."""

    cameras: tuple[SceneCamera, ...]
    static: tuple[Sheet, ...]
    board: Rectangle
    board_poses: tuple[Pose, ...]
    furniture: tuple[Sheet, ...]

    @property
    def rectangles(self) -> tuple[Rectangle, ...]:
        """Every rectangle whose size is known."""
        return (*(sheet.rectangle for sheet in self.static), self.board)

    def sheets(self, frameset: int) -> list[Sheet]:
        """All that stands or is held in the room in one frameset."""
        return [*self.furniture, *self.static, Sheet(self.board, self.board_poses[frameset])]


def demo_scene(framesets: int = 24) -> Scene:
    """The demo's room over this many framesets."""
    return Scene(_cameras(), _static_sheets(), _board(), _board_path(framesets), (_table(),))


def looking(position: Floats, direction: Floats, up: Floats = _UP) -> Pose:
    """Pose world_from_x at a position (3,) m with z along `direction` and y away from `up`: of a camera that looks
    there, or of a sheet that is read while one looks there."""
    z = np.asarray(direction, float) / np.linalg.norm(direction)
    x = np.cross(z, up)
    x = x / np.linalg.norm(x)
    return Pose(np.stack([x, np.cross(z, x), z], axis=-1), np.asarray(position, float))


def _cameras() -> tuple[SceneCamera, ...]:
    # focal, principal point's offset, k1, k2; azimuth (degrees) around the table, distance and height (m).
    table = [
        (780.0, (6.0, -4.0), -0.18, 0.040, -64.0, 2.3, 2.40),
        (860.0, (-8.0, 5.0), -0.12, 0.020, -23.0, 2.1, 2.20),
        (940.0, (4.0, 9.0), -0.22, 0.050, 20.0, 2.4, 2.50),
        (700.0, (-5.0, -7.0), -0.08, 0.010, 66.0, 2.0, 2.30),
    ]
    return tuple(_camera(index, *row) for index, row in enumerate(table))


def _camera(
    index: int,
    focal: float,
    offset: tuple[float, float],
    k1: float,
    k2: float,
    azimuth: float,
    distance: float,
    height: float,
) -> SceneCamera:
    centre = image_middle(WIDTH, HEIGHT) + offset
    intrinsics = Intrinsics(WIDTH, HEIGHT, focal, centre, np.array([k1, k2, 0.0, 0.0, 0.0]))
    angle = np.radians(azimuth)
    position = np.array([distance * np.sin(angle), -distance * np.cos(angle), height])
    return SceneCamera(f"cam{index}", intrinsics, looking(position, np.array([0.0, 0.15, 0.95]) - position))


def _static_sheets() -> tuple[Sheet, ...]:
    table = [("desk_left", -0.60, -0.17, 10.0), ("desk_middle", 0.0, 0.20, -25.0), ("desk_right", 0.58, -0.13, 35.0)]
    sheets = [
        _tag_sheet(name, index, 0.20, np.array([x, y, _TABLE_HEIGHT + 0.001]), -_UP, _heading(turn))
        for index, (name, x, y, turn) in enumerate(table)
    ]
    walls = [
        ("wall_back", 0.35, np.array([-0.5, 2.99, 1.25]), np.array([0.0, 1.0, 0.0])),
        ("wall_left", 0.35, np.array([-2.99, 1.2, 1.35]), np.array([-1.0, 0.0, 0.0])),
        ("wall_right", 0.35, np.array([2.99, 1.1, 1.15]), np.array([1.0, 0.0, 0.0])),
    ]
    for index, (name, size, position, direction) in enumerate(walls, start=len(sheets)):
        sheets.append(_tag_sheet(name, index, size, position, direction, _UP))
    return tuple(sheets)


def _tag_sheet(name: str, tag: int, size: float, position: Floats, direction: Floats, up: Floats) -> Sheet:
    rectangle = Rectangle(name, size, size, TagMarking(_DICTIONARY, tag))
    return Sheet(rectangle, looking(position, direction, up))


def _heading(degrees: float) -> Floats:
    angle = np.radians(degrees)
    return np.array([np.sin(angle), np.cos(angle), 0.0])


def _board() -> Rectangle:
    marking = CharucoMarking(7, 5, 0.08, 0.06, "aruco_4x4_50")
    return Rectangle(BOARD, 7 * marking.square, 5 * marking.square, marking, moving=True)


def _board_path(framesets: int) -> tuple[Pose, ...]:
    """A board shown to the cameras: wanders over the table, faces each of them in turn, tilts and rolls."""
    # Rates whose ratios are no small fractions: the path does not repeat itself within the recording.
    turn = np.linspace(0, 2 * np.pi, framesets, endpoint=False)
    poses = []
    for t in turn:
        position = np.array(
            [0.85 * np.sin(2.1 * t), -0.25 + 0.55 * np.cos(3.3 * t), 1.20 + 0.38 * np.sin(5.2 * t + 1)]
        )
        facing = np.radians(48 * np.sin(1.3 * t + 0.4))
        tilt = np.radians(28 + 20 * np.sin(4.1 * t))
        direction = np.array([-np.sin(facing) * np.cos(tilt), np.cos(facing) * np.cos(tilt), -np.sin(tilt)])
        roll = np.radians(30 * np.sin(2.7 * t))
        poses.append(looking(position, direction, np.array([np.sin(roll), 0.0, np.cos(roll)])))
    return tuple(poses)


def _table() -> Sheet:
    top = Rectangle("table", 1.7, 0.95, PlainMarking())
    return Sheet(top, looking(np.array([0.0, 0.0, _TABLE_HEIGHT]), -_UP, np.array([0.0, 1.0, 0.0])), tone=0.30)
