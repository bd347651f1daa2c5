"""Clocks that differ: found from what moves, and no worse for the rig than clocks that agree."""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.adjustment.motion import motion
from quadrig.rig.calibration import calibrate
from quadrig.rig.problem.build import build_problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.start.clock_offsets import path_clocks, regroup
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.boards import board_points
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

RATE, SECONDS, NOISE = 30.0, 3.0, 0.2
BOARD = Rectangle("board", 0.56, 0.40, moving=True)
POINTS = board_points(7, 5, 0.08)
NAMES = ("a", "b", "c")
OFFSETS = np.array([0.0, 0.040, -0.027])
# Each camera's shutter has a phase of its own besides, as free-running cameras have.
PHASES = np.array([0.0, 0.011, 0.021])


def looking_at_middle(angle: float) -> Pose:
    """A camera two metres from the origin that looks there."""
    position = np.array([2 * np.sin(angle), 0.3, -2 * np.cos(angle)])
    z = -position / np.linalg.norm(position)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return Pose(np.stack([x, np.cross(z, x), z], axis=1), position)


WORLD_FROM_CAMERA = [looking_at_middle(angle) for angle in (-0.6, 0.0, 0.6)]
LENSES = [Intrinsics.centred(1280, 720, focal) for focal in (900.0, 1000.0, 1100.0)]


def board_at(time: float) -> Pose:
    """Carried at half a metre a second or so, tilting."""
    place = [0.30 * np.sin(1.7 * time), 0.15 * np.sin(2.3 * time + 1), 0.25 * np.sin(1.1 * time + 2)]
    turn = [0.5 * np.sin(1.3 * time), 0.5 * np.sin(1.9 * time + 1), 0.4 * np.sin(0.9 * time)]
    return Pose.from_vectors(np.array(turn), np.array(place))


def read_out(lens: Intrinsics, world_from_camera: Pose, time: float, line: float) -> np.ndarray:
    """Pixels (P, 2) of the board where each is when its own row is read, the middle one at that time."""

    def seen(times: np.ndarray) -> np.ndarray:
        boards = {t: board_at(t) for t in times}
        places = np.array([boards[t].transform(point) for t, point in zip(times, POINTS, strict=True)])
        return lens.project(world_from_camera.inverse().transform(places))

    pixels = seen(np.full(len(POINTS), time))
    # Each round brings rows and instants nearer by the pixels that go by in the time of a row: a hundredth.
    for _ in range(3 if line else 0):
        pixels = seen(time + line * (pixels[:, 1] - 359.5))
    return pixels


def taken(
    offsets: np.ndarray, seed: int = 0, lines: Sequence[float] = (0.0, 0.0, 0.0), phases: np.ndarray = PHASES
) -> tuple[np.ndarray, list[View]]:
    """Stamps (S, C) and Views; image k of each camera is in frameset k. lines (C,): of the shutters, s a row."""
    rng = np.random.default_rng(seed)
    count = round(RATE * SECONDS)
    true = np.arange(count)[:, None] / RATE + phases
    views = []
    for c, (name, world_from_camera, lens) in enumerate(zip(NAMES, WORLD_FROM_CAMERA, LENSES, strict=True)):
        for k in range(count):
            pixels = read_out(lens, world_from_camera, true[k, c], lines[c])
            pixels = pixels + rng.normal(0, NOISE, pixels.shape)
            views.append(View("board", POINTS, pixels, name, k, sigma=NOISE, time=float(true[k, c] - offsets[c])))
    return true - offsets, views


def position_error(rig) -> float:
    """Mean distance (m) of cameras b and c from where they are in the frame of a."""
    truth = [WORLD_FROM_CAMERA[0].inverse() @ pose for pose in WORLD_FROM_CAMERA]
    apart = [
        rig.camera(name).rig_from_camera.translation - pose.translation
        for name, pose in zip(NAMES, truth, strict=True)
    ]
    return float(np.linalg.norm(apart[1:], axis=1).mean())


INPUTS = [CameraInput(name, 1280, 720, lens="f") for name in NAMES]


