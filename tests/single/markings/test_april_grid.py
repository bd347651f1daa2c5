"""AprilGrids: laid out as Kalibr lays them out, and as others' detectors read them."""

import itertools
from dataclasses import fields

import numpy as np
import pytest

from quadrig.single.arrays import Floats, Mask, Picture
from quadrig.single.detect.image_search import detect_views
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.april_grid import AprilGridMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.capture import SRGB, Capture
from quadrig.single.render.picture import Sheet, ray_grid, render_image

LENS = Intrinsics(640, 480, 700.0, np.array([321.0, 238.0]), np.array([-0.15, 0.04, 5e-4, -3e-4, 0.0]))
GRID = ray_grid(LENS)
MARKING = AprilGridMarking(4, 3, 0.05, 0.3)
BOARD = Rectangle("board", *MARKING.size, MARKING)
POSES = [
    Pose.from_vectors(np.array(turn), np.array(place))
    for turn, place in (
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.45)),
        ((0.5, -0.3, 0.4), (-0.05, 0.02, 0.55)),
        ((-0.4, 0.5, 2.0), (0.04, 0.0, 0.6)),
    )
]


def picture(rectangle: Rectangle, pose: Pose, **light) -> Picture:
    capture = Capture(**{"noise": 1.5, "blur": 0.6, "curve": SRGB, "jpeg": 90, **light})
    return render_image(GRID, Pose.identity(), [Sheet(rectangle, pose)], capture=capture, samples=4, colour=False)


def tag_corners(pose: Pose) -> dict[int, Floats]:
    """Where the corners (4, 2) of each tag are in the picture: by Kalibr's own description of its target."""
    corners = {}
    for row, column in itertools.product(range(MARKING.rows), range(MARKING.columns)):
        step = (1 + MARKING.spacing) * MARKING.tag
        # From the bottom left corner of tag 0, x along the columns and y up the rows.
        square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * MARKING.tag + [column * step, row * step]
        extent = np.array([MARKING.columns, MARKING.rows]) * step - MARKING.spacing * MARKING.tag
        on_sheet = np.pad((square - extent / 2) * [1, -1], ((0, 0), (0, 1)))
        corners[row * MARKING.columns + column] = LENS.project(pose.transform(on_sheet))
    return corners


@pytest.mark.parametrize("pose", POSES)
def test_corners_are_where_they_are(pose):
    (view,) = detect_views(picture(BOARD, pose), [BOARD])
    gap = view.pixels - LENS.project(pose.transform(view.points))
    assert len(gap) == 4 * MARKING.columns * MARKING.rows
    assert np.sqrt(np.mean(gap**2)) < 0.03
    assert np.mean(np.sum(gap**2, axis=1) < 5.99 * view.sigma**2) > 0.9


@pytest.mark.parametrize("pose", POSES)
def test_what_is_hidden_costs_only_its_own_corners(pose):
    hidden = picture(BOARD, pose)
    hidden[:, : LENS.width // 2] = 120
    (view,) = detect_views(hidden, [BOARD])
    gap = view.pixels - LENS.project(pose.transform(view.points))
    assert 8 <= len(gap) < 48
    assert np.abs(gap).max() < 0.3


@pytest.mark.parametrize("pose", POSES)
def test_an_independent_detector_of_aprilgrids_finds_the_same_tags_there(pose):
    oracle = pytest.importorskip("aprilgrid", reason="aprilgrid is not installed").Detector("t36h11")
    truth, found = tag_corners(pose), oracle.detect(picture(BOARD, pose))
    assert len(found) >= 8
    for tag in found:
        found_there, true = (np.sort(one.reshape(4, 2), axis=0) for one in (tag.corners, truth[tag.tag_id]))
        np.testing.assert_allclose(found_there, true, atol=1)


class HalfTurned(AprilGridMarking):
    """As printed with OpenCV's drawings of the tags."""

    def _cells(self, tag_id: int) -> Mask:
        return np.rot90(super()._cells(tag_id), 2)


@pytest.mark.parametrize("pose", POSES)
def test_tags_printed_half_a_turn_from_kalibrs_are_the_same_grid(pose):
    printed = HalfTurned(*(getattr(MARKING, field.name) for field in fields(MARKING)))
    (view,) = detect_views(picture(Rectangle("board", *printed.size, printed), pose), [BOARD])
    gap = view.pixels - LENS.project(pose.transform(view.points))
    assert len(gap) == 4 * MARKING.columns * MARKING.rows
    assert np.abs(gap).max() < 0.3


def test_a_single_border_is_read_by_the_makers_detector_of_such_tags():
    pupil = pytest.importorskip("pupil_apriltags", reason="pupil-apriltags is not installed")
    oracle = pupil.Detector("tag36h11", quad_decimate=1.0)
    marking = AprilGridMarking(4, 3, 0.05, 0.3, border=1)
    board, pose = Rectangle("board", *marking.size, marking), POSES[1]
    image, truth = picture(board, pose), tag_corners(pose)
    found = oracle.detect(image)
    assert len(found) >= 8
    for tag in found:
        # Its corners run counter-clockwise from the bottom left of an upright tag, as Kalibr counts them; it counts
        # pixels from their corner.
        np.testing.assert_allclose(tag.corners - 0.5, truth[tag.tag_id], atol=1)
    (view,) = detect_views(image, [board])
    assert np.abs(view.pixels - LENS.project(pose.transform(view.points))).max() < 0.2


@pytest.mark.parametrize(
    ("changed", "said"),
    [({"spacing": 30.0}, "such as 0.3"), ({"rows": 200}, "has no tag 799"), ({"tag": 0.0}, "measured length")],
)
def test_what_cannot_be_printed_is_refused(changed, said):
    with pytest.raises(QuadrigError, match=said):
        AprilGridMarking(**{"columns": 4, "rows": 3, "tag": 0.05, "spacing": 0.3, **changed})
