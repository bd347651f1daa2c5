"""Sheets that are in plain sight are named as they were printed, but for their size."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.single.detect.pictures import grey_image
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.april_grid import AprilGridMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.in_sight import Sighting, markings_in_sight, together
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Marking, Rectangle
from quadrig.single.render.capture import Capture
from quadrig.single.render.picture import Sheet, ray_grid, render_image

LENS = Intrinsics.centred(640, 480, 622.0)
GRID = ray_grid(LENS)


def picture(*sheets: Sheet) -> np.ndarray:
    capture = Capture(blur=0.6, noise=1.5)
    return grey_image(render_image(GRID, Pose.identity(), sheets, capture=capture, rng=np.random.default_rng(3)))


def sheet(marking: Marking, where=(0.0, 0.0, 1.0), size=0.2) -> Sheet:
    pose = Pose.from_vectors(np.array([0.3, -0.25, 0.1]), np.array(where))
    width, height = marking.size or (size, size)
    return Sheet(Rectangle("sheet", width, height, marking), pose)


def markings(*pictures: np.ndarray) -> tuple[Marking, ...]:
    return tuple(sighting.marking for sighting in markings_in_sight(pictures))


@pytest.mark.parametrize(
    "board",
    [
        CharucoMarking(7, 5, 0.08, 0.06, "aruco_4x4_50", inverted=True),
        CharucoMarking(5, 6, 0.08, 0.05, "aruco_5x5_100", legacy=True),
        AprilGridMarking(4, 3, 0.1, 0.3),
    ],
)
def test_a_board_of_tags(board):
    (found,) = markings(picture(sheet(board)))
    if isinstance(board, CharucoMarking):
        assert isinstance(found, CharucoMarking)
        # To a hundredth of a square, as it is written.
        assert found.marker == pytest.approx(board.marker / board.square, abs=0.02)
        # Of dictionaries that begin alike the smallest will do.
        dictionary = board.dictionary.replace("_100", "_50")
        assert replace(found, marker=0.5) == replace(board, square=1.0, marker=0.5, dictionary=dictionary)
    else:
        assert isinstance(found, AprilGridMarking)
        assert found.spacing == pytest.approx(board.spacing, abs=0.01)
        assert replace(found, spacing=0.3) == replace(board, tag=1.0)


def test_single_tags_and_a_chessboard():
    tags = [sheet(TagMarking("apriltag_36h11", k), (0.28 * (k - 5), 0.05 * (k % 2), 1.0)) for k in (4, 5, 6)]
    assert markings(picture(*tags)) == tuple(TagMarking("apriltag_36h11", k) for k in (4, 5, 6))
    (board,) = markings(picture(sheet(ChessboardMarking(9, 6, 0.06))))
    assert board in (ChessboardMarking(9, 6, 1.0), ChessboardMarking(6, 9, 1.0))


def test_a_tag_that_one_picture_alone_shows_does_not_hide_the_board_nor_lengthen_it():
    board = CharucoMarking(4, 5, 0.1, 0.075, "aruco_4x4_50", inverted=True)
    near = sheet(board, (0.15, 0.0, 1.0))
    few = CharucoMarking(2, 2, 0.06, 0.045, "aruco_4x4_50", inverted=True, first_id=20)
    foreign = sheet(few, (-0.25, 0.0, 1.0))
    assert markings(picture(near, foreign), picture(near)) == (replace(board, square=1.0, marker=0.75),)


CHARUCO = CharucoMarking(4, 5, 1.0, 0.75, "aruco_4x4_50")


def agreed(*estimates: float) -> float:
    (board,) = together([[Sighting(CHARUCO, estimates=(one,))] for one in estimates])
    assert isinstance(board.marking, CharucoMarking)
    return board.marking.marker


def test_cameras_agree_on_the_side_of_a_boards_tags_in_whatever_order_they_answer():
    assert agreed(0.76, 0.74, 0.76) == agreed(0.74, 0.76, 0.76) == 0.75
    # Another ratio is what it is, until looks at it differ by more.
    assert agreed(0.70, 0.69, 0.70, 0.71) == 0.70
    assert agreed(0.60, 0.70, 0.80) == 0.75


def test_tags_of_a_board_are_no_sheets_of_their_own_and_others_are_counted_over_the_cameras():
    part, other = TagMarking("aruco_4x4_100", 3), TagMarking("aruco_4x4_100", 60)
    board = Sighting(CHARUCO, estimates=(0.75,))
    cameras = [[Sighting(part, 4), Sighting(other)], [board], [Sighting(other, 2)]]
    assert together(cameras) == together(cameras[::-1]) == (board, Sighting(other, 3))
    # Of another kind of dictionary, a tag of the same number is another.
    april = Sighting(TagMarking("apriltag_36h11", 3), 2)
    assert together([[board], [april]]) == (board, april)


def test_nothing_is_nothing():
    assert markings(picture()) == ()
