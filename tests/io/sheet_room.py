"""A room with a sheet in the hand before three cameras, for tests of live sessions."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from quadrig.single.lens import Intrinsics
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.capture import Capture
from quadrig.single.render.picture import RayGrid, Sheet, ray_grid, render_image
from quadrig.single.rotation import rotation_from_vector

WIDTH, HEIGHT, RATE = 640, 360, 30


HOLDS, HELD = 9, 4


TAG = Rectangle("sheet", 0.24, 0.24, TagMarking("apriltag_36h11", 5), moving=True)


CONFIG = """reference = "cam0"
[[rectangle]]
name = "sheet"
width = 0.24
height = 0.24
moving = true
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 5 }
"""


LENSES = [Intrinsics.centred(WIDTH, HEIGHT, focal) for focal in (480.0, 520.0, 555.0)]


# On an arc of 1.5 m about a place in front of the first.
CAMERAS = [
    Pose(
        rotation_from_vector(np.array([0, -angle, 0])),
        np.array([1.5 * np.sin(angle), 0.1 * k, 1.5 - 1.5 * np.cos(angle)]),
    )
    for k, angle in enumerate((0.0, 0.45, 0.9))
]


@lru_cache
def grid(camera: int) -> RayGrid:
    """The rays of a camera: most of the work of a picture."""
    return ray_grid(LENSES[camera])


def backdrop_with_shapes() -> np.ndarray:
    """A wall with dark and light boxes: edges as every room has them, (H, W) float."""
    wall = np.full((HEIGHT, WIDTH), 0.4, np.float32)
    for x, y, light in np.random.default_rng(1).uniform(0, 1, (14, 3)):
        left, top = int(x * WIDTH), int(y * HEIGHT)
        wall[top : top + 50, left : left + 70] = 0.1 + 0.5 * light
    return wall


BACKDROP = backdrop_with_shapes()


USUAL = Capture(blur=0.6, noise=1.5)


BOARD = Rectangle("board", 0.40, 0.30, CharucoMarking(4, 3, 0.1, 0.075, "aruco_4x4_50"), moving=True)


BOARD_CONFIG = """reference = "cam0"
[[rectangle]]
name = "board"
moving = true
marking = { kind = "charuco", columns = 4, rows = 3, square = 0.1, marker = 0.075, dictionary = "aruco_4x4_50" }
"""


def held_poses() -> list[Pose]:
    rng = np.random.default_rng(3)
    middle = np.array([0.0, 0.05, 1.5])
    facing = rotation_from_vector(np.array([0, -0.45, 0]))
    return [
        Pose(
            facing @ rotation_from_vector(rng.uniform(-0.6, 0.6, 3)), middle + rng.uniform(-0.2, 0.2, 3) * [1, 0.6, 1]
        )
        for _ in range(HOLDS)
    ]


def carried(time: float) -> Pose:
    """The board on its way at a tenth of a metre a second or so."""
    position = [0.25 * np.sin(0.66 * time), 0.05 + 0.12 * np.sin(0.9 * time + 1), 1.5 + 0.2 * np.sin(0.42 * time + 2)]
    rotation = [0.4 * np.sin(0.54 * time), -0.45 + 0.4 * np.sin(0.72 * time + 1), 0.3 * np.sin(0.36 * time)]
    return Pose.from_vectors(np.array(rotation), np.array(position))


def picture(camera: int, pose: Pose, rectangle: Rectangle = TAG) -> np.ndarray:
    sheet = Sheet(rectangle, pose)
    return render_image(grid(camera), CAMERAS[camera].inverse(), [sheet], samples=2, capture=USUAL, colour=False)


def shown(camera: int, pose: Pose, rectangle: Rectangle = TAG, motion=None, **light) -> np.ndarray:
    """A picture of a sheet before a backdrop with shapes in it."""
    sheets = [Sheet(rectangle, pose, motion=motion)]
    camera_from_world, capture = CAMERAS[camera].inverse(), replace(USUAL, **light)
    return render_image(
        grid(camera), camera_from_world, sheets, samples=2, colour=False, background=BACKDROP, capture=capture
    )


FACING = Pose(rotation_from_vector(np.array([0.2, -0.2, 0.0])), np.array([0.0, 0.05, 1.5]))


def moved(metres: float, pose: Pose = FACING) -> Pose:
    return Pose(pose.rotation, pose.translation + np.array([metres, 0, 0]))
