"""One View or several to a lens with its distortion, and the words on what limits it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from quadrig.single.calibration import calibrate_view, calibrate_views
from quadrig.single.detect.image_search import detect_views
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.boards import board_points
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle, rectangle_corners
from quadrig.single.rotation import rotation_from_angles
from quadrig.single.solve.corners import Reason, in_turn
from quadrig.single.view import View

SIZE = (1920, 1080)
MIDDLE = np.array([959.5, 539.5])
LENS = Intrinsics(*SIZE, 1400.0, MIDDLE)


def sheet_view(tilt_degrees, rng=None, noise=0.2, lens=LENS, points=None, place=(0.03, 0.02, 0.8)):
    points = rectangle_corners(0.297, 0.21) if points is None else points
    pose = Pose(rotation_from_angles(np.radians(tilt_degrees), 0.0, 0.3), np.array(place))
    pixels = lens.project(pose.transform(points))
    if rng is not None:
        pixels = pixels + rng.normal(0, noise, pixels.shape)
    return View("sheet", points, pixels, sigma=noise), pose


def board_views(rng, lens, count=5, noise=0.2):
    points = board_points(9, 7, 0.03)
    views = []
    for _ in range(count):
        (theta_x, theta_y), theta_z = rng.uniform(-0.7, 0.7, 2), rng.uniform(-3, 3)
        rotation = rotation_from_angles(theta_x, theta_y, theta_z)
        pose = Pose(rotation, np.array([*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.5, 0.8)]))
        pixels = lens.project(pose.transform(points)) + rng.normal(0, noise, (len(points), 2))
        views.append(View("board", points, pixels, sigma=noise))
    return views


def test_a_distorted_lens_from_several_views_is_found_within_its_sigmas():
    rng = np.random.default_rng(1)
    truth = Intrinsics(*SIZE, 1400.0, np.array([972.0, 528.0]), np.array([-0.21, 0.06, 0.0, 0.0, 0.0]))
    found = calibrate_views(board_views(rng, truth), SIZE, distortion="k1 k2")
    error = found.intrinsics.parameters - truth.parameters
    sigma = np.sqrt(np.diag(found.lens_covariance))
    free = [0, 1, 2, 3, 4]
    assert (np.abs(error[free]) < 4 * sigma[free]).all()
    assert found.focal_sigma < 5
    assert found.noise == pytest.approx(0.2, rel=0.1)
    assert found.rms == pytest.approx(0.2 * np.sqrt(2), rel=0.15)


def test_distortion_is_not_invented():
    rng = np.random.default_rng(2)
    found = calibrate_views(board_views(rng, LENS), SIZE)
    sigma = np.sqrt(np.diag(found.lens_covariance))
    assert (np.abs(found.intrinsics.parameters - LENS.parameters) < 3 * sigma).all()
    # Nothing that real lenses have is taken for known, and nothing is left as open as it was.
    assert (sigma[3:8] > 0).all()
    assert sigma[3] < 0.02
    assert (calibrate_views(board_views(rng, LENS), SIZE, distortion="none").intrinsics.distortion == 0).all()


def test_several_views_of_one_camera_know_more_than_each_alone():
    rng = np.random.default_rng(3)
    views = board_views(rng, LENS)
    together = calibrate_views(views, SIZE, principal_point=MIDDLE, distortion="none")
    alone = [calibrate_view(view, SIZE, principal_point=MIDDLE, distortion="none") for view in views]
    information = sum(one.focal_sigma**-2 for one in alone)
    # More than the sum of what each knows: the sheet's shape, and what the lens leaves, are the same in all.
    assert 0.5 * information**-0.5 < together.focal_sigma < information**-0.5
    assert abs(together.intrinsics.focal - 1400) < 4 * together.focal_sigma


def test_sigmas_hold_over_many_lenses():
    rng = np.random.default_rng(4)
    scores = []
    for _ in range(25):
        k1, k2 = rng.uniform(-0.3, 0.1), rng.uniform(-0.05, 0.1)
        truth = Intrinsics(*SIZE, rng.uniform(1000, 2000), MIDDLE, np.array([k1, k2, 0, 0, 0]))
        found = calibrate_views(board_views(rng, truth, count=2), SIZE, principal_point=MIDDLE, distortion="k1 k2")
        error = found.intrinsics.parameters - truth.parameters
        scores.append(error[[0, 3, 4]] / np.sqrt(np.diag(found.lens_covariance))[[0, 3, 4]])
    # 75 scores of unit variance: their root mean square lies within 0.75 and 1.25 (three sigma).
    assert 0.75 < np.sqrt(np.mean(np.square(scores))) < 1.25


def test_the_priors_uncertainty_enters():
    rng = np.random.default_rng(5)
    view, _ = sheet_view(35, rng, place=(0.03, 0.02, 0.35))
    given = calibrate_view(view, SIZE, principal_point=MIDDLE)
    vague = calibrate_view(view, SIZE, principal_point=MIDDLE, principal_point_sigma=30.0)
    straight = calibrate_view(view, SIZE, principal_point=MIDDLE, distortion="none")
    assert vague.focal_sigma > 1.2 * given.focal_sigma
    assert given.focal_sigma > 2 * straight.focal_sigma
    assert calibrate_view(view, SIZE).focal_sigma > 1.5 * given.focal_sigma
    assert given.lens_covariance[1, 1] == pytest.approx(0, abs=1e-4)


def test_a_given_focal_stays_and_the_pose_is_right():
    view, pose = sheet_view(20)
    found = calibrate_view(view, SIZE, focal=1400.0, principal_point=MIDDLE, distortion="none")
    assert found.intrinsics.focal == 1400
    assert found.focal_sigma == 0
    assert np.abs(pose.step_to(found.camera_from_rects[0])).max() < 1e-6
    assert np.allclose(found.rect_from_cameras[0].translation, pose.inverse().translation, atol=1e-6)


def test_a_weak_view_says_so_in_words_with_figures():
    rng = np.random.default_rng(6)
    view, _ = sheet_view(7, rng)
    found = calibrate_view(view, SIZE, principal_point=MIDDLE)
    assert any("tilt the sheet more: at" in note and "degrees the focal is known to" in note for note in found.notes)
    flat, _ = sheet_view(0.0, rng, place=(0.0, 0.0, 0.8))
    blind = calibrate_view(flat, SIZE, principal_point=MIDDLE)
    assert blind.reason == Reason.FOCAL_UNKNOWABLE
    assert blind.focal_interval[1] == np.inf
    assert any("focal length and distance cannot be separated" in note for note in blind.notes)


def test_good_views_need_no_advice():
    rng = np.random.default_rng(7)
    assert calibrate_views(board_views(rng, LENS, noise=0.05), SIZE, principal_point=MIDDLE).notes == ()


def test_the_reading_that_fits_is_taken():
    rng = np.random.default_rng(8)
    view, _ = sheet_view(40, rng)
    upright = rectangle_corners(0.297, 0.21)
    wrong = np.roll(upright, 1, axis=0)
    found = calibrate_view(
        View("sheet", wrong, view.pixels, alternatives=(upright,), sigma=0.2), SIZE, principal_point=MIDDLE
    )
    assert found.readings == (1,)
    assert abs(found.intrinsics.focal - 1400) < 4 * found.focal_sigma
    assert any("read rotated" in note for note in found.notes)


@pytest.mark.parametrize(
    "options", [{}, {"principal_point": MIDDLE}, {"principal_point": MIDDLE, "distortion": "none"}]
)
def test_a_rectangle_of_the_wrong_size_is_said_to_miss(options):
    rng = np.random.default_rng(9)
    view, _ = sheet_view(45, rng)
    wrong = View("sheet", rectangle_corners(0.297, 0.297), view.pixels, sigma=0.2)
    assert any("check the sizes" in note for note in calibrate_view(wrong, SIZE, **options).notes)
    assert not any("check the sizes" in note for note in calibrate_view(view, SIZE, **options).notes)


def test_a_board_of_squares_that_are_none_misses_by_more_than_its_noise():
    rng = np.random.default_rng(9)
    view, _ = sheet_view(45, rng, points=board_points(9, 7, 0.03))
    wrong = View("board", view.points * [1, 1.1, 1], view.pixels + rng.normal(0, 2, view.pixels.shape), sigma=0.2)
    assert any("times their noise" in note for note in calibrate_view(wrong, SIZE).notes)


@pytest.mark.parametrize(
    ("pixels", "words"),
    [
        ([[0, 0], [10, 10], [20, 20], [0, 30]], "one line"),
        ([[300, 220], [110, 90], [100, 200], [290, 60]], "cross"),
        ([[290, 60], [110, 90], [100, 200], [300, 220]], "wrong way"),
        ([[300, 220], [100, 200], [110, np.nan], [290, 60]], "nan"),
    ],
)
def test_bad_corners_are_named(pixels, words):
    view = View("door", rectangle_corners(0.9, 2.0), np.array(pixels, float), camera="hall")
    with pytest.raises(QuadrigError, match=words) as caught:
        calibrate_view(view, (320, 240))
    assert "door" in str(caught.value)
    assert "hall" in str(caught.value)


def test_bad_arguments_are_named():
    view, _ = sheet_view(30)
    with pytest.raises(QuadrigError, match="no View"):
        calibrate_views([], SIZE)
    with pytest.raises(QuadrigError, match="0x1080"):
        calibrate_view(view, (0, 1080))
    with pytest.raises(QuadrigError, match="focal"):
        calibrate_view(view, SIZE, focal=-3.0)
    with pytest.raises(QuadrigError, match="points"):
        calibrate_view(View("sheet", view.points[:3], view.pixels), SIZE)


def test_corners_in_the_wrong_turn_are_read_as_with_y_upwards():
    given = np.array([[300.0, 220.0], [100.0, 200.0], [110.0, 90.0], [290.0, 60.0]])
    assert not in_turn(given)[1]
    # Eq. 4 with y up: (+,+) is the top right, (-,+) the top left.
    y_up = given[[3, 2, 1, 0]]
    corrected, changed = in_turn(y_up)
    assert changed
    assert (corrected == given).all()
    with pytest.raises(QuadrigError, match="cross"):
        in_turn(given[[0, 2, 1, 3]])


INCH = 0.0254


def microsoft_views(folder):
    model = np.loadtxt(folder / "Model.txt").reshape(-1, 2) * INCH
    middle = (model.min(axis=0) + model.max(axis=0)) / 2
    points = np.concatenate([model - middle, np.zeros((len(model), 1))], axis=1)
    pixels = [np.loadtxt(folder / f"data{i}.txt").reshape(-1, 2) for i in range(1, 6)]
    return [View("board", points, p, frameset=i, sigma=0.2) for i, p in enumerate(pixels)]


def misses(found, least, most):
    """How many sigmas focals are off, what is known of the truth being a range; and how many intervals hold it."""
    scores = [(c.intrinsics.focal - np.clip(c.intrinsics.focal, least, most)) / c.focal_sigma for c in found]
    return np.array(scores), sum(c.focal_interval[0] <= most and c.focal_interval[1] >= least for c in found)


def calibrated(folder, pattern, rectangle):
    for path in sorted(folder.glob(pattern)):
        picture = np.asarray(cv2.imread(str(path)), np.uint8)
        for view in detect_views(picture, [rectangle]):
            yield calibrate_view(view, (picture.shape[1], picture.shape[0]))


@pytest.mark.parametrize(("side", "focal"), [("left", 535.9), ("right", 542.4)])
def test_thirteen_real_views_each_alone_are_as_far_off_as_their_sigmas_say(shared_data, side, focal):
    """OpenCV's two cameras: the left's published focal, and what calibrateCamera gives of all of the right's."""
    board = Rectangle("board", 0.25, 0.175, ChessboardMarking(10, 7, 0.025))
    scores, held = misses(list(calibrated(shared_data / "stereo", f"{side}*.jpg", board)), focal, focal)
    assert len(scores) == 13
    assert held >= 11
    assert 0.7 < np.sqrt(np.mean(scores**2)) < 1.4


