"""Detection on rendered pictures, where the truth is known."""

import itertools

import numpy as np
import pytest

from quadrig.single.arrays import Floats, Picture
from quadrig.single.detect.dictionaries import canonical_dictionary, dictionary_names
from quadrig.single.detect.image_search import check_rectangles, detect_views
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.blank_sheet import PlainMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Marking, Rectangle
from quadrig.single.render.capture import Capture
from quadrig.single.render.picture import Sheet, ray_grid, render_image
from quadrig.single.rotation import rotation_from_vector
from quadrig.single.view import View

LENS = Intrinsics(480, 360, 520.0, np.array([242.0, 178.0]), np.array([-0.25, 0.08, 1e-3, -5e-4, 0.0]))
GRID = ray_grid(LENS)

TAG = Rectangle("tag", 0.16, 0.16, TagMarking("apriltag_36h11", 5))
CHESS = Rectangle("chess", 0.28, 0.24, ChessboardMarking(7, 6, 0.04))
PLAIN = Rectangle("plain", 0.297, 0.21, PlainMarking())


def charuco(**kind) -> Rectangle:
    return Rectangle("board", 0.25, 0.2, CharucoMarking(5, 4, 0.05, 0.038, "aruco_4x4_50", **kind))


BOARDS = [charuco(), charuco(legacy=True), charuco(inverted=True), charuco(legacy=True, inverted=True, first_id=20)]


def pose(x: float, y: float, z: float, tilt=(0.0, 0.0, 0.0)) -> Pose:
    return Pose(rotation_from_vector(np.array(tilt)), np.array([x, y, z]))


def picture(rectangle: Rectangle, where: Pose, *, tone: float = 0.82, **light) -> Picture:
    capture = Capture(**{"noise": 1.0, "blur": 0.6, **light})
    sheets = [Sheet(rectangle, where, tone=tone)]
    return render_image(GRID, Pose.identity(), sheets, capture=capture, samples=6, colour=False)


def errors(view: View, where: Pose) -> Floats:
    """Pixels seen less pixels of the truth, for the reading that fits."""
    gaps = [view.pixels - LENS.project(where.transform(points)) for points in view.readings]
    return min(gaps, key=lambda gap: float(np.abs(gap).max()))


POSES = [
    pose(0.02, -0.01, 0.7),
    pose(-0.1, 0.05, 0.8, (0.5, -0.3, 0.4)),
    pose(0.1, 0.0, 0.9, (-0.4, 0.5, 2.0)),
    pose(0.0, -0.08, 0.75, (0.2, 0.6, -2.8)),
]


@pytest.mark.parametrize("rectangle", [TAG, CHESS, PLAIN, *BOARDS], ids=lambda r: repr(r.marking)[:60])
def test_corners_are_where_they_are(rectangle):
    gaps, sigma = [], []
    for where in POSES:
        views = detect_views(picture(rectangle, where), [rectangle])
        assert len(views) == 1
        gaps.append(errors(views[0], where))
        sigma.append(views[0].sigma)
    gap = np.concatenate(gaps)
    # Noise of one grey level at 170 of contrast is 0.01 px in a corner; ten times that is a wrong model.
    assert np.sqrt(np.mean(gap**2)) < 0.04
    assert np.abs(gap).max() < 0.15
    assert np.sqrt(np.mean(gap**2)) < 2 * np.mean(sigma)


@pytest.mark.parametrize("rectangle", [TAG, CHESS], ids=["tag", "chess"])
@pytest.mark.parametrize("blur", [0.0, 0.5, 1.0])
def test_clean_pictures_show_no_bias(rectangle, blur):
    rng = np.random.default_rng(3)
    gaps = []
    for tilted in (0.0, 0.4):
        for _ in range(4):
            x, y = rng.uniform(-0.06, 0.06, 2)
            where = pose(x, y, 0.7, rng.uniform(-tilted, tilted, 3))
            views = detect_views(picture(rectangle, where, noise=0.0, blur=blur), [rectangle])
            gaps.append(errors(views[0], where))
    bias = np.concatenate(gaps).mean(axis=0)
    # A convention that is off by half a pixel, or a pull to the pixel grid, shows here.
    assert np.abs(bias).max() < 0.01


