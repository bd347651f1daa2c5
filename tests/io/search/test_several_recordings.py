"""Several recordings of the same cameras make one rig; boards shown one after another give lenses."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.io.search.several_recordings import RecordedViews, joined
from quadrig.rig.calibration import calibrate
from quadrig.single.lens import project
from quadrig.single.pose import Pose
from quadrig.single.rectangle import WORLD
from quadrig.single.view import View


def as_recording(name, views):
    return RecordedViews(name, views, [10**9 * f for f in range(1 + max(v.frameset for v in views))])


@pytest.fixture(scope="module")
def simulated(load_script):
    return load_script("benchmarks/simulated.py")


@pytest.fixture(scope="module")
def two(simulated):
    """A scene with tags and a sheet; and the sheet shown to one camera after another, with stamps that agree."""
    scene = simulated.Scene(cameras=3, framesets=30)
    made = simulated.simulate(21, scene)
    shown = []
    for k, camera in enumerate(made.inputs):
        views = simulated.views_again(made, replace(scene, framesets=60), 50 + k)
        shown += [v for v in views if v.camera == camera.name]
    return made, as_recording("boards", shown), as_recording("scene", made.views)


def test_lenses_and_poses_come_from_all(two):
    made, boards, scene = two
    rectangles, every = joined([boards, scene], made.inputs, made.rectangles)
    assert len(every.times) == 3 * len(boards.times) + len(scene.times)
    rig = calibrate(made.inputs, rectangles, every.views)
    alone = calibrate(made.inputs, made.rectangles, made.views)
    assert not rig.missing
    assert rig.working_accuracy < 0.85 * alone.working_accuracy
    for camera in made.inputs:
        assert rig.focal_sigma(camera.name) < alone.focal_sigma(camera.name)
        step = rig.camera(camera.name).rig_from_camera.step_to(made.rig_from_camera(rig.reference, camera.name))
        if camera.name != rig.reference:
            assert step @ np.linalg.solve(rig.pose_covariance(camera.name), step) < 6 * 2.2**2


def test_what_stands_still_does_so_in_one_recording(two):
    """A tag is another one in each recording, and keeps its name where it was seen most."""
    made, _, scene = two
    tags = [v for v in made.views if v.rectangle == "tag0"]
    fewer = as_recording("later", tags[:1] + [v for v in made.views if v.rectangle == "sheet"])
    rectangles, every = joined([scene, fewer], made.inputs, made.rectangles)
    assert [r.name for r in rectangles] == [*(r.name for r in made.rectangles), "tag0 (later)"]
    assert {v.rectangle for v in every.views if v.frameset >= len(scene.times)} == {"sheet", "tag0 (later)"}


def hung_elsewhere(made, step, rng):
    """Views of the two tags, carried as one by a step (6,) in the room, that the cameras see then; some noise."""
    turn = Pose.from_twist(np.asarray(step, float))
    views = []
    for name in ("tag0", "tag1"):
        corners = next(one for one in made.rectangles if one.name == name).corners
        for camera, (given, lens) in enumerate(zip(made.inputs, made.lenses, strict=True)):
            place = made.world_from_camera[camera].inverse() @ turn @ made.world_from_rect[name]
            pixels = project(lens, place.transform(corners)) + made.noise * rng.normal(size=(4, 2))
            if np.isfinite(pixels).all() and ((pixels > 0) & (pixels < [1280, 720])).all():
                views.append(View(name, corners, pixels, given.name, 0))
    return views


def test_a_body_stands_elsewhere_in_each_recording_and_is_the_same(two):
    """Two tags on a board that was hung up anew: one layout, surer than that of either, and two poses."""
    made, _, scene = two
    step = np.array([0.02, 0.15, -0.05, 0.1, 0.05, 0.2])
    later = as_recording("later", hung_elsewhere(made, step, np.random.default_rng(0)))
    wall = [replace(r, body="" if r.moving else "wall") for r in made.rectangles]
    rectangles, every = joined([scene, later], made.inputs, wall)
    rig, alone = (
        calibrate(made.inputs, *given, "cam0") for given in ((rectangles, every.views), (wall, scene.views))
    )
    first, second = rig.bodies
    assert (first.name, second.name) == ("wall", "wall (later, 2)")
    assert second.rectangles == ("tag0 (later)", "tag1 (later)")
    np.testing.assert_array_equal(first.body_from_rect.matrix(), second.body_from_rect.matrix())
    found, covariance = first.rect_from_other("tag0", "tag1")
    true = made.world_from_rect["tag0"].inverse() @ made.world_from_rect["tag1"]
    away = found.step_to(true)
    assert away @ np.linalg.solve(covariance, away) < 22.5  # chi-square of six beyond this: 1 in 1000
    _, before = alone.bodies[0].rect_from_other("tag0", "tag1")
    assert np.trace(covariance[3:, 3:]) < 0.8 * np.trace(before[3:, 3:])
    world_from_rig = made.world_from_camera[0]
    moved = (world_from_rig @ second.rig_from_body) @ (world_from_rig @ first.rig_from_body).inverse()
    # One View of each camera.
    assert np.abs(moved.translation - Pose.from_twist(step).translation).max() < 0.02
    assert {p.name for p in rig.rectangles} == {"sheet", "tag0", "tag1", "tag0 (later)", "tag1 (later)"}
    assert not [fit for fit in rig.fits if fit.rejected]


def test_a_surveyed_rectangle_stands_where_it_was_surveyed(two):
    made, _, scene = two
    rectangles = [
        replace(r, body=WORLD, body_from_rect=made.world_from_rect[r.name]) if r.name == "tag0" else r
        for r in made.rectangles
    ]
    again, _ = joined([scene, replace(scene, name="later")], made.inputs, rectangles)
    assert [r.name for r in again if r.name not in {r.name for r in rectangles}] == ["tag1 (later)"]