def test_gopros_that_see_one_tag_know_what_they_do_not(shared_data):
    """Their focal is 2433 px by the rig's authors, 2440 by the lens's own calibration; k1 is beyond most lenses'."""
    tag = Rectangle("tag", 0.15, 0.15, TagMarking("aruco_4x4_250", 0))
    scores, held = misses(list(calibrated(shared_data / "floor" / "images", "camera_*.jpg", tag)), 2433.1, 2439.8)
    assert len(scores) >= 14
    assert held >= len(scores) - 1
    assert np.abs(scores).max() < 3


@pytest.mark.parametrize("centre", [None, np.array([303.959, 206.585])])
def test_microsofts_four_corners_are_within_their_sigmas(shared_data, centre):
    corners = [30, 3, 224, 253]
    views = [
        View("board", view.points[corners], view.pixels[corners], sigma=0.2)
        for view in microsoft_views(shared_data / "zhang")
    ]
    scores, held = misses([calibrate_view(v, (640, 480), principal_point=centre) for v in views], 832.5, 832.5)
    assert held >= 4
    assert np.abs(scores).max() < 3


def test_microsofts_views_alone_and_together(shared_data):
    """The published answer from all five views is 832.5 px, with this principal point."""
    views, centre = microsoft_views(shared_data / "zhang"), np.array([303.959, 206.585])
    alone = [calibrate_view(view, (640, 480), principal_point=centre) for view in views]
    assert all(abs(one.intrinsics.focal - 832.5) < 3 * one.focal_sigma for one in alone)
    # The board of one of them may be bent, or the lens leave something: what 256 points say of it is no better.
    assert np.median([one.focal_sigma for one in alone]) < 0.025 * 832.5
    assert max(one.focal_sigma for one in alone) < 0.05 * 832.5
    together = calibrate_views(views, (640, 480))
    assert together.intrinsics.focal == pytest.approx(832.5, rel=0.002)
    assert together.intrinsics.principal_point == pytest.approx(centre, abs=3)
    # The published lens has no k3.
    same = calibrate_views(views, (640, 480), distortion="k1 k2")
    radial, sigma = same.intrinsics.distortion[:2], np.sqrt(np.diag(same.lens_covariance))[3:5]
    assert (np.abs(radial - [-0.2286, 0.1904]) < 3 * sigma).all()
    assert (sigma < [0.02, 0.05]).all()
    # With the middle of the picture for a principal point (33 px from the truth) each sigma must carry that.
    for view in views:
        one = calibrate_view(view, (640, 480), distortion="k1 k2", principal_point_sigma=30.0)
        assert abs(one.intrinsics.focal - 832.5) < 4 * one.focal_sigma