@pytest.mark.parametrize("turn", [0.0, np.pi / 2, np.pi, 3.0, -1.2])
def test_tag_corners_come_in_the_order_of_eq_4_however_the_tag_is_turned(turn):
    where = pose(0, 0, 0.6, (0, 0, turn))
    view = detect_views(picture(TAG, where), [TAG])[0]
    np.testing.assert_allclose(view.points, TAG.corners)
    np.testing.assert_allclose(view.pixels, LENS.project(where.transform(TAG.corners)), atol=0.1)
    assert view.alternatives == ()


@pytest.mark.parametrize(
    ("columns", "rows", "readings"), [(7, 6, 1), (7, 5, 2), (6, 4, 2), (5, 5, 4), (4, 4, 2), (5, 4, 1)]
)
def test_chessboard_has_as_many_readings_as_turns_that_look_the_same(columns, rows, readings):
    board = Rectangle("c", columns * 0.04, rows * 0.04, ChessboardMarking(columns, rows, 0.04))
    for turn in (0.3, 2.0, -2.5):
        where = pose(0, 0, 0.7, (0.1, 0.2, turn))
        view = detect_views(picture(board, where), [board])[0]
        assert len(view.readings) == readings
        gaps = [np.abs(view.pixels - LENS.project(where.transform(p))).max() for p in view.readings]
        assert min(gaps) < 0.15
        for first, second in itertools.combinations(view.readings, 2):
            assert np.abs(first - second).max() > 0.01


@pytest.mark.parametrize(("height", "readings"), [(0.21, 2), (0.297, 4)])
@pytest.mark.parametrize("tone", [0.82, 0.1])
def test_blank_sheet_has_a_reading_for_each_turn_that_looks_the_same(height, readings, tone):
    sheet = Rectangle("s", 0.297, height, PlainMarking())
    where = pose(0.02, 0.01, 0.9, (0.3, -0.2, 0.3))
    view = detect_views(picture(sheet, where, tone=tone), [sheet])[0]
    assert len(view.readings) == readings
    assert np.abs(errors(view, where)).max() < 0.15
    # Nearly upright in the picture: the first reading is the true one.
    assert np.abs(view.pixels - LENS.project(where.transform(view.points))).max() < 0.15


def test_two_blank_sheets_are_no_view():
    sheets = [Sheet(PLAIN, pose(x, 0, 1.0)) for x in (-0.2, 0.2)]
    assert detect_views(render_image(GRID, Pose.identity(), sheets, colour=False), [PLAIN]) == []


def test_printed_sheet_is_not_blank():
    image = picture(TAG, pose(0, 0, 0.5))
    assert detect_views(image, [PLAIN]) == []


def test_hidden_corner_gives_no_tag():
    where = pose(0, 0, 0.5)
    thumb = Rectangle("thumb", 0.03, 0.05, PlainMarking())
    for corner in TAG.corners:
        cover = Sheet(thumb, Pose(np.eye(3), corner + np.array([0, 0, 0.49])), tone=0.45)
        image = render_image(
            GRID, Pose.identity(), [Sheet(TAG, where), cover], capture=Capture(blur=0.6), colour=False
        )
        assert detect_views(image, [TAG]) == []


def test_partly_hidden_board_keeps_true_corners_only():
    board, where = BOARDS[0], pose(0, 0, 0.6, (0.2, -0.2, 0.1))
    hand = Sheet(Rectangle("hand", 0.08, 0.12, PlainMarking()), pose(-0.08, 0.03, 0.5, (0, 0, 0.4)), tone=0.4)
    image = render_image(
        GRID, Pose.identity(), [Sheet(board, where), hand], capture=Capture(blur=0.6, noise=1.0), colour=False
    )
    view = detect_views(image, [board])[0]
    assert 4 <= len(view.points) < 12
    assert np.abs(errors(view, where)).max() < 0.15