def together(seed: int) -> list[View]:
    """The same Views, had all cameras taken them at one instant."""
    rng = np.random.default_rng(seed)
    views = []
    for name, pose, lens in zip(NAMES, WORLD_FROM_CAMERA, LENSES, strict=True):
        for k in range(round(RATE * SECONDS)):
            pixels = lens.project(pose.inverse().transform(board_at(k / RATE).transform(POINTS)))
            views.append(View("board", POINTS, pixels + rng.normal(0, NOISE, pixels.shape), name, k, sigma=NOISE))
    return views


def clocks_of(offsets: np.ndarray) -> np.ndarray:
    """Clocks of cameras that take their pictures all at once."""
    return np.stack([offsets, np.zeros_like(offsets)], axis=1)


def test_offsets_are_found_and_cost_little():
    _, views = taken(OFFSETS)
    rig = calibrate(INPUTS, [BOARD], views, "a")
    found = np.array([rig.camera(name).clock_offset for name in NAMES])
    assert found - found[0] == pytest.approx(OFFSETS, abs=0.5e-3)
    (said,) = [w for w in rig.weak if "against a, pictures of the same stamp" in w]
    late = re.findall(r"([\d.]+) \u00b1 ([\d.]+) ms (later|earlier) by", said)
    for (value, sigma, way), offset in zip(late, OFFSETS[1:], strict=True):
        off = float(value) * (1 if way == "later" else -1) - 1e3 * offset
        assert abs(off) < max(4 * float(sigma), 0.05)
    assert rig.noise == pytest.approx(NOISE, rel=0.05)
    plain = calibrate(INPUTS, [BOARD], [replace(view, time=float("nan")) for view in views], "a")
    ideal = calibrate(INPUTS, [BOARD], together(1), "a")
    assert position_error(rig) < 0.2 * position_error(plain)
    assert position_error(rig) < 3 * position_error(ideal)


def lines_of(rig) -> np.ndarray:
    """Line times and their sigmas (C, 2), us a row."""
    return 1e6 * np.array([(rig.camera(name).line_time, rig.camera(name).line_time_sigma) for name in NAMES])


def test_shutters_that_roll_cost_little_out_of_step():
    offsets = np.array([0.0, 0.020, -0.020])
    rig = calibrate(INPUTS, [BOARD], taken(offsets, lines=(20e-6,) * 3)[1], "a")
    late = np.array([rig.camera(name).clock_offset for name in NAMES])
    assert late - late[0] == pytest.approx(offsets, abs=0.1e-3)
    lines, sigmas = lines_of(rig).T
    assert np.abs((lines - 20) / sigmas).max() < 3
    # 3 s of a board: a minute is to know them to 3 %.
    assert lines.mean() == pytest.approx(20, rel=0.03)
    assert sigmas.max() < 1
    assert rig.noise == pytest.approx(NOISE, rel=0.05)
    assert position_error(rig) < 1.3 * position_error(calibrate(INPUTS, [BOARD], together(100), "a"))


def test_shutters_that_roll_are_seen_in_step():
    """They bend every View alike: the fit has hardly more noise without them, and cameras 24 mm off."""
    views = taken(np.zeros(3), lines=(20e-6, 0.0, 40e-6), phases=np.zeros(3))[1]
    rig = calibrate(INPUTS, [BOARD], views, "a")
    lines, sigmas = lines_of(rig).T
    assert np.abs((lines - [20, 0, 40]) / sigmas).max() < 3
    ideal = position_error(calibrate(INPUTS, [BOARD], together(100), "a"))
    assert position_error(rig) < 1.3 * ideal
    given = [replace(one, line_time=line) for one, line in zip(INPUTS, (20e-6, 0.0, 40e-6), strict=True)]
    exact = calibrate(given, [BOARD], views, "a")
    np.testing.assert_allclose(lines_of(exact), [[20, 0], [0, 0], [40, 0]], rtol=1e-12)
    assert position_error(exact) < 1.3 * ideal


def test_offsets_cost_less_than_a_fifth_of_the_accuracy():
    """With the same noise in every corner as cameras in step have."""
    errors = []
    for seed in range(6):
        rigs = [calibrate(INPUTS, [BOARD], views, "a") for views in (taken(OFFSETS, seed)[1], together(seed))]
        errors.append([position_error(rig) for rig in rigs])
    late, ideal = np.sqrt(np.mean(np.square(errors), axis=0))
    assert late < 1.2 * ideal


