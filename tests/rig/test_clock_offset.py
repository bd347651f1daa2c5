"""Clocks that differ: found from what moves, and no worse for the rig than clocks that agree."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibrate import calibrate
from quadrig.rig.clock_offset import calibrate_with_clocks, estimate_clocks, instants, retime
from quadrig.rig.inputs import CameraInput
from quadrig.rig.timed_path import TimedPath, paths_of, views_at
from quadrig.single.lens import Intrinsics
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle, board_points
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


def taken(offsets: np.ndarray, seed: int = 0) -> tuple[np.ndarray, list[View]]:
    """Stamps (S, C) and Views; image k of each camera is in frameset k."""
    rng = np.random.default_rng(seed)
    count = round(RATE * SECONDS)
    true = np.arange(count)[:, None] / RATE + PHASES
    views = []
    for c, (name, world_from_camera, lens) in enumerate(zip(NAMES, WORLD_FROM_CAMERA, LENSES, strict=True)):
        for k in range(count):
            pixels = lens.project(world_from_camera.inverse().transform(board_at(true[k, c]).transform(POINTS)))
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


def test_offsets_are_found_and_cost_next_to_nothing():
    stamps, views = taken(OFFSETS)
    plain = calibrate(INPUTS, [BOARD], [replace(view, time=float("nan")) for view in views], "a")
    clocks, _ = retime(plain, [BOARD], views, stamps, NAMES)
    rig = calibrate_with_clocks(INPUTS, [BOARD], views, "a")
    found = np.array([rig.camera(name).clock_offset for name in NAMES])
    assert found == pytest.approx(clocks.offsets - clocks.offsets.mean(), abs=1e-6)
    assert np.all(np.abs(clocks.offsets - OFFSETS) < np.maximum(4 * clocks.sigmas, 1e-5))
    assert np.all(clocks.sigmas < 0.5e-3)
    # The same images, had all been taken at one instant.
    rng = np.random.default_rng(1)
    when = instants(stamps, OFFSETS)
    together = [
        View("board", POINTS, lens.project(pose.inverse().transform(board_at(time).transform(POINTS)))
             + rng.normal(0, NOISE, (len(POINTS), 2)), name, k, sigma=NOISE)
        for name, pose, lens in zip(NAMES, WORLD_FROM_CAMERA, LENSES, strict=True)
        for k, time in enumerate(when)
    ]  # fmt: skip
    ideal = calibrate(INPUTS, [BOARD], together, "a")
    assert position_error(rig) < 0.2 * position_error(plain)
    assert position_error(rig) < 3 * position_error(ideal)


def test_views_between_images_are_those_of_that_instant():
    stamps, views = taken(OFFSETS)
    paths = paths_of(views, stamps, NAMES)
    when = instants(stamps, OFFSETS)
    retimed = views_at(paths, when, dict(zip(NAMES, OFFSETS, strict=True)))
    assert len(retimed) > 0.95 * len(views)
    errors = []
    for view in retimed:
        c = NAMES.index(view.camera)
        place = board_at(when[view.frameset]).transform(view.points)
        seen = LENSES[c].project(WORLD_FROM_CAMERA[c].inverse().transform(place))
        errors.append((view.pixels - seen) / view.sigma)
    # Noise as it is stated, and nothing but noise.
    assert np.std(np.concatenate(errors)) == pytest.approx(1.0, abs=0.05)


def test_what_stands_still_tells_no_clock():
    stamps, views = taken(OFFSETS)
    first = {name: next(view.pixels for view in views if view.camera == name) for name in NAMES}
    still = [replace(view, pixels=first[view.camera]) for view in views]
    rig = calibrate(INPUTS, [BOARD], views, "a")
    clocks = estimate_clocks(rig, paths_of(still, stamps, NAMES), stamps, NAMES)
    assert np.all(clocks.offsets == 0)
    assert np.all(np.isinf(clocks.sigmas[1:]))
    static = Rectangle("board", 0.56, 0.40)
    untouched = calibrate_with_clocks(INPUTS, [static], [v for v in views if v.frameset == 0], "a")
    assert all(camera.clock_offset == 0 for camera in untouched.cameras)


def test_path_bridges_no_holes():
    times = np.array([0.0, 0.1, 0.2, 0.3, 1.0, 1.1, 1.2])
    pixels = np.stack([times**3, 5 - times], axis=-1)[:, None, :]
    path = TimedPath(times, pixels, np.zeros((1, 3)), 1.0, 0.1)
    assert path.at(0.15)[0][0] == pytest.approx([0.15**3, 4.85])
    assert path.at(1.2)[0][0] == pytest.approx([1.2**3, 3.8])
    assert np.isnan(path.at(0.6)[0]).all()
    assert np.isnan(path.at(-0.1)[0]).all()
    assert np.isnan(path.at(1.3)[0]).all()
    assert path.velocity(0.15)[0, 1] == pytest.approx(-1.0)