KINDS = [TAG, CHESS, BOARDS[0], PLAIN]
KIND_NAMES = ["tag", "chess", "charuco", "plain"]


def within_sigmas(view: View, where: Pose) -> bool:
    """Whether what is found is within a few of its own sigmas, and never a pixel off."""
    sigma = view.sigma if view.common is None else np.hypot(view.sigma, view.common)
    return bool(np.all(np.abs(errors(view, where)) < np.minimum(1.0, np.maximum(0.2, 6 * sigma))))


@pytest.mark.parametrize("rectangle", KINDS, ids=KIND_NAMES)
@pytest.mark.parametrize("light", [{"blur": 1.3}, {"exposure": 0.15}, {"noise": 12.0}, {"blur": 1.2, "noise": 6.0}])
def test_poor_pictures_still_give_their_corners(rectangle, light):
    where = pose(0.01, 0.02, 0.7, (0.3, 0.3, 0.2))
    (view,) = detect_views(picture(rectangle, where, **light), [rectangle])
    assert within_sigmas(view, where)


@pytest.mark.parametrize("rectangle", KINDS, ids=KIND_NAMES)
@pytest.mark.parametrize(
    "light",
    [{"blur": 5.0}, {"exposure": 8.0}, {"exposure": 0.02}, {"noise": 60.0}, {"blur": 2.0, "noise": 12.0}],
    ids=lambda light: " ".join(f"{k} {v}" for k, v in light.items()),
)
def test_bad_pictures_give_right_corners_or_none(rectangle, light):
    where = pose(0.01, 0.02, 0.7, (0.3, 0.3, 0.2))
    assert all(within_sigmas(view, where) for view in detect_views(picture(rectangle, where, **light), [rectangle]))


@pytest.mark.parametrize("rectangle", KINDS, ids=KIND_NAMES)
def test_noise_alone_shows_nothing(rectangle):
    noise = np.random.default_rng(1).integers(0, 256, (240, 320), dtype=np.uint8)
    assert detect_views(noise, [rectangle]) == []
    assert detect_views(np.full((240, 320, 3), 128, np.uint8), [rectangle]) == []


def test_all_kinds_in_one_picture_come_in_the_order_asked_for():
    rectangles = [CHESS, BOARDS[0], TAG]
    places = [pose(-0.33, 0.12, 1.4), pose(0.1, 0.16, 1.2), pose(0.1, -0.2, 1.2)]
    sheets = [Sheet(r, p) for r, p in zip(rectangles, places, strict=True)]
    image = render_image(GRID, Pose.identity(), sheets, capture=Capture(blur=0.5))
    views = detect_views(image, rectangles)
    assert [v.rectangle for v in views] == ["chess", "board", "tag"]
    for view, where in zip(views, places, strict=True):
        assert np.abs(errors(view, where)).max() < 0.2


def test_another_tag_and_a_larger_board_are_not_taken_for_ours():
    other = Rectangle("other", 0.16, 0.16, TagMarking("apriltag_36h11", 6))
    assert detect_views(picture(other, POSES[0]), [TAG]) == []
    larger = Rectangle("larger", 0.36, 0.28, ChessboardMarking(9, 7, 0.04))
    assert detect_views(picture(larger, POSES[0]), [CHESS]) == []


def test_boards_of_one_dictionary_are_told_apart_by_their_ids():
    second = Rectangle("second", 0.25, 0.2, CharucoMarking(5, 4, 0.05, 0.038, "aruco_4x4_50", first_id=10))
    views = detect_views(picture(second, POSES[1]), [BOARDS[0], second])
    assert [v.rectangle for v in views] == ["second"]


@pytest.mark.parametrize("name", ["DICT_4X4_50", "dict_4x4_50", "aruco_4x4_50", "4x4_50", "ARUCO_4X4_50"])
def test_dictionary_names_of_opencv_are_read(name):
    assert canonical_dictionary(name) == "aruco_4x4_50"


@pytest.mark.parametrize("name", ["apriltag_36h11", "DICT_APRILTAG_36H11", "tag36h11", "AprilTag_36h11"])
def test_april_tag_names_are_read(name):
    assert canonical_dictionary(name) == "apriltag_36h11"


