"""A rig that another program calibrated, and pictures taken later: which of its cameras moved?

Fifteen cameras that look at one square on a floor, the folder data/ba of github.com/nbhr/pycalib: its output.json is
the rig, its images were taken after somebody had touched the cameras.

python examples/05_has_it_moved.py FOLDER
"""

import argparse
import json
import tempfile
from pathlib import Path

import cv2
import numpy as np

from quadrig.io import write_rig
from quadrig.io.commands.main import run
from quadrig.rig import Camera, Rig
from quadrig.rig.result import CAMERA_PARAMETERS
from quadrig.single import Intrinsics, Pose

CONFIG = """reference = "camera_00"
[[rectangle]]
name = "square"
width = 0.15
height = 0.15
marking = { kind = "tag", dictionary = "aruco_4x4_250", id = 0 }
"""
# The file gives no sigmas: these (px, rad, m) are what a good calibration of such a rig has.
FOCAL_SIGMA, ROTATION_SIGMA, POSITION_SIGMA = 2.5, np.radians(0.05), 0.005
# The square of 150 mm says that a unit of the file is a millimetre.
METRES = 1e-3
# Half of the pictures' 5312x2988, which is plenty for a square of hundreds of pixels.
WIDTH, HEIGHT = 2656, 1494


def given_rig(given: dict) -> Rig:
    """The rig as the file has it, its pictures undistorted and half as large."""
    world_from_camera = Pose(np.array(given["R"]), METRES * np.reshape(given["t"], (-1, 3))).inverse()
    cameras = []
    for index, matrix in enumerate(map(halved, given["K"])):
        lens = Intrinsics(WIDTH, HEIGHT, matrix[0, 0], matrix[:2, 2])
        rig_from_camera = world_from_camera[0].inverse() @ world_from_camera[index]
        cameras.append(Camera(f"camera_{index:02d}", lens, rig_from_camera, ("focal",)))
    sigmas = np.zeros((len(cameras), CAMERA_PARAMETERS))
    sigmas[:, 0], sigmas[1:, -6:-3], sigmas[1:, -3:] = FOCAL_SIGMA, ROTATION_SIGMA, POSITION_SIGMA
    return Rig("camera_00", tuple(cameras), (), np.diag(sigmas.ravel() ** 2))


def halved(matrix: list) -> np.ndarray:
    """The camera matrix (3, 3) of pictures half as large; (0, 0) is the centre of the first pixel."""
    half = np.array(matrix) / 2
    half[:2, 2] -= 0.25
    half[2, 2] = 1.0
    return half


def undistorted(picture: Path, matrix: np.ndarray, distortion: np.ndarray) -> np.ndarray:
    """A picture, half as large, as the camera of given_rig would have taken it."""
    maps = cv2.initUndistortRectifyMap(matrix, distortion, np.eye(3), matrix, (WIDTH, HEIGHT), cv2.CV_32FC1)
    taken = cv2.imread(str(picture), cv2.IMREAD_REDUCED_GRAYSCALE_2)
    if taken is None:
        raise SystemExit(f"{picture}: not a picture that can be read")
    return cv2.remap(taken, *maps, cv2.INTER_LINEAR)


def main() -> int:
    """Make rig.mcap and a folder of pictures for each camera, and ask `rig check`."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="with output.json and floor/camera_01.jpg to camera_15.jpg")
    folder = parser.parse_args().folder
    given = json.loads((folder / "output.json").read_text())
    rig = given_rig(given)
    with tempfile.TemporaryDirectory() as made:
        out = Path(made)
        write_rig(out / "rig.mcap", rig, CONFIG)
        for index, camera in enumerate(rig.cameras):
            (out / "later" / camera.name).mkdir(parents=True)
            picture = next(folder.glob(f"*/camera_{index + 1:02d}.jpg"))
            flat = undistorted(picture, halved(given["K"][index]), np.array(given["d"][index]))
            cv2.imwrite(str(out / "later" / camera.name / "0.jpg"), flat)
        return run(["check", str(out / "rig.mcap"), str(out / "later")])


if __name__ == "__main__":
    raise SystemExit(main())