@pytest.mark.parametrize("scale", [0.25, 4.0])
def test_small_and_large_offsets_are_found_too(scale):
    """A quarter of a frame, and five frames, which only the paths bring together."""
    rig = calibrate(INPUTS, [BOARD], taken(scale * OFFSETS)[1], "a")
    found = np.array([rig.camera(name).clock_offset for name in NAMES])
    assert found - found[0] == pytest.approx(scale * OFFSETS, abs=0.5e-3)
    assert rig.noise == pytest.approx(NOISE, rel=0.05)


def test_clocks_that_agree_are_left_alone():
    rig = calibrate(INPUTS, [BOARD], [replace(view, time=view.frameset / RATE) for view in together(2)], "a")
    assert [camera.clock_offset for camera in rig.cameras] == [0, 0, 0]
    assert np.isnan(lines_of(rig)).all()


def test_what_stands_still_tells_no_clock():
    """Two boards that hang still, seen for three seconds by cameras whose clocks differ."""
    rng = np.random.default_rng(3)
    hung = {"board": board_at(0.0), "other": board_at(1.5)}
    views = [
        replace(view, rectangle=name, pixels=pixels + rng.normal(0, NOISE, pixels.shape))
        for view in taken(OFFSETS)[1]
        for name, pose in hung.items()
        for camera in [NAMES.index(view.camera)]
        for pixels in [LENSES[camera].project((WORLD_FROM_CAMERA[camera].inverse() @ pose).transform(POINTS))]
    ]
    still = [Rectangle(name, 0.56, 0.40) for name in hung]
    rig = calibrate(INPUTS, still, views, "a")
    assert position_error(rig) < 4 * max(rig.position_sigma(name) for name in "bc")
    assert [camera.clock_offset for camera in rig.cameras] == [0, 0, 0]
    assert np.isnan(lines_of(rig)).all()


def test_motion_is_that_of_the_rectangle():
    """On true poses: where a View's rectangle stood when it was taken, to the third order of its motion."""
    _, views = taken(np.zeros(3))
    problem = build_problem(INPUTS, [BOARD], views)
    when = {view.frameset: view.frameset / RATE + PHASES.mean() for view in views}
    poses = [board_at(when[node.frameset]) for node in problem.nodes]
    batch = Pose(np.stack([p.rotation for p in poses]), np.stack([p.translation for p in poses]))
    moved = motion(problem, batch, np.zeros((3, 2)))
    assert moved is not None
    seen = batch[problem.node].retract(moved.step(np.zeros((len(views), 2))))
    true = [board_at(view.time) for view in problem.views]
    inner = np.array([0 < view.frameset < RATE * SECONDS - 1 for view in problem.views])
    gap = seen.translation - np.stack([p.translation for p in true])
    assert np.abs(gap[inner]).max() < 5e-5


def test_motion_is_not_guessed_over_gaps():
    _, views = taken(np.zeros(3))
    sparse = [view for view in views if view.frameset % 15 == 0]
    problem = build_problem(INPUTS, [BOARD], sparse)
    count = len(problem.nodes)
    assert motion(problem, Pose(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))), np.zeros((3, 2))) is None


def test_only_differences_of_clocks_count():
    """What all clocks have in common moves no View, loses none, and is held by one of the cameras."""
    problem = build_problem(INPUTS, [BOARD], taken(OFFSETS)[1])
    grouped = [regroup(problem, clocks_of(OFFSETS + common), NOISE) for common in (0.0, 0.3)]
    framesets = [{(v.camera, v.time): v.frameset for v in each.views} for each in grouped if each is not None]
    assert framesets[0] == framesets[1]
    assert len(framesets[0]) > 0.98 * len(problem.views)
    count = len(problem.nodes)
    moved = motion(problem, Pose(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))), np.zeros((3, 2)))
    assert moved is not None
    assert np.count_nonzero(moved.observable) == 3
    assert moved.free.sum(axis=0).tolist() == [2, 3]


