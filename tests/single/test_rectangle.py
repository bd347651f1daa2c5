"""Rectangles: the corners of Eq. 4, the frame of the sheet, boards in it, and sizes that are none."""

import numpy as np
import pytest

from quadrig.single.errors import QuadrigError
from quadrig.single.markings.boards import board_points
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle, rectangle_corners


def test_the_corners_are_those_of_equation_4():
    np.testing.assert_array_equal(
        rectangle_corners(0.4, 0.2), [[0.2, 0.1, 0], [-0.2, 0.1, 0], [-0.2, -0.1, 0], [0.2, -0.1, 0]]
    )


def test_sides_have_the_lengths_given():
    corners = Rectangle("a", 0.297, 0.210).corners
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
    np.testing.assert_allclose(sides, [0.297, 0.210, 0.297, 0.210], atol=1e-15)


def test_from_the_front_an_upright_sheet_has_its_first_corner_bottom_right():
    """The camera has the sheet's axes: y down, so that P1(+,+) is right and below."""
    seen = Pose(np.eye(3), np.array([0, 0, 1.0])).transform(Rectangle("a", 0.4, 0.2).corners)
    pixels = 500 * seen[:, :2] / seen[:, 2:] + [320, 240]
    assert pixels[0, 0] > 320
    assert pixels[0, 1] > 240


def test_sizes_broadcast():
    corners = rectangle_corners(np.array([0.4, 0.6]), 0.2)
    assert corners.shape == (2, 4, 3)
    np.testing.assert_array_equal(corners[1], rectangle_corners(0.6, 0.2))


def test_a_board_has_its_middle_in_the_middle_and_reads_row_by_row():
    points = board_points(9, 7, 0.05)
    assert points.shape == (48, 3)
    np.testing.assert_allclose(points.mean(axis=0), 0, atol=1e-16)
    np.testing.assert_allclose(points[1] - points[0], [0.05, 0, 0], atol=1e-16)
    np.testing.assert_allclose(points[8] - points[0], [0, 0.05, 0], atol=1e-16)
    outer = rectangle_corners(9 * 0.05, 7 * 0.05)
    assert (np.abs(points[:, :2]) < outer[0, :2]).all()
    # Its first inner corner is one square from both edges of the sheet.
    np.testing.assert_allclose(points[0] - outer[2], [0.05, 0.05, 0], atol=1e-15)


def test_a_half_turn_takes_a_board_of_any_size_to_itself_backwards():
    for columns, rows in ((9, 7), (8, 6), (5, 4)):
        points = board_points(columns, rows, 0.03)
        np.testing.assert_allclose(points * [-1, -1, 1], points[::-1], atol=1e-15)


@pytest.mark.parametrize(("width", "height"), [(0, 0.2), (0.2, -1), (np.nan, 0.2), (0.2, np.inf)])
def test_a_side_that_is_no_length_is_refused_by_name(width, height):
    with pytest.raises(QuadrigError, match="desk"):
        Rectangle("desk", width, height)


@pytest.mark.parametrize(
    "rotation", [np.diag([1.0, 1, -1]), 2 * np.eye(3), np.full((3, 3), np.nan), np.zeros((3, 3))]
)
def test_a_pose_on_a_body_that_is_no_rigid_one_is_refused_by_name(rotation):
    with pytest.raises(QuadrigError, match="'desk': body_from_rect is no rotation"):
        Rectangle("desk", 0.3, 0.2, body="box", body_from_rect=Pose(rotation, np.zeros(3)))
    with pytest.raises(QuadrigError, match="'desk': body_from_rect is no rotation"):
        Rectangle("desk", 0.3, 0.2, body="box", body_from_rect=Pose(np.eye(3), np.array([0, np.nan, 0])))
    rounded = Pose(np.round(Pose.from_vectors(np.array([0.3, 0.2, 1.1]), np.zeros(3)).rotation, 4), np.zeros(3))
    assert Rectangle("desk", 0.3, 0.2, body="box", body_from_rect=rounded).body_from_rect is rounded
