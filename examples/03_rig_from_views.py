"""A rig without files: Views in, Rig out. For those who have their own detector, or their own simulation.

    python examples/03_rig_from_views.py

Two cameras see one board in twenty poses. The pixels are the truth's, with 0.2 px of noise.
"""

import numpy as np

from quadrig.rig import CameraInput, calibrate
from quadrig.single import ChessboardMarking, Intrinsics, Pose, Rectangle, View, board_points

NOISE = 0.2


def main() -> None:
    """Print the distance between the two cameras beside the truth."""
    rng = np.random.default_rng(1)
    board = Rectangle("board", 0.40, 0.28, ChessboardMarking(10, 7, 0.04), moving=True)
    points = board_points(10, 7, 0.04)
    lenses = {"left": Intrinsics.centred(1280, 720, 900.0), "right": Intrinsics.centred(1280, 720, 1000.0)}
    camera_from_left = {
        "left": Pose.identity(),
        "right": Pose.from_vectors(np.array([0.0, 0.2, 0.0]), np.array([-0.30, 0.0, 0.02])),
    }
    views = []
    for frameset in range(20):
        turn = rng.uniform(-0.6, 0.6, 3)
        left_from_board = Pose.from_vectors(turn, np.array([*rng.uniform(-0.2, 0.2, 2), 1.2]))
        for name, lens in lenses.items():
            pixels = lens.project((camera_from_left[name] @ left_from_board).transform(points))
            pixels = pixels + rng.normal(0, NOISE, pixels.shape)
            views.append(View("board", points, pixels, camera=name, frameset=frameset, sigma=NOISE))

    rig = calibrate([CameraInput(name, 1280, 720) for name in lenses], [board], views, reference="left")

    baseline = np.linalg.norm(rig.camera("right").rig_from_camera.translation)
    truth = np.linalg.norm(camera_from_left["right"].inverse().translation)
    print(f"baseline {1e3 * baseline:.2f} +- {1e3 * rig.position_sigma('right'):.2f} mm, truth {1e3 * truth:.2f} mm")
    for camera in rig.cameras:
        focal, sigma = camera.intrinsics.focal, rig.focal_sigma(camera.name)
        print(f"{camera.name}: focal {focal:.1f} +- {sigma:.1f} px, truth {lenses[camera.name].focal:.0f}")


if __name__ == "__main__":
    main()