def walked(offsets, rng, noise=0.003, path=lambda t: board_at(t).translation, seconds=2 * SECONDS):
    """A problem of stamped Views of the board, and where each camera has it, m: its middle, with noise."""
    count = round(RATE * seconds)
    views, positions = [], []
    for name, phase, offset in zip(NAMES, PHASES, offsets, strict=True):
        views += [View("board", POINTS, POINTS[:, :2], name, k, time=k / RATE + phase - offset) for k in range(count)]
    problem = build_problem(INPUTS, [BOARD], views)
    for view in problem.views:
        camera = NAMES.index(view.camera)
        seen = WORLD_FROM_CAMERA[camera].inverse().transform(path(view.time + offsets[camera]))
        positions.append(seen + noise * rng.normal(size=3))
    return problem, np.array(positions)


@pytest.mark.parametrize("scale", [1.0, 4.0])
def test_paths_tell_clocks_apart(scale):
    problem, positions = walked(scale * OFFSETS, np.random.default_rng(5))
    found = path_clocks(problem, positions)[:, 0]
    assert found == pytest.approx(scale * (OFFSETS - OFFSETS.mean()), abs=2e-3)
    # Lenses known roughly stretch a path and shear it.
    bent = positions * [1.02, 0.97, 1.2] + 0.05 * positions[:, ::-1]
    assert path_clocks(problem, bent)[:, 0] == pytest.approx(found, abs=1e-3)
    # Cameras that missed the sheet now and then, each at other times.
    missed = np.random.default_rng(7).random(len(positions)) < [
        0.1 * (2 + NAMES.index(v.camera)) for v in problem.views
    ]
    fewer = build_problem(INPUTS, [BOARD], [v for v, out in zip(problem.views, missed, strict=True) if not out])
    assert path_clocks(fewer, positions[~missed])[:, 0] == pytest.approx(found, abs=3e-3)
    # Poses of single Views have wild ones among them.
    wild = positions.copy()
    wild[::60] += np.random.default_rng(6).normal(size=wild[::60].shape)
    assert path_clocks(problem, wild)[:, 0] == pytest.approx(found, abs=2e-3)


def test_paths_that_show_no_offset_give_none():
    """Clocks that agree but for noise; a straight walk, which fits itself at any offset; a short one."""
    agreeing = walked(np.array([0.0, 0.0004, -0.0003]), np.random.default_rng(5), noise=0.01)
    assert path_clocks(*agreeing)[:, 0].tolist() == [0, 0, 0]
    straight = walked(OFFSETS, np.random.default_rng(5), path=lambda t: np.array([0.3, -0.1, 0.2]) * t)
    assert path_clocks(*straight)[:, 0].tolist() == [0, 0, 0]
    short = walked(OFFSETS, np.random.default_rng(5), seconds=0.5)
    assert path_clocks(*short)[:, 0].tolist() == [0, 0, 0]


def test_views_go_to_the_frameset_nearest_to_when_they_were_taken():
    problem, _ = walked(4 * OFFSETS, np.random.default_rng(5))
    moving = [replace(v, pixels=v.pixels + 300 * v.time) for v in problem.views]
    problem = build_problem(INPUTS, [BOARD], moving)
    grouped = regroup(problem, clocks_of(4 * OFFSETS), NOISE)
    assert grouped is not None
    np.testing.assert_array_equal(grouped.clocks, clocks_of(4 * OFFSETS))
    true = {v: v.time + 4 * OFFSETS[NAMES.index(v.camera)] for v in grouped.views}
    framesets = {}
    for view, time in true.items():
        framesets.setdefault(view.frameset, {})[view.camera] = time
    # Each camera has one View a frameset, none half a frame from its instant; lost are those that no other has.
    assert len(true) == sum(len(times) for times in framesets.values()) > 0.9 * len(problem.views)
    assert max(np.ptp(list(times.values())) for times in framesets.values()) < 1.01 / RATE
    order = [np.mean(list(times.values())) for _, times in sorted(framesets.items())]
    assert (np.diff(order) > 0).all()


def test_views_stay_where_they_are_when_nothing_moves_by_as_much_as_the_noise():
    problem, _ = walked(OFFSETS, np.random.default_rng(5))
    slow = build_problem(INPUTS, [BOARD], [replace(v, pixels=v.pixels + 5 * v.time) for v in problem.views])
    # 5 px a second in 40 ms are 0.2 px.
    assert regroup(slow, clocks_of(OFFSETS), 0.3) is None
    assert regroup(slow, clocks_of(OFFSETS), 0.03) is not None
