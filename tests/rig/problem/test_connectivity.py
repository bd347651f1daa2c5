"""What is missing is named: who shares nothing, with whom it comes nearest, and what to show."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.rig.doubt.verdict import verdict
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import project
from quadrig.single.markings.boards import board_points
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.rotation import rotation_from_vector
from quadrig.single.view import View


def apart(made, name, frames=500):
    """The same Views, but this camera sees the sheet at other instants than everybody else, and no tag."""
    moved = [replace(v, frameset=v.frameset + frames) if v.camera == name else v for v in made.views]
    return [v for v in moved if v.camera != name or v.rectangle == "sheet"]


def test_a_camera_that_shares_nothing_is_left_out_and_named(board_rig):
    made, _ = board_rig
    found = calibrate(made.inputs, made.rectangles, apart(made, "cam1"))
    assert {c.name for c in found.cameras} == {"cam0", "cam2"}
    assert found.missing.keys() == {"cam1"}
    sentence = found.missing["cam1"]
    for word in ("cam1", "sheet", "hold"):
        assert word in sentence
    assert "cam0" in sentence or "cam2" in sentence
    # The others are as good as they are without it.
    without = calibrate(
        [c for c in made.inputs if c.name != "cam1"], made.rectangles, [v for v in made.views if v.camera != "cam1"]
    )
    assert found.working_accuracy == pytest.approx(without.working_accuracy, rel=1e-9)


def test_the_camera_that_comes_nearest_is_the_one_named(board_rig):
    made, _ = board_rig
    views = [v for v in apart(made, "cam1") if v.rectangle == "sheet"]
    last = max(v.frameset for v in views if v.camera != "cam1")
    views = [v for v in views if v.camera == "cam1" or v.frameset != last]
    nearest = View("sheet", *points_and_pixels(views, "cam2"), "cam2", 495)
    first = min(v.frameset for v in views if v.camera == "cam1")
    found = calibrate(made.inputs, made.rectangles, [*views, nearest])
    assert "cam2" in found.missing["cam1"]
    assert f"{first - 495} framesets apart" in found.missing["cam1"]


def points_and_pixels(views, camera):
    view = next(v for v in views if v.camera == camera)
    return view.points, view.pixels


def test_a_camera_that_saw_nothing_is_told_what_to_be_shown(board_rig):
    made, _ = board_rig
    found = calibrate([*made.inputs, CameraInput("door", 1280, 720)], made.rectangles, made.views)
    assert found.missing.keys() == {"door"}
    assert "saw no rectangle" in found.missing["door"]


def test_the_larger_of_two_groups_is_the_rig(simulated):
    made = simulated.simulate(14, simulated.Scene(cameras=5, framesets=30, tags=0))
    pair = {"cam0", "cam1"}
    views = [replace(v, frameset=v.frameset + 500) if v.camera in pair else v for v in made.views]
    found = calibrate(made.inputs, made.rectangles, views, reference="cam3")
    assert {c.name for c in found.cameras} == {"cam2", "cam3", "cam4"}
    assert found.missing.keys() == pair
    assert "only with cam1" in found.missing["cam0"]
    assert found.reference == "cam3"


def test_a_reference_that_is_left_out_gives_way(board_rig):
    made, _ = board_rig
    found = calibrate(made.inputs, made.rectangles, apart(made, "cam0"), reference="cam0")
    assert found.reference == "cam1"
    assert "cam0" in found.missing


def test_where_no_two_cameras_share_each_has_its_lens_and_the_rest_is_said(board_rig):
    made, _ = board_rig
    views = [v for v in apart(made, "cam1") if v.camera != "cam2"]
    found = calibrate(made.inputs, made.rectangles, views)
    assert [c.name for c in found.cameras] == ["cam0"]
    assert [camera.name for _, camera in found.lens_only] == ["cam1"]
    assert found.missing.keys() == {"cam1", "cam2"}
    assert "saw no rectangle" in found.missing["cam2"]
    said = verdict(found)
    assert said.grade == "with care"
    assert "Poses need a rectangle that two cameras see at one time" in said.headline
    for rig, camera in ((found, found.cameras[0]), *found.lens_only):
        error = camera.intrinsics.focal - made.lenses[made.index(camera.name), 0]
        assert abs(error) < 4 * rig.focal_sigma(camera.name)


def test_a_group_that_shares_nothing_with_the_rig_is_a_rig_of_its_own(simulated):
    made = simulated.simulate(14, simulated.Scene(cameras=5, framesets=30, tags=0))
    pair = {"cam0", "cam1"}
    views = [replace(v, frameset=v.frameset + 500) if v.camera in pair else v for v in made.views]
    (other,) = calibrate(made.inputs, made.rectangles, views).apart
    assert {c.name for c in other.cameras} == pair
    step = other.camera("cam1").rig_from_camera.step_to(made.rig_from_camera(other.reference, "cam1"))
    covariance = other.pose_covariance("cam1")
    assert step @ np.linalg.solve(covariance, step) < 6 * 2.2**2


def test_nothing_seen_at_all_is_said(board_rig):
    made, _ = board_rig
    with pytest.raises(QuadrigError, match="no rectangle was found"):
        calibrate(made.inputs, made.rectangles, [])


def shown_square(lens_beside, rng):
    """A board held square to a camera "flat" and to cam0 beside it: in "flat" no perspective tells the focal."""
    points = board_points(9, 7, 0.06)
    lens = np.array([1000.0, 640, 360, 0, 0, 0, 0, 0, 1.0])
    views = []
    for frameset in range(1000, 1008):
        turn = rotation_from_vector(np.array([0, 0, rng.uniform(-1, 1)]))
        located = Pose(turn, np.array([*rng.uniform(-0.3, 0.3, 2), 2.0])).transform(points)
        beside = located + np.array([0.2, 0.0, 0.0])
        for name, seen in (("flat", project(lens, located)), ("cam0", project(lens_beside, beside))):
            views.append(View("wall", points, seen + 0.3 * rng.normal(size=seen.shape), name, frameset))
    return views


def test_a_camera_whose_views_are_all_flat_on_is_told_to_tilt(board_rig):
    made, _ = board_rig
    wall = Rectangle("wall", 0.54, 0.42, moving=True)
    views = shown_square(made.lenses[made.index("cam0")], np.random.default_rng(0))
    inputs = [*made.inputs, CameraInput("flat", 1280, 720)]
    rig = calibrate(inputs, [*made.rectangles, wall], [*made.views, *views])
    flat = rig.camera("flat")
    # Flat on, the true 1000 px and any other focal show the same: the sigma must say so.
    assert abs(flat.intrinsics.focal - 1000) < 2 * rig.focal_sigma("flat")
    assert rig.focal_sigma("flat") > 0.2 * flat.intrinsics.focal
    assert not flat.observable_focal
    assert all(rig.focal_sigma(c.name) / c.intrinsics.focal < 0.02 for c in rig.cameras if c.name != "flat")
    told = [sentence for sentence in rig.weak if sentence.startswith("flat:") and "tilt" in sentence]
    assert told
    assert not [s for s in rig.weak if s.startswith("cam0:") and "tilt" in s]
    assert all(c.observable_focal for c in rig.cameras if c.name != "flat")
