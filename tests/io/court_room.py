"""A tennis court before three cameras with the faults of real lenses, for tests of corners given by hand."""

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from quadrig.io.config.known_sizes import known_size
from quadrig.io.demo.scene import looking
from quadrig.single.lens import Intrinsics, image_middle
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.capture import Capture
from quadrig.single.render.picture import Sheet, render_image

WIDTH, HEIGHT = 1280, 720
COURT, SERVICE = (
    Rectangle(name, known_size(size).width, known_size(size).height)
    for name, size in (("court", "tennis court"), ("service", "tennis service area"))
)
CONFIG = """reference = "court"

[[rectangle]]
name = "court"
size = "tennis court"
marking = { kind = "points" }
world_from_rect = { translation = [0, 0, 0], angles_deg = [0, 0, 0] }

[[rectangle]]
name = "service"
size = "tennis service area"
marking = { kind = "points" }
world_from_rect = { translation = [0, 0, 0], angles_deg = [0, 0, 0] }
"""
# z up, the court's length along x.
WORLD_FROM_COURT = Pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
# Position (m), focal, offset of the principal point, k1, k2, p1, p2.
_TABLE = {
    "left": ((-20.0, -11.0, 8.0), 860.0, (9.0, -6.0), (-0.12, 0.03, 5e-4, -8e-4, 0.0)),
    "middle": ((1.0, -20.0, 9.0), 900.0, (-7.0, 5.0), (-0.09, 0.01, -6e-4, 3e-4, 0.0)),
    "right": ((19.0, -12.0, 7.5), 840.0, (4.0, 8.0), (-0.15, 0.04, 2e-4, 6e-4, 0.0)),
}
CAMERAS = tuple(_TABLE)
# Metres of ground beyond the court, and texels per metre: a line of 5 cm is five of them.
_BEYOND, _TEXELS = 4.0, 100


def lens(camera: str) -> Intrinsics:
    """The true lens of a camera."""
    _, focal, offset, distortion = _TABLE[camera]
    return Intrinsics(WIDTH, HEIGHT, focal, image_middle(WIDTH, HEIGHT) + offset, np.array(distortion))


def camera_from_court(camera: str) -> Pose:
    """The true pose of a camera."""
    position = np.array(_TABLE[camera][0])
    return looking(position, np.array([0.0, 1.0, 0.0]) - position).inverse() @ WORLD_FROM_COURT


def corners(camera: str, rectangle: Rectangle) -> np.ndarray:
    """True pixels (4, 2) of the corners."""
    return lens(camera).project(camera_from_court(camera).transform(rectangle.corners))


@lru_cache
def picture(camera: str) -> np.ndarray:
    """What a camera sees: white lines on a dark ground."""
    sheet = Sheet(COURT, WORLD_FROM_COURT, _lines(), margin=_BEYOND)
    view = camera_from_court(camera) @ WORLD_FROM_COURT.inverse()
    return render_image(lens(camera), view, [sheet], background=0.25, capture=Capture(blur=0.7, noise=1.0))


def write(folder: Path) -> list[Path]:
    """rig.toml and a picture of each camera; the pictures' paths."""
    (folder / "rig.toml").write_text(CONFIG)
    paths = [folder / f"{camera}.png" for camera in CAMERAS]
    for path in paths:
        cv2.imwrite(str(path), picture(path.stem))
    return paths


@lru_cache
def _lines() -> np.ndarray:
    """Ink 0, paper 1: the boundary, the singles sidelines, the service lines and the line between them."""
    width, height = COURT.width + 2 * _BEYOND, COURT.height + 2 * _BEYOND
    ground = np.full((round(height * _TEXELS), round(width * _TEXELS)), 0.15, np.float32)

    def paint(left: float, top: float, right: float, bottom: float) -> None:
        columns = [round((x + width / 2) * _TEXELS) for x in (left, right)]
        rows = [round((y + height / 2) * _TEXELS) for y in (top, bottom)]
        ground[rows[0] : rows[1], columns[0] : columns[1]] = 1.0

    def frame(wide: float, high: float, line: float = 0.1) -> None:
        x, y = wide / 2, high / 2
        for side in (-1, 1):
            paint(*sorted_box(side * x, -y, side * (x - line), y))
            paint(*sorted_box(-x, side * y, x, side * (y - line)))

    frame(COURT.width, COURT.height)
    frame(COURT.width, SERVICE.height)
    frame(SERVICE.width, SERVICE.height)
    paint(-SERVICE.width / 2, -0.05, SERVICE.width / 2, 0.05)
    return ground


def sorted_box(x0: float, y0: float, x1: float, y1: float) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of a box given by two of its corners."""
    return min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)
