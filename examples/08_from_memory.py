"""A rig from what is in memory: arrays of corners, a detector of one's own, a camera driver's frames in a loop.

    python examples/08_from_memory.py

No file is read or written. The driver here renders its frames, so that the truth is known; a real one takes its
place.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import cv2
import numpy as np

from quadrig.rig import CameraInput, Rig, calibrate
from quadrig.single import (
    Capture,
    ChessboardMarking,
    Floats,
    Intrinsics,
    Picture,
    Pose,
    Rectangle,
    Sheet,
    View,
    board_points,
    detect_views,
    ray_grid,
    render_image,
)

COLUMNS, ROWS, SQUARE = 9, 6, 0.04
BOARD = Rectangle("board", COLUMNS * SQUARE, ROWS * SQUARE, ChessboardMarking(COLUMNS, ROWS, SQUARE), moving=True)
SIZE = (640, 400)
CAMERAS = {"left": Intrinsics.centred(*SIZE, 530.0), "right": Intrinsics.centred(*SIZE, 560.0)}
CAMERA_FROM_LEFT = {
    "left": Pose.identity(),
    "right": Pose.from_vectors(np.array([0.0, 0.25, 0.0]), np.array([-0.28, 0.0, 0.03])),
}
# Good enough to stop at, mm.
TARGET = 3.0


def from_arrays(pixels: Floats, names: list[str]) -> Rig:
    """The rig of corners (F, C, P, 2) px of a board's points in the order of board_points; nan where not seen."""
    points = board_points(COLUMNS, ROWS, SQUARE)
    views = []
    for frameset, shown in enumerate(pixels):
        for name, seen in zip(names, shown, strict=True):
            known = np.isfinite(seen).all(axis=1)
            views.append(View("board", points[known], seen[known], camera=name, frameset=frameset, sigma=0.2))
    return calibrate([CameraInput(name, *SIZE) for name in names], [BOARD], views)


def own_detector(picture: Picture) -> View | None:
    """Any detector will do that says which point of the rectangle (metres, its frame) is at which pixel.

    OpenCV numbers a board's corners from whichever end it likes: an alternative says that both readings are possible.
    """
    found, corners = cv2.findChessboardCornersSB(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), (COLUMNS - 1, ROWS - 1))
    if not found:
        return None
    points = board_points(COLUMNS, ROWS, SQUARE)
    return View("board", points, corners.reshape(-1, 2).astype(float), alternatives=(points[::-1].copy(),), sigma=0.2)


def driver(seed: int) -> Iterator[tuple[float, Mapping[str, Picture]]]:
    """A camera driver: for ever the time, s, and a picture (H, W, 3) BGR uint8 of each camera."""
    rng, time = np.random.default_rng(seed), 0.0
    grids = {name: ray_grid(lens) for name, lens in CAMERAS.items()}
    while True:
        time += 1.0
        left_from_board = Pose.from_vectors(rng.uniform(-0.6, 0.6, 3), np.array([*rng.uniform(-0.12, 0.12, 2), 0.75]))
        sheet, capture = Sheet(BOARD, left_from_board), Capture(blur=0.6, noise=1.5)
        yield (
            time,
            {
                name: render_image(grid, CAMERA_FROM_LEFT[name], [sheet], capture=capture, rng=rng)
                for name, grid in grids.items()
            },
        )


def from_driver(most: int = 24) -> Rig:
    """Frames as they come, until the rig is good enough."""
    inputs, views = [CameraInput(name, *SIZE) for name in CAMERAS], []
    for frameset, (time, pictures) in enumerate(driver(3)):
        for name, picture in pictures.items():
            for view in detect_views(picture, [BOARD]):
                views.append(replace(view, camera=name, frameset=frameset, time=time))
        if frameset >= 9 and frameset % 4 == 1:
            rig = calibrate(inputs, [BOARD], views)
            if 1e3 * rig.working_accuracy < TARGET or frameset + 1 >= most:
                return rig
    raise AssertionError("a driver ends only when it is told to")


def simulated_corners() -> Floats:
    """Corners (F, C, P, 2) px with 0.2 px of noise; one in ten was not seen."""
    rng, points = np.random.default_rng(1), board_points(COLUMNS, ROWS, SQUARE)
    shown = []
    for _ in range(20):
        left_from_board = Pose.from_vectors(rng.uniform(-0.6, 0.6, 3), np.array([*rng.uniform(-0.12, 0.12, 2), 0.75]))
        shown.append(
            [lens.project((CAMERA_FROM_LEFT[n] @ left_from_board).transform(points)) for n, lens in CAMERAS.items()]
        )
    pixels = np.array(shown) + rng.normal(0, 0.2, np.shape(shown))
    pixels[rng.uniform(size=pixels.shape[:3]) < 0.1] = np.nan
    return pixels


def from_own_detector() -> Rig:
    """The same driver, ten instants, and OpenCV in the place of quadrig's detection."""
    views = []
    for frameset, (_, pictures) in zip(range(10), driver(5), strict=False):
        for name, picture in pictures.items():
            view = own_detector(picture)
            if view is not None:
                views.append(replace(view, camera=name, frameset=frameset))
    return calibrate([CameraInput(name, *SIZE) for name in CAMERAS], [BOARD], views)


def main() -> None:
    """Print the distance between the cameras, three times, beside the truth."""
    true = 1e3 * np.linalg.norm(CAMERA_FROM_LEFT["right"].inverse().translation)
    rigs = {
        "arrays": from_arrays(simulated_corners(), list(CAMERAS)),
        "own detector": from_own_detector(),
        "driver": from_driver(),
    }
    for name, rig in rigs.items():
        found = 1e3 * np.linalg.norm(rig.camera("right").rig_from_camera.translation)
        print(f"{name}: baseline {found:.2f} +- {1e3 * rig.position_sigma('right'):.2f} mm, truth {true:.2f} mm")


if __name__ == "__main__":
    main()
