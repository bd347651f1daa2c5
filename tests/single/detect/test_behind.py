"""Rectangles seen from behind, as through a glass table: found, solved, and only where rig.toml says so."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.single.calibration import calibrate_view, calibrate_views
from quadrig.single.detect.image_search import detect_views
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.april_grid import AprilGridMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Marking, Rectangle
from quadrig.single.render.capture import SRGB, Capture
from quadrig.single.render.picture import Sheet, ray_grid, render_image

LENS = Intrinsics(640, 480, 700.0, np.array([321.0, 238.0]), np.array([-0.15, 0.04, 0.0, 0.0, 0.0]))
GRID = ray_grid(LENS)
MARKINGS = [
    TagMarking("apriltag_36h11", 5),
    CharucoMarking(5, 4, 0.05, 0.038, "aruco_4x4_50"),
    AprilGridMarking(4, 3, 0.05, 0.3),
]
TURNED_OVER = Pose.from_vectors(np.array([0.0, np.pi, 0.0]), np.zeros(3))
POSES = [
    Pose.from_vectors(np.array(turn), np.array(place)) @ TURNED_OVER
    for turn, place in (
        ((0.5, -0.3, 0.4), (-0.05, 0.02, 0.6)),
        ((-0.4, 0.5, 2.0), (0.04, 0.0, 0.65)),
        ((0.1, -0.6, 1.0), (0.0, 0.03, 0.6)),
    )
]


def board(marking: Marking) -> Rectangle:
    width, height = marking.size or (0.16, 0.16)
    return Rectangle("board", width, height, marking, back=True)


def picture(rectangle: Rectangle, pose: Pose):
    capture = Capture(noise=1.5, blur=0.6, curve=SRGB, jpeg=90)
    return render_image(GRID, Pose.identity(), [Sheet(rectangle, pose)], capture=capture, samples=4, colour=False)


@pytest.mark.parametrize("marking", MARKINGS, ids=lambda m: m.kind)
def test_from_behind_it_is_found_and_solved_where_that_is_said(marking):
    views = []
    for pose in POSES:
        image = picture(board(marking), pose)
        (view,) = detect_views(image, [board(marking)])
        assert view.back
        assert np.abs(view.pixels - LENS.project(pose.transform(view.points))).max() < 0.25
        (again,) = detect_views(image, [board(marking)], near=[view])
        np.testing.assert_allclose(again.pixels, view.pixels, atol=0.05)
        assert detect_views(image, [replace(board(marking), back=False)]) == []
        views.append(view)
    found = calibrate_views(views, (640, 480))
    sigma = np.sqrt(found.lens_covariance[0, 0])
    assert abs(found.intrinsics.focal - 700) < 3.5 * sigma + 0.5
    alone = calibrate_view(views[0], (640, 480))
    place, truth = alone.rect_from_cameras.translation[0], POSES[0].inverse().translation
    # Behind is where z is positive.
    assert truth[2] > 0
    assert np.linalg.norm(place - truth) < 0.05


def test_what_looks_the_same_from_behind_cannot_be_told():
    with pytest.raises(QuadrigError, match="looks the same from behind"):
        board(ChessboardMarking(7, 6, 0.04))
