"""Motion between framesets: a parabola is followed exactly, and what cannot be determined is not."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.adjustment.motion import LONGEST_GAP, Motion, motion
from quadrig.rig.problem.build import build_problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

SHEET, WALL = Rectangle("sheet", 0.3, 0.2, moving=True), Rectangle("wall", 0.3, 0.2)
NAMES = ("a", "b", "c", "d")
VELOCITY, BEND = np.array([0.3, -0.2, 0.5]), np.array([0.4, 0.6, -0.8])


def path(time):
    """Where the sheet's middle is: a parabola."""
    time = np.asarray(time)[..., None]
    return time * VELOCITY + time**2 * BEND


def recorded(framesets, seen=NAMES, lag=(0.0, 0.005, -0.003, 0.0), rate=20.0):
    """Views of the sheet in these framesets, stamped some ms apart, and of a wall that the first two cameras see."""
    views = [
        View("sheet", SHEET.corners, 1e3 * SHEET.corners[:, :2], name, k, time=k / rate + lag[NAMES.index(name)])
        for k in framesets
        for name in seen
    ]
    views += [View("wall", WALL.corners, 1e3 * WALL.corners[:, :2], name, 0, time=0.0) for name in "ab"]
    return build_problem([CameraInput(name, 640, 480) for name in NAMES], [SHEET, WALL], views)


def taken(problem, clocks):
    """When each View (V,) was truly taken: its mean row, of pictures of 480."""
    rows = np.array([view.pixels[:, 1].mean() for view in problem.views]) - 239.5
    by_clock = np.stack([np.ones_like(rows), rows], axis=1)
    return np.array([view.time for view in problem.views]) + (clocks[problem.camera] * by_clock).sum(axis=1)


def when(problem, clocks):
    """The mean of when the Views of each node (N,) were truly taken."""
    true = taken(problem, clocks)
    return np.bincount(problem.node, true) / np.bincount(problem.node)


def found(problem, clocks=None):
    clocks = np.zeros((4, 2)) if clocks is None else clocks
    poses = Pose(np.tile(np.eye(3), (len(problem.nodes), 1, 1)), path(when(problem, clocks)))
    return poses, motion(problem, poses, clocks)


@pytest.mark.parametrize("lines", [0.0, 30e-6])
@pytest.mark.parametrize("offsets", [np.zeros(4), np.array([0.0, 0.02, -0.03, 0.01])])
def test_a_parabola_is_followed_to_where_each_view_was_taken(offsets, lines):
    """At both ends of a run too, where both neighbours lie on one side."""
    problem = recorded([*range(5), *range(40, 45)])
    clocks = np.stack([offsets, np.full(4, lines)], axis=1)
    poses, moved = found(problem, clocks)
    assert moved is not None
    step = moved.step(clocks[problem.camera])
    moving = np.array([view.rectangle == "sheet" for view in problem.views])
    true = taken(problem, clocks)
    seen = poses[problem.node].retract(step)
    np.testing.assert_allclose(seen.translation[moving], path(true)[moving], atol=1e-12)
    # What stands still stays.
    np.testing.assert_array_equal(step[~moving], 0)


def test_the_slope_is_the_derivative_of_the_step():
    rng = np.random.default_rng(1)
    rate, bend = rng.normal(size=(2, 7, 6))
    rows = 100 * rng.normal(size=(2, 7))
    moved = Motion(rate, bend, rng.normal(size=7), rows[0], rows[1], np.ones(3, bool), np.ones((3, 2), bool))
    clocks, by_row = rng.normal(size=(7, 2)) * [1, 1e-2], np.array([0, 1e-8])
    by_offset = np.array([1e-6, 0])
    slope = (moved.step(clocks + by_offset) - moved.step(clocks - by_offset)) / 2e-6
    np.testing.assert_allclose(moved.slope(clocks), slope, atol=1e-8)
    along = (moved.step(clocks + by_row) - moved.step(clocks - by_row)) / 2e-8
    np.testing.assert_allclose(moved.slope(clocks) * moved.by_clock[:, 1:], along, atol=1e-5)


def test_framesets_far_apart_say_nothing_of_each_other():
    assert found(recorded(range(0, 100, 10)))[1] is None
    near = 0.9 * LONGEST_GAP
    assert found(recorded(range(8), rate=1 / near))[1] is not None
    assert found(recorded(range(8), rate=1 / (1.1 * LONGEST_GAP)))[1] is None
    # Two framesets make no parabola.
    assert found(recorded([0, 1, 40, 41, 80, 81]))[1] is None


def test_a_pose_that_one_camera_alone_saw_says_nothing_of_its_neighbours():
    assert found(recorded(range(10), seen=("a",)))[1] is None


def test_of_cameras_that_share_a_rectangle_one_holds_the_clock():
    _, moved = found(recorded(range(8)))
    assert moved is not None
    assert moved.observable.tolist() == [True] * 4
    assert moved.free[:, 0].tolist() == [False, True, True, True]
    # Each has its own shutter.
    assert moved.free[:, 1].all()


def test_a_line_time_that_is_given_is_not_estimated():
    problem = recorded(range(8))
    cameras = [replace(one, line_time=2e-5 if one.name in "ac" else None) for one in problem.cameras]
    given = build_problem(cameras, [SHEET, WALL], problem.views)
    np.testing.assert_array_equal(given.first_clocks, [[0, 2e-5], [0, 0], [0, 2e-5], [0, 0]])
    _, moved = found(given, given.first_clocks)
    assert moved is not None
    assert moved.free.tolist() == [[False, False], [True, True], [True, False], [True, True]]


def test_a_camera_that_saw_little_motion_has_no_clock_of_its_own():
    problem = recorded(range(8))
    few = [v for v in problem.views if v.camera != "d" or v.frameset < 5]
    _, moved = found(build_problem(problem.cameras, [SHEET, WALL], few))
    assert moved is not None
    assert moved.observable.tolist() == [True, True, True, False]
    enough = [v for v in problem.views if v.camera != "d" or v.frameset < 6]
    _, moved = found(build_problem(problem.cameras, [SHEET, WALL], enough))
    assert moved is not None
    assert moved.observable.all()


def test_cameras_that_share_no_moving_rectangle_hold_a_clock_each():
    """The wall that a and b see besides joins no clocks."""
    first, second = recorded(range(8), seen=("a", "c")), recorded(range(40, 48), seen=("b", "d"))
    problem = build_problem(first.cameras, [SHEET, WALL], [*first.views, *second.views])
    _, moved = found(problem)
    assert moved is not None
    assert moved.free[:, 0].tolist() == [False, False, True, True]


def test_views_without_a_stamp_stay_where_their_frameset_is():
    problem = recorded(range(8))
    views = [
        v if v.camera != "d" else View(v.rectangle, v.points, v.pixels, v.camera, v.frameset) for v in problem.views
    ]
    unstamped = build_problem(problem.cameras, [SHEET, WALL], views)
    poses = Pose(np.tile(np.eye(3), (len(unstamped.nodes), 1, 1)), np.zeros((len(unstamped.nodes), 3)))
    poses.translation[:, 0] = np.arange(len(unstamped.nodes))
    moved = motion(unstamped, poses, np.zeros((4, 2)))
    assert moved is not None
    own = np.array([view.camera == "d" for view in unstamped.views])
    np.testing.assert_array_equal(moved.step(np.zeros((len(own), 2)))[own], 0)
    assert np.isfinite(moved.step(np.zeros((len(own), 2)))).all()
    assert moved.observable.tolist() == [True, True, True, False]
