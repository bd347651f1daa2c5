"""Has a camera moved? False alarms and power as promised, and answers that say what cannot be determined."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from quadrig.rig.calibration import calibrate
from quadrig.rig.moved import find_moved
from quadrig.single.errors import QuadrigError


def views_again(simulated, made, seed, poses=None):
    scene = simulated.Scene(cameras=len(made.inputs), framesets=10, noise=made.noise)
    return simulated.views_again(made, scene, seed, poses)


@pytest.fixture(scope="module")
def room(simulated):
    made = simulated.simulate(5, simulated.Scene(cameras=4, framesets=14, tags=0))
    return made, calibrate(made.inputs, made.rectangles, made.views)


def test_a_rig_that_did_not_move_is_unmoved(simulated, room):
    made, rig = room
    moves = find_moved(rig, made.rectangles, views_again(simulated, made, 1))
    assert [move.name for move in moves] == [camera.name for camera in rig.cameras]
    assert {move.state for move in moves} == {"unmoved"}
    # What was not found is smaller than what would have been.
    assert all(move.shift < move.found < 0.1 for move in moves)


@pytest.mark.parametrize("index", [1, 3])
def test_a_nudged_camera_is_named_with_its_shift(simulated, room, index):
    made, rig = room
    step = np.array([0.004, -0.006, 0.003, 0.010, -0.012, 0.015])
    poses = simulated.moved_poses(made, rig.reference, index, step)
    moves = find_moved(rig, made.rectangles, views_again(simulated, made, 2, poses=poses))
    assert [move.state == "moved" for move in moves] == [i == index for i in range(4)]
    move = moves[index]
    assert abs(move.shift - np.linalg.norm(step[3:])) < 4 * move.shift_sigma
    assert abs(move.rotation - np.linalg.norm(step[:3])) < 4 * move.rotation_sigma
    assert move.instead == ()


def test_a_large_move_is_measured_too(simulated, room):
    made, rig = room
    step = np.array([0.1, 0.05, -0.1, 0.2, -0.1, 0.1])
    moves = find_moved(
        rig,
        made.rectangles,
        views_again(simulated, made, 3, poses=simulated.moved_poses(made, rig.reference, 2, step)),
    )
    assert [move.state for move in moves] == ["unmoved", "unmoved", "moved", "unmoved"]
    # To first order only: a tenth of a radian bends a step by a tenth of itself.
    assert moves[2].shift == pytest.approx(np.linalg.norm(step[3:]), rel=0.1)


def test_the_reference_camera_may_be_the_one(simulated, room):
    made, rig = room
    step = np.array([0.01, 0.01, 0, 0.03, 0, 0.02])
    poses = simulated.moved_poses(made, "cam1", made.index(rig.reference), step)
    moves = find_moved(rig, made.rectangles, views_again(simulated, made, 4, poses=poses))
    assert [move.name for move in moves if move.state == "moved"] == [rig.reference]


def test_of_two_cameras_nobody_can_say_which(simulated):
    made = simulated.simulate(6, simulated.Scene(cameras=2, framesets=14, tags=0))
    rig = calibrate(made.inputs, made.rectangles, made.views)
    poses = simulated.moved_poses(made, "cam0", 1, np.array([0.01, 0, 0, 0.05, 0, 0.02]))
    moves = find_moved(rig, made.rectangles, views_again(simulated, made, 7, poses=poses))
    moved = [move for move in moves if move.state == "moved"]
    assert len(moved) == 1
    assert {moved[0].name, *moved[0].instead} == {"cam0", "cam1"}
    other = next(move for move in moves if move is not moved[0])
    assert other.state == "cannot tell"
    assert moved[0].name in other.why


def test_what_is_not_seen_cannot_be_told(simulated, room):
    made, rig = room
    views = [view for view in views_again(simulated, made, 8) if view.camera != "cam2"]
    moves = find_moved(rig, made.rectangles, views)
    assert moves[2].state == "cannot tell"
    assert "cam2" in moves[2].why
    assert {moves[i].state for i in (0, 1, 3)} == {"unmoved"}
    nothing = find_moved(rig, made.rectangles, [])
    assert {move.state for move in nothing} == {"cannot tell"}
    alone = [view for view in views_again(simulated, made, 8) if view.camera == "cam0"]
    assert {move.state for move in find_moved(rig, made.rectangles, alone)} == {"cannot tell"}


def test_a_chance_is_between_none_and_all(room):
    with pytest.raises(QuadrigError, match="between 0 and 1"):
        find_moved(room[1], room[0].rectangles, [], false_alarms=0)


def test_few_corners_ask_for_more(simulated):
    """Where few corners tell the noise, a camera must stray further to be called moved, and the answer says so."""
    made = simulated.simulate(5, simulated.Scene(cameras=3, framesets=20, tags=0, board=False))
    rig = calibrate(made.inputs, made.rectangles, made.views)
    scene = simulated.Scene(cameras=3, framesets=20, noise=made.noise, board=False)
    views = simulated.views_again(made, scene, 1)
    sigmas = []
    for last in (3, 20):
        moves = find_moved(rig, made.rectangles, [view for view in views if view.frameset < last])
        sigmas.append([move.found / np.sqrt(np.linalg.eigvalsh(move.covariance[3:, 3:])[-1]) for move in moves])
    assert np.all(np.array(sigmas[0]) > np.array(sigmas[1]))
    # Where the noise is known, three cameras that share the chance are told at 5.56 sigmas each.
    assert np.all((np.array(sigmas[1]) > 5.56) & (np.array(sigmas[1]) < 6))


def trial(simulated, seed):
    """Chances of all cameras in a rig that did not move, and whether a shift of six sigmas was found."""
    made = simulated.simulate(100 + seed, simulated.Scene(cameras=3, framesets=10, tags=0))
    rig = calibrate(made.inputs, made.rectangles, made.views)
    still = find_moved(rig, made.rectangles, views_again(simulated, made, seed))
    rng = np.random.default_rng(seed)
    index = int(rng.integers(1, 3))
    direction = rng.normal(size=6)
    direction /= np.linalg.norm(direction)
    values, axes = np.linalg.eigh(still[index].covariance)
    step = axes @ (np.sqrt(np.maximum(values, 0)) * direction) * 6
    nudged = views_again(simulated, made, seed, poses=simulated.moved_poses(made, rig.reference, index, step))
    found = find_moved(rig, made.rectangles, nudged)
    return [move.chance for move in still], any(move.state == "moved" for move in found)


def test_alarms_and_power_over_many_rigs(simulated):
    chances, found = zip(*(trial(simulated, seed) for seed in range(10)), strict=True)
    # So many alarms, or so few finds, would come once in a thousand runs of a test that keeps its promise.
    alarms = sum(min(own) < 0.01 / 3 for own in chances)
    assert alarms <= binom.isf(1e-3, len(chances), 0.01)
    assert sum(found) >= binom.ppf(1e-3, len(found), 0.95)


def test_lenses_without_doubt_are_taken_as_they_are(simulated, room):
    made, rig = room
    inputs = [
        replace(camera, intrinsics=rig.camera(camera.name).intrinsics.with_parameters(lens), fixed=True)
        for camera, lens in zip(made.inputs, made.lenses, strict=True)
    ]
    fixed = calibrate(inputs, made.rectangles, made.views)
    assert all(camera.free_lens == () for camera in fixed.cameras)
    assert {m.state for m in find_moved(fixed, made.rectangles, views_again(simulated, made, 9))} == {"unmoved"}
    poses = simulated.moved_poses(made, fixed.reference, 2, np.array([0.004, -0.006, 0.003, 0.010, -0.012, 0.015]))
    moves = find_moved(fixed, made.rectangles, views_again(simulated, made, 9, poses=poses))
    assert [move.name for move in moves if move.state == "moved"] == ["cam2"]


def test_a_rig_without_doubt_is_measured_and_not_judged(simulated, room):
    """As one from another program's file: what the new Views say stands beside their own sigma."""
    made, rig = room
    unknown = replace(
        rig, covariance=np.full_like(rig.covariance, np.nan),
        cameras=tuple(replace(camera, free_lens=()) for camera in rig.cameras), fits=(),
    )  # fmt: skip
    step = np.array([0.004, -0.006, 0.003, 0.010, -0.012, 0.015])
    poses = simulated.moved_poses(made, rig.reference, 2, step)
    moves = find_moved(unknown, made.rectangles, views_again(simulated, made, 9, poses=poses))
    assert {move.state for move in moves} == {"cannot tell"}
    assert all("does not say how sure" in move.why for move in moves)
    assert all(np.isnan(move.chance) for move in moves)
    assert abs(moves[2].shift - np.linalg.norm(step[3:])) < 4 * moves[2].shift_sigma
    assert moves[2].shift_sigma < np.linalg.norm(step[3:])


