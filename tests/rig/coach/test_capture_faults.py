"""Faults of a capture, each made on purpose in a rendered picture or a simulated rig, and each named."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from quadrig.rig.coach.capture_faults import (
    blur_fault,
    exposure_fault,
    held_still_fault,
    not_static_fault,
    wrong_board_fault,
)
from quadrig.rig.coach.edge_width import view_edge_widths
from quadrig.rig.coach.novelty import Places, displaced, news, outlines_of, speed
from quadrig.rig.coach.planned_doubt import planning_doubt
from quadrig.rig.coach.printed_scale import relative_scales, scale_fault
from quadrig.rig.result import Camera, PlacedRectangle, Rig, ViewFit
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.boards import board_points
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.capture import Capture
from quadrig.single.render.picture import Sheet, render_image
from quadrig.single.rotation import rotation_from_vector
from quadrig.single.view import View

LENS = Intrinsics.centred(640, 360, 500.0)
TAG = Rectangle("tag", 0.16, 0.16, TagMarking("apriltag_36h11", 3), moving=True)
FRAMESETS = 3
DIAGONALS = {"cam0": float(np.hypot(640, 360))}


def pose_of(turn=(0.3, -0.4, 0.2), place=(0.02, -0.01, 0.7)):
    return Pose(rotation_from_vector(np.array(turn)), np.array(place))


def view_of(pose, camera="cam0", rectangle=TAG, frameset=0):
    return View(rectangle.name, rectangle.corners, LENS.project(pose.transform(rectangle.corners)), camera, frameset)


def picture_of(pose=None, motion=None, **light):
    sheet = Sheet(TAG, pose or pose_of(), motion=motion)
    return render_image(LENS, Pose.identity(), [sheet], colour=False, capture=Capture(noise=2.0, **light))


def test_a_good_picture_has_no_fault():
    grey, view = picture_of(blur=0.7), view_of(pose_of())
    assert exposure_fault("cam0", grey, view) is None
    assert blur_fault("cam0", view_edge_widths(grey, view)) is None


@pytest.mark.parametrize("sigma", [0.8, 1.5, 3.0])
def test_edge_widths_are_the_blur_that_was_put_in(sigma):
    widths = view_edge_widths(
        picture_of(pose_of(place=(0.02, -0.01, 0.4)), blur=sigma), view_of(pose_of(place=(0.02, -0.01, 0.4)))
    )
    # The pixel itself adds a box of sigma 0.29 and bilinear profiles as much again; the flanks below a tenth are cut.
    assert widths.widest == pytest.approx(np.hypot(sigma, 0.4), rel=0.2)


def test_defocus_is_called_focus():
    fault = blur_fault("cam0", view_edge_widths(picture_of(blur=3.5), view_of(pose_of())))
    assert fault is not None
    assert fault.kind == "blur"
    assert fault.sentence.startswith("cam0: the picture is out of focus")


def test_a_moving_sheet_is_called_motion():
    pose = pose_of(turn=(0.0, 0.0, 0.0), place=(0, 0, 0.5))
    # 16 px along x during the exposure.
    motion = np.array([0, 0, 0, 0.016, 0, 0])
    fault = blur_fault("cam0", view_edge_widths(picture_of(pose, motion=motion, blur=0.6), view_of(pose)))
    assert fault is not None
    assert fault.kind == "motion"
    assert "hold it still" in fault.sentence


@pytest.mark.parametrize(("exposure", "kind"), [(2.6, "too bright"), (0.12, "too dark")])
def test_exposure(exposure, kind):
    fault = exposure_fault("cam0", picture_of(exposure=exposure), view_of(pose_of()))
    assert fault is not None
    assert fault.kind == kind
    assert fault.camera == "cam0"


def test_a_sheet_held_still_is_no_news_and_is_said_so():
    places = Places().with_views(outlines_of([view_of(pose_of())], [TAG]))
    trembling = outlines_of([view_of(pose_of(place=(0.022, -0.011, 0.7)))], [TAG])
    elsewhere = outlines_of([view_of(pose_of(place=(0.15, -0.01, 0.7)))], [TAG])
    assert not news(trembling, places, DIAGONALS)
    assert news(elsewhere, places, DIAGONALS) == {("cam0", "tag")}
    assert news(trembling, Places(), DIAGONALS)
    assert held_still_fault(1.0) is None
    fault = held_still_fault(6.0)
    assert fault is not None
    assert "move it" in fault.sentence


def test_speed_is_in_diagonals_a_second():
    before = outlines_of([view_of(pose_of())], [TAG])
    after = {key: line + np.array([DIAGONALS["cam0"] / 10, 0]) for key, line in before.items()}
    assert speed(before, after, 0.5, DIAGONALS) == pytest.approx(0.2)
    assert speed({}, after, 0.5, DIAGONALS) == 0


def test_a_board_seen_in_part_is_still_where_it_is():
    board = Rectangle("board", 0.3, 0.2, CharucoMarking(6, 4, 0.05, 0.037, "aruco_4x4_50"), moving=True)
    points = board_points(6, 4, 0.05)
    pixels = LENS.project(pose_of().transform(points))
    whole, part = (View("board", points[k], pixels[k], "cam0") for k in (slice(None), slice(0, 8)))
    lines = [outlines_of([view], [board])["cam0", "board"] for view in (whole, part)]
    # OpenCV's homography holds single precision: a thousandth of a pixel inside, more where it extrapolates.
    np.testing.assert_allclose(lines[0], lines[1], atol=0.02)


def test_a_tag_that_rig_toml_does_not_name():
    board = Rectangle("board", 0.3, 0.2, CharucoMarking(6, 4, 0.05, 0.037, "aruco_4x4_50"))
    rectangles = [TAG, board]
    assert wrong_board_fault({"cam0": [("apriltag_36h11", 3), ("aruco_4x4_50", 11)]}, rectangles) is None
    # One stray tag beside a known one is somebody's poster, not the wrong sheet.
    assert wrong_board_fault({"cam0": [("apriltag_36h11", 3), ("apriltag_36h11", 9)]}, rectangles) is None
    fault = wrong_board_fault({"cam1": [("apriltag_36h11", 9)]}, rectangles)
    assert fault is not None
    assert "cam1 sees tag 9 of apriltag_36h11" in fault.sentence
    assert "3 of apriltag_36h11" in fault.sentence


def test_a_static_sheet_that_moves():
    static = Rectangle("tag", 0.16, 0.16, TAG.marking)
    places = Places().with_views(outlines_of([view_of(pose_of())], [TAG]))
    later = outlines_of([view_of(pose_of(place=(0.2, 0, 0.7)))], [TAG])
    assert displaced(later, places, [static], DIAGONALS) == ("cam0", "tag")
    assert displaced(later, places, [TAG], DIAGONALS) is None
    assert "moving = true" in not_static_fault("tag", "cam0").sentence


def rig_with_sizes(true_sizes, noise=0.1, seed=0):
    """Three cameras and moving tags whose stated sizes are all 0.16 m: the best rig that believes the statement."""
    from scipy.optimize import least_squares

    rng = np.random.default_rng(seed)
    lens = Intrinsics.centred(1280, 720, 1000.0)
    cameras = [
        Pose(rotation_from_vector(np.array([0, -0.3 * k, 0])), np.array([0.5 * k, 0, 0.1 * k])) for k in range(3)
    ]
    stated = [
        Rectangle(f"tag{k}", 0.16, 0.16, TagMarking("apriltag_36h11", k), moving=True) for k in range(len(true_sizes))
    ]
    views, truth = [], []
    for k, size in enumerate(true_sizes):
        for frameset in range(FRAMESETS):
            place = np.array([0.5, 0, 1.6]) + rng.uniform(-0.25, 0.25, 3)
            pose = Pose(rotation_from_vector(rng.uniform(-0.6, 0.6, 3)), place)
            truth.append(pose)
            for index, camera in enumerate(cameras):
                corners = stated[k].corners * size / 0.16
                pixels = lens.project((camera.inverse() @ pose).transform(corners)) + noise * rng.standard_normal(
                    (4, 2)
                )
                views.append(View(f"tag{k}", stated[k].corners, pixels, f"cam{index}", frameset, sigma=noise))

    def poses(x):
        steps = x.reshape(-1, 6)
        placed = [cameras[0], *(c.retract(s) for c, s in zip(cameras[1:], steps, strict=False))]
        return placed, [p.retract(s) for p, s in zip(truth, steps[2:], strict=True)]

    def predicted(x):
        placed, sheets = poses(x)
        return [
            lens.project(
                (
                    placed[int(v.camera[-1])].inverse() @ sheets[FRAMESETS * int(v.rectangle[-1]) + v.frameset]
                ).transform(v.points)
            )
            for v in views
        ]

    def errors(x):
        return np.concatenate([(v.pixels - p).ravel() for v, p in zip(views, predicted(x), strict=True)])

    x = least_squares(errors, np.zeros(6 * (2 + len(truth)))).x
    placed, sheets = poses(x)
    fits = [ViewFit(v, v.pixels - p, np.ones(4, bool)) for v, p in zip(views, predicted(x), strict=True)]
    rectangles = tuple(
        PlacedRectangle(
            rectangle,
            Pose(
                np.stack([p.rotation for p in sheets[FRAMESETS * k : FRAMESETS * (k + 1)]]),
                np.stack([p.translation for p in sheets[FRAMESETS * k : FRAMESETS * (k + 1)]]),
            ),
            np.zeros((FRAMESETS, 6, 6)),
            np.arange(FRAMESETS),
        )
        for k, rectangle in enumerate(stated)
    )
    solved = tuple(Camera(f"cam{k}", lens, pose, ("focal",)) for k, pose in enumerate(placed))
    return Rig("cam0", solved, rectangles, np.zeros((45, 45)), tuple(fits), noise=noise)


def test_sizes_that_agree():
    assert scale_fault(rig_with_sizes([0.16, 0.16])) is None


def test_two_sizes_that_disagree():
    rig = rig_with_sizes([0.16, 0.1552])
    scales = relative_scales(rig)
    assert scales is not None
    # One Gauss-Newton step of 3 % leaves an error of its square; three sigmas beside it.
    assert scales.log_ratio[1] == pytest.approx(np.log(0.97), abs=3 * scales.sigma[1] + 0.002)
    fault = scale_fault(rig)
    assert fault is not None
    assert "tag1 is" in fault.sentence
    assert "% smaller" in fault.sentence


@pytest.mark.parametrize("odd", [0, 2])
def test_the_odd_one_of_three_is_named(odd):
    sizes = [0.16, 0.16, 0.16]
    sizes[odd] = 0.1648
    fault = scale_fault(rig_with_sizes(sizes))
    assert fault is not None
    assert f"tag{odd} is" in fault.sentence
    assert "% larger" in fault.sentence


def test_sigma_of_the_scale_covers_its_error():
    ratios = []
    for seed in range(6):
        scales = relative_scales(rig_with_sizes([0.16, 0.16], noise=0.3, seed=seed))
        assert scales is not None
        ratios.append(scales.log_ratio[1] / scales.sigma[1])
    # Six draws of a unit normal: the root mean square lies in 0.3 to 2.0 in all but three in a thousand.
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 2.0


def with_tone(rig, share, name="tag1"):
    """The rig whose Views of a rectangle say that a tone curve may have made it look larger by such a share."""
    fits = [
        replace(fit, view=replace(fit.view, common=share * (fit.view.pixels - fit.view.pixels.mean(axis=0))))
        if fit.view.rectangle == name
        else fit
        for fit in rig.fits
    ]
    return replace(rig, fits=tuple(fits))


def test_a_tag_that_a_tone_curve_may_have_made_larger_is_not_called_larger():
    rig = rig_with_sizes([0.16, 0.1616])
    assert scale_fault(rig) is not None
    assert scale_fault(with_tone(rig, 0.01)) is None
    scales = relative_scales(with_tone(rig, 0.01))
    assert scales is not None
    # Three cameras have a tone of their own each: their mean is as sure as its third root.
    assert scales.sigma[1] == pytest.approx(0.01 / np.sqrt(3), rel=0.2)


def test_what_is_planned_with_knows_of_tone_curves():
    rig = rig_with_sizes([0.16, 0.16])
    sure, unsure = (np.diag(planning_doubt(one)[1]) for one in (rig, with_tone(with_tone(rig, 0.02), 0.02, "tag0")))
    assert (unsure >= sure * (1 - 1e-9)).all()
    # Where the third camera stands, of which a tone curve says the same in every frameset.
    assert (unsure[-3:] > 1.5 * sure[-3:]).any()


def test_views_of_other_shapes_do_no_harm():
    far = view_of(pose_of(place=(0, 0, 6.0)))
    widths = view_edge_widths(np.zeros((360, 640), np.uint8), far)
    assert blur_fault("cam0", widths) is None
    outside = View("tag", TAG.corners, view_of(pose_of()).pixels + 5000, "cam0")
    small = cv2.resize(picture_of(), (640, 360)).astype(np.uint8)
    assert exposure_fault("cam0", small, outside) is None