def cube_view(folder, frameset, board):
    """One board of the cube in a training picture: points (P, 3) with y down, and pixels."""
    points, seen, number = {}, [], -1
    for line in (folder / "boards.dsc").read_text().splitlines():
        fields = line.split(",")
        number = int(fields[0]) if len(fields) == 4 else number
        if len(fields) == 6 and number == board:
            points[len(points)] = [float(fields[3]) / 100, -float(fields[4]) / 100, 0.0]
    for line in sorted((folder / "train").glob("*.orpc"))[frameset].read_text().splitlines():
        fields = line.split(",")
        if len(fields) == 5 and int(fields[0]) == board:
            seen.append((points[int(fields[1])], [float(fields[3]), float(fields[4])]))
    located, pixels = (np.array(part) for part in zip(*seen, strict=True))
    located[:, :2] -= (located[:, :2].min(axis=0) + located[:, :2].max(axis=0)) / 2
    return View("board", located, pixels, sigma=0.2)


@pytest.mark.parametrize(("frameset", "board"), [(5, 0), (7, 4)])
def test_a_fisheye_is_found_in_one_picture(shared_data, frameset, board):
    """Real boards through a lens of 180 degrees, whose focal is 350 to 351 px: few corners, or near
    the edge, where no pinhole sees. A pinhole that has to be says that it cannot tell."""
    view = cube_view(shared_data / "cube", frameset, board)
    found = calibrate_view(view, (1280, 800))
    assert found.intrinsics.model == "fisheye"
    assert found.rms < 0.3
    assert abs(found.intrinsics.focal - 350.5) < 3 * found.focal_sigma + 0.5
    assert found.focal_sigma < 0.03 * 350
    blind = calibrate_view(view, (1280, 800), model="pinhole")
    assert blind.reason == Reason.FOCAL_UNKNOWABLE
    assert blind.focal_interval[1] == np.inf


def test_a_pinhole_with_a_board_of_the_wrong_size_is_no_fisheye():
    """What neither model meets is called neither: a board half as high as it is said to be."""
    rng = np.random.default_rng(4)
    [view] = board_views(rng, LENS, count=1)
    wrong = calibrate_view(replace(view, points=view.points * [1.0, 2.0, 1.0]), SIZE)
    assert wrong.intrinsics.model == "pinhole"