def floor_rig(folder, turn_sigma, place_sigma, focal_sigma):
    """The authors' rig of GoPros with sigmas that a good calibration has, and Views of the square on the floor."""
    import bz2
    import json

    from quadrig.rig.result import Camera, Rig
    from quadrig.single.lens import Intrinsics
    from quadrig.single.pose import Pose
    from quadrig.single.rectangle import rectangle_corners
    from quadrig.single.view import View

    given = json.loads((folder / "output.json").read_text())
    matrix, rotation = np.array(given["K"]), np.array(given["R"])
    # Distances between the cameras, told by the square of 150 mm, are 0.001 m a unit of theirs, to a per cent.
    translation = 1e-3 * np.array(given["t"]).reshape(-1, 3)
    with bz2.open(folder / "floor.txt.bz2", "rt") as stream:
        rows = [line.split() for line in stream][1:]
    rows = [row for row in rows if len(row) == 4]
    top_left_first = rectangle_corners(0.15, 0.15)[[2, 3, 0, 1]]
    cameras, views = [], []
    for index in sorted({int(row[0]) for row in rows}):
        lens = Intrinsics(5312, 2988, matrix[index, 0, 0], matrix[index, :2, 2])
        pose = Pose(rotation[index], translation[index]).inverse()
        cameras.append(Camera(f"camera_{index:02d}", lens, pose, ("focal",)))
        pixels = np.array([[float(value) for value in row[2:]] for row in rows if int(row[0]) == index])
        views.append(View("square", top_left_first, pixels, f"camera_{index:02d}"))
    sigmas = np.zeros((len(cameras), 15))
    sigmas[:, 0], sigmas[1:, 9:12], sigmas[1:, 12:] = focal_sigma, turn_sigma, place_sigma
    rig_from_world = cameras[0].rig_from_camera.inverse()
    cameras = [replace(c, rig_from_camera=rig_from_world @ c.rig_from_camera) for c in cameras]
    return Rig("camera_00", tuple(cameras), (), np.diag(sigmas.ravel() ** 2)), views