def test_wrong_dictionary_names_those_that_exist():
    with pytest.raises(QuadrigError, match="apriltag_99h9") as raised:
        TagMarking("apriltag_99h9", 0)
    assert all(name in str(raised.value) for name in dictionary_names())


@pytest.mark.parametrize(("first_id", "missing"), [(-1, "-1"), (45, "54"), (50, "50")])
def test_tag_that_does_not_exist_is_named(first_id, missing):
    with pytest.raises(QuadrigError, match=f"no tag {missing}"):
        charuco(first_id=first_id)
    if missing == str(first_id):
        with pytest.raises(QuadrigError, match=f"no tag {missing}"):
            TagMarking("aruco_4x4_50", first_id)


@pytest.mark.parametrize("marking", [TAG.marking, CHESS.marking, PLAIN.marking, BOARDS[0].marking])
def test_two_rectangles_that_look_alike_are_refused(marking: Marking):
    with pytest.raises(QuadrigError, match="'one' and 'two'"):
        check_rectangles([Rectangle("one", 0.2, 0.2, marking), Rectangle("two", 0.3, 0.3, marking)])


@pytest.mark.parametrize("image", [np.zeros((5, 5)), np.zeros((5, 5, 2), np.uint8), np.zeros(5, np.uint8)])
def test_what_is_no_image_is_said(image):
    with pytest.raises(QuadrigError, match="8-bit"):
        detect_views(image, [TAG])


@pytest.mark.parametrize("shape", [(0, 5), (0, 5, 3), (5, 0, 3), (0, 0)])
def test_a_picture_without_pixels_is_said(shape):
    with pytest.raises(QuadrigError, match="no pixels"):
        detect_views(np.zeros(shape, np.uint8), [TAG])


@pytest.mark.parametrize("rectangle", [*KINDS, BOARDS[3]], ids=lambda r: repr(r.marking)[:60])
@pytest.mark.parametrize("step", [0.0, 0.004, 0.1], ids=["still", "slow", "far"])
def test_near_an_earlier_view_the_same_corners_are_found(rectangle, step):
    first, then = pose(-0.05, 0.02, 0.8, (0.3, -0.2, 0.2)), pose(-0.05 + step, 0.02, 0.8, (0.3, -0.2 + step, 0.2))
    before = detect_views(picture(rectangle, first), [rectangle])
    image = picture(rectangle, then)
    near, whole = detect_views(image, [rectangle], near=before)[0], detect_views(image, [rectangle])[0]
    np.testing.assert_array_equal(near.points, whole.points)
    # The same fit from another start: it ends within its own tolerance.
    np.testing.assert_allclose(near.pixels, whole.pixels, atol=0.02)


def test_another_tag_in_the_place_of_an_earlier_one_is_not_taken_for_it():
    other = Rectangle("other", 0.16, 0.16, TagMarking("apriltag_36h11", 6))
    before = detect_views(picture(TAG, POSES[0]), [TAG])
    assert detect_views(picture(other, POSES[0]), [TAG], near=before) == []
    assert [v.rectangle for v in detect_views(picture(other, POSES[0]), [TAG, other], near=before)] == ["other"]


def test_where_nothing_was_before_all_is_found():
    views = detect_views(picture(BOARDS[0], POSES[0]), BOARDS[:1], near=[])
    assert len(views[0].points) == 12


def test_part_of_a_larger_chessboard_is_not_ours():
    # The same squares, more of them: any six by five corners of it would pass for our board.
    for columns, rows in ((8, 6), (7, 7), (10, 8)):
        larger = Rectangle("larger", columns * 0.03, rows * 0.03, ChessboardMarking(columns, rows, 0.03))
        assert detect_views(picture(larger, pose(0, 0, 0.6, (0.2, 0.1, 0.1))), [CHESS]) == []


def test_sheet_cut_off_by_the_image_is_no_view():
    assert detect_views(picture(PLAIN, pose(-0.35, 0, 0.8)), [PLAIN]) == []
