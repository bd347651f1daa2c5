"""What stands out where nothing was found, on rendered pictures and real ones."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from quadrig.single.arrays import Picture
from quadrig.single.detect.image_search import detect_views
from quadrig.single.detect.plain_sight import plain_sight
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.april_grid import AprilGridMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.circle_grid import CircleGridMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Marking, Rectangle, TagFamily
from quadrig.single.render.capture import SRGB, Capture
from quadrig.single.render.picture import Sheet, ray_grid, render_image

LENS = Intrinsics(640, 480, 700.0, np.array([321.0, 238.0]), np.array([-0.15, 0.04, 0.0, 0.0, 0.0]))
GRID = ray_grid(LENS)
BOARD = CharucoMarking(6, 4, 0.04, 0.03, "aruco_4x4_50")


def bearing(marking: Marking) -> Rectangle:
    return Rectangle("board", *(marking.size or (0.16, 0.16)), marking)


def pictures(marking: Marking) -> list[Picture]:
    capture = Capture(noise=1.5, blur=0.6, curve=SRGB, jpeg=90)
    poses = [Pose.from_vectors(np.array([0.4, -0.3, k - 1.0]), np.array([0.0, 0.02, 0.6])) for k in range(3)]
    return [
        render_image(GRID, Pose.identity(), [Sheet(bearing(marking), pose)], capture=capture, samples=3, colour=False)
        for pose in poses
    ]


@pytest.mark.parametrize("marking", [TagMarking("apriltag_36h11", 5), BOARD, AprilGridMarking(4, 3, 0.05, 0.3)])
def test_a_mirrored_sheet_is_no_view_and_known_for_what_it_is(marking):
    mirrored = [np.ascontiguousarray(image[:, ::-1]) for image in pictures(marking)]
    assert all(detect_views(image, [bearing(marking)]) == [] for image in mirrored)
    sight = plain_sight(mirrored, [bearing(marking)])
    assert sight is not None
    assert sight.mirrored
    assert sight.rectangle == "board"


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        (ChessboardMarking(9, 6, 0.025), ChessboardMarking(10, 7, 0.025)),
        (ChessboardMarking(5, 8, 0.025), ChessboardMarking(7, 10, 0.025)),
        (BOARD, CharucoMarking(7, 5, 0.04, 0.03, "aruco_4x4_50")),
        (BOARD, CharucoMarking(4, 6, 0.04, 0.03, "aruco_4x4_50")),
        (BOARD, CharucoMarking(6, 4, 0.04, 0.03, "aruco_4x4_50", legacy=True)),
        (BOARD, CharucoMarking(6, 4, 0.04, 0.03, "aruco_4x4_50", inverted=True)),
        (AprilGridMarking(4, 3, 0.05, 0.3), AprilGridMarking(4, 3, 0.05, 0.3, border=1)),
        (AprilGridMarking(4, 3, 0.05, 0.3), AprilGridMarking(3, 3, 0.05, 0.3)),
        (CircleGridMarking(9, 4, 0.03, asymmetric=True), CircleGridMarking(4, 9, 0.03, asymmetric=True)),
        (CircleGridMarking(7, 6, 0.04), CircleGridMarking(7, 6, 0.04, inverted=True)),
    ],
)
def test_a_board_that_is_described_otherwise_is_no_view_and_its_description_is_found(given, shown):
    taken = pictures(shown)
    assert all(detect_views(image, [bearing(given)]) == [] for image in taken)
    sight = plain_sight(taken, [bearing(given)])
    assert sight is not None
    assert sight.marking == shown


@pytest.mark.parametrize("legacy", [False, True])
def test_the_older_pattern_is_not_proposed_where_it_is_the_same_picture(legacy):
    marking = CharucoMarking(4, 5, 0.04, 0.03, "aruco_4x4_50", legacy=legacy)
    other = replace(marking, legacy=not legacy)
    first, second = pictures(marking)[0], pictures(other)[0]
    assert np.array_equal(first, second)
    assert other not in marking.meant_instead(first)


@pytest.mark.parametrize(
    ("given", "shown", "family", "ids"),
    [
        (BOARD, CharucoMarking(6, 4, 0.04, 0.03, "aruco_5x5_100"), TagFamily("aruco_5x5_50"), set(range(12))),
        (TagMarking("apriltag_36h11", 5), TagMarking("apriltag_36h11", 9), TagFamily("apriltag_36h11"), {9}),
        (TagMarking("apriltag_36h11", 5), TagMarking("aruco_4x4_50", 9), TagFamily("aruco_4x4_50"), {9}),
    ],
)
def test_tags_that_no_rectangle_bears_are_named(given, shown, family, ids):
    sight = plain_sight(pictures(shown), [bearing(given)])
    assert sight is not None
    assert sight.family == family
    assert set(sight.ids) <= ids


def test_a_tag_white_on_black_is_named():
    sight = plain_sight([255 - image for image in pictures(TagMarking("apriltag_36h11", 5))], [bearing(BOARD)])
    assert sight is not None
    assert (sight.family, sight.ids) == (TagFamily("apriltag_36h11", inverted=True), (5,))


def test_a_chessboard_where_tags_are_sought_is_named():
    sight = plain_sight(pictures(ChessboardMarking(7, 6, 0.04)), [bearing(BOARD)])
    assert sight is not None
    assert sight.squares == (7, 6)


def test_nothing_stands_out_where_nothing_is():
    rng = np.random.default_rng(2)
    noise = rng.integers(0, 255, (480, 640)).astype(np.uint8)
    scene = cv2.GaussianBlur(noise, (0, 0), 6)
    empty = [
        np.full((480, 640), 90, np.uint8),
        noise,
        scene,
        np.zeros((1, 1), np.uint8),
        np.zeros((1, 4000), np.uint8),
    ]
    assert plain_sight(empty, [bearing(BOARD), bearing(ChessboardMarking(9, 6, 0.03))]) is None


def test_inner_corners_of_a_real_board(shared_data):
    names = sorted((shared_data / "stereo").glob("left*.jpg"))[:5]
    taken = [np.asarray(cv2.imread(str(name), cv2.IMREAD_GRAYSCALE), np.uint8) for name in names]
    given = bearing(ChessboardMarking(9, 6, 0.025))
    assert all(detect_views(image, [given]) == [] for image in taken)
    sight = plain_sight(taken, [given])
    assert sight is not None
    assert sight.marking == ChessboardMarking(10, 7, 0.025)


def test_a_real_board_mirrored_and_counted_by_its_inner_corners(shared_data):
    capture = cv2.VideoCapture(str(shared_data / "field" / "board.mp4"))
    capture.set(cv2.CAP_PROP_POS_FRAMES, 100)
    good, image = capture.read()
    if not good:
        pytest.skip("the video of ../shared/data/field cannot be decoded here")
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    whole = CharucoMarking(12, 8, 0.018, 0.014, "aruco_5x5_100")
    mirrored = plain_sight([np.ascontiguousarray(grey[:, ::-1])], [bearing(whole)])
    assert mirrored is not None
    assert mirrored.mirrored
    counted = bearing(CharucoMarking(11, 7, 0.018, 0.014, "aruco_5x5_100"))
    assert detect_views(grey, [counted]) == []
    sight = plain_sight([grey], [counted])
    assert sight is not None
    assert sight.marking == whole