@pytest.mark.parametrize(("turn_sigma", "place_sigma"), [(0.02, 0.001), (0.05, 0.005), (0.1, 0.010)])
def test_the_nudged_cameras_of_the_floor(shared_data, turn_sigma, place_sigma):
    """Its first camera misses the floor by twice as many pixels as any other; whatever sigma the rig is given."""
    from quadrig.single.rectangle import Rectangle

    rig, views = floor_rig(shared_data / "floor", np.radians(turn_sigma), place_sigma, 5.0)
    moves = {move.name: move for move in find_moved(rig, [Rectangle("square", 0.15, 0.15)], views)}
    moved = {name for name, move in moves.items() if move.state == "moved"}
    assert "camera_00" in moved
    # The second turned by 0.8 degrees: two sigmas of what four corners tell in a lens that may leave something over.
    assert moves["camera_01"].state != "unmoved"
    assert min(moves, key=lambda name: moves[name].chance if name in moved else 1) == "camera_00"
    assert 2 < np.degrees(moves["camera_00"].rotation) < 3.5
    assert moves["camera_13"].state != "moved"


def test_a_camera_that_was_focused_anew_may_not_have_moved(simulated, room):
    """Pictures that are 2 % larger, from where the camera stood before: it is not said that it moved for sure."""
    made, rig = room
    centre = made.lenses[2, 1:3]
    views = [
        replace(view, pixels=centre + 1.02 * (view.pixels - centre)) if view.camera == "cam2" else view
        for view in views_again(simulated, made, 4)
    ]
    moves = find_moved(rig, made.rectangles, views)
    assert [move.name for move in moves if move.state == "moved"] == ["cam2"]
    assert moves[2].refocused


def test_a_camera_that_was_pushed_aside_was_not_focused_instead(simulated, room):
    made, rig = room
    poses = simulated.moved_poses(made, rig.reference, 2, np.array([0, 0, 0, 0.05, 0.05, 0.0]))
    moves = find_moved(rig, made.rectangles, views_again(simulated, made, 5, poses=poses))
    assert moves[2].state == "moved"
    assert not moves[2].refocused
