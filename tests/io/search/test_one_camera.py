"""One real camera by itself: its lens from a video or a folder, beside OpenCV's on the very same corners."""

import shutil

import cv2
import numpy as np
import pytest

from quadrig.io.config.rig_toml import parse_config
from quadrig.io.search.effort import Effort
from quadrig.io.search.whole_recording import calibrate_recording

BOARD = '[[rectangle]]\nname = "board"\nmoving = true\nmarking = '
CHESSBOARD = BOARD + '{ kind = "chessboard", columns = 10, rows = 7, square = 0.025 }'
WEBCAM = BOARD + (
    '{ kind = "charuco", columns = 4, rows = 5, square = 0.054, marker = 0.0405, dictionary = "aruco_4x4_1000", '
    "legacy = true, inverted = true }"
)
FIELD = BOARD + (
    '{ kind = "charuco", columns = 12, rows = 8, square = 0.018, marker = 0.014, dictionary = "aruco_5x5_50" }'
)
QUIET = Effort(workers=1, progress=False)


def opencv_focals(rig, chosen=slice(None)):
    """fx and fy (2,) of cv2.calibrateCamera on the Views of a rig of one camera."""
    views = [fit.view for fit in rig.fits if len(fit.view.pixels) >= 6][chosen]
    points = [view.points.astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32)[:, None] for view in views]
    lens = rig.cameras[0].intrinsics
    _, matrix, *_ = cv2.calibrateCamera(points, pixels, (lens.width, lens.height), None, None)
    return np.array([matrix[0, 0], matrix[1, 1]])


def shares_off(rig):
    """How far our two focals lie from OpenCV's, as shares."""
    lens = rig.cameras[0].intrinsics
    return np.abs(np.array([lens.focal, lens.focal * lens.aspect]) / opencv_focals(rig) - 1)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_folder_of_chessboards(shared_data, tmp_path, side):
    for path in (shared_data / "stereo").glob(f"{side}[0-9]*.jpg"):
        shutil.copy(path, tmp_path)
    rig = calibrate_recording(tmp_path, parse_config(CHESSBOARD), QUIET)
    assert len(rig.cameras) == 1
    assert (shares_off(rig) < 0.003).all()


@pytest.mark.parametrize("number", range(4))
def test_a_webcam(shared_data, number):
    """Within 0.3 %, or nearer than OpenCV's focals of the two halves of the video are to one another: it takes the
    board for flat and true to size, and what a hand shows in one half bends it otherwise than in the other."""
    rig = calibrate_recording(shared_data / "webcams" / f"cam_{number}.mp4", parse_config(WEBCAM), QUIET)
    middle = len(rig.fits) // 2
    halves = [opencv_focals(rig, part) for part in (slice(0, middle), slice(middle, None))]
    apart = np.abs(halves[0] / halves[1] - 1)
    assert (shares_off(rig) < np.maximum(0.003, 0.5 * apart)).all()
    assert 0 < rig.focal_sigma(f"cam_{number}") < 0.01 * rig.cameras[0].intrinsics.focal


def test_a_video_that_does_not_determine_its_focal_says_so(shared_data):
    """OpenCV's focals of its thirds lie a quarter apart, and it claims 0.05 px of any: some per cent between ours and
    OpenCV's of the whole is chance, and our sigma knows."""
    rig = calibrate_recording(shared_data / "field" / "board.mp4", parse_config(FIELD), QUIET)
    thirds = np.array([opencv_focals(rig, part) for part in (slice(0, 53), slice(53, 107), slice(107, None))])
    assert np.ptp(thirds[:, 0]) > 0.2 * thirds[:, 0].mean()
    focal, sigma = rig.cameras[0].intrinsics.focal, rig.focal_sigma("board")
    assert sigma > 0.02 * focal
    assert abs(focal - opencv_focals(rig)[0]) < 2 * sigma
    assert any("its focal is known to" in sentence for sentence in rig.weak)
