"""Sheets that are in plain sight are named as they were printed, but for their size."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.single.detect.pictures import grey_image
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.april_grid import AprilGridMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.in_sight import markings_in_sight
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


@pytest.mark.parametrize(
    "board",
    [
        CharucoMarking(7, 5, 0.08, 0.06, "aruco_4x4_50", inverted=True),
        CharucoMarking(5, 6, 0.08, 0.05, "aruco_5x5_100", legacy=True),
        AprilGridMarking(4, 3, 0.1, 0.3),
    ],
)
def test_a_board_of_tags(board):
    (found,) = markings_in_sight([picture(sheet(board))])
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
    assert markings_in_sight([picture(*tags)]) == tuple(TagMarking("apriltag_36h11", k) for k in (4, 5, 6))
    (board,) = markings_in_sight([picture(sheet(ChessboardMarking(9, 6, 0.06)))])
    assert board in (ChessboardMarking(9, 6, 1.0), ChessboardMarking(6, 9, 1.0))


def test_nothing_is_nothing():
    assert markings_in_sight([picture()]) == ()
