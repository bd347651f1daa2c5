"""Detection on pictures of real cameras."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.single.arrays import Picture
from quadrig.single.detect.image_search import detect_views
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View


def picture(path: Path, flags: int = cv2.IMREAD_COLOR) -> Picture:
    return np.asarray(cv2.imread(str(path), flags), np.uint8)


def plane_rms(view: View) -> float:
    """px by which a View departs from a homography of its board; distortion of a narrow lens bends it a little."""
    homography, _ = cv2.findHomography(view.points[:, :2], view.pixels)
    seen = cv2.perspectiveTransform(view.points[:, None, :2], homography)[:, 0]
    return float(np.sqrt(np.mean((seen - view.pixels) ** 2)))


@pytest.mark.parametrize("side", ["left", "right"])
def test_every_chessboard_of_the_stereo_pairs_is_found_in_one_reading(shared_data, side):
    board = Rectangle("board", 0.25, 0.175, ChessboardMarking(10, 7, 0.025))
    pictures = sorted((shared_data / "stereo").glob(f"{side}[0-9]*.jpg"))
    views = [view for path in pictures for view in detect_views(picture(path), [board])]
    assert len(views) == len(pictures) == 13
    assert all(v.alternatives == () for v in views)
    lens = cv2.calibrateCamera(
        [v.points.astype(np.float32) for v in views],
        [v.pixels.astype(np.float32) for v in views],
        (640, 480),
        np.eye(3),
        np.zeros(5),
    )
    # Corners refined over windows wider than a square leave 0.41 and 0.46 px with the same lens model.
    assert lens[0] < 0.2


def test_as_many_chessboards_as_by_the_better_of_opencvs_two_searches(shared_data):
    board = Rectangle("board", 0.25, 0.175, ChessboardMarking(10, 7, 0.025))
    whole = [picture(path, cv2.IMREAD_GRAYSCALE) for path in sorted((shared_data / "stereo").glob("left[0-9]*.jpg"))]
    half = [cv2.resize(one, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for one in whole]
    soft = [np.asarray(cv2.GaussianBlur(one, (0, 0), 1.0), np.uint8) for one in half]
    for pictures in (whole, soft):
        classic = sum(bool(cv2.findChessboardCorners(one, (9, 6))[0]) for one in pictures)
        sector = sum(bool(cv2.findChessboardCornersSB(one, (9, 6))[0]) for one in pictures)
        views = [view for one in pictures for view in detect_views(one, [board])]
        assert len(views) >= max(classic, sector)
        assert max(plane_rms(view) for view in views) < 1.5


@pytest.fixture(scope="module")
def floor_views(shared_data):
    """What is found of the square on the floor in each of the fifteen pictures."""
    square = Rectangle("floor", 0.15, 0.15, TagMarking("DICT_4X4_250", 0))
    pictures = sorted((shared_data / "floor" / "images").glob("*.jpg"))
    return [detect_views(picture(path, cv2.IMREAD_GRAYSCALE), [square]) for path in pictures]


def test_square_on_the_floor_is_found_by_all_fifteen_cameras(floor_views):
    assert [len(views) for views in floor_views] == [1] * 15


# Fitted in pieces of 20 px, each sure to 0.02 px, these sides wave about a cubic by 0.1 to 0.4 px, unlike from camera
# to camera (on the print their correlation is 0), and the lens calibrated by itself leaves them bent by up to 0.9 px:
# the camera's own processing does it to the picture, and a corner is worth no more than its sides say.
@pytest.mark.xfail(strict=True, reason="the sides wave by 0.1 to 0.4 px as no lens bends them, and sigma says so")
def test_the_corners_of_the_square_on_the_floor_are_sure_to_a_tenth_of_a_pixel(floor_views):
    assert max(view.sigma for views in floor_views for view in views) < 0.1


@pytest.mark.parametrize(("camera", "least"), [(0, 15), (1, 11), (2, 14), (3, 15)])
def test_inverted_legacy_board_is_found_as_often_as_by_plain_opencv(shared_data, camera, least):
    marking = CharucoMarking(4, 5, 0.054, 0.0405, "DICT_4X4_1000", legacy=True, inverted=True)
    board = Rectangle("board", 0.216, 0.270, marking)
    video = cv2.VideoCapture(str(shared_data / "webcams" / f"cam_{camera}.mp4"))
    views = []
    for index in range(111):
        video.grab()
        if index % 3 == 0:
            views += detect_views(np.asarray(video.retrieve()[1], np.uint8), [board])
    assert len(views) >= least
    # A wrong corner would be off by a square's side, some 30 px; strong distortion bends a board by a few.
    assert max(plane_rms(v) for v in views) < 6
