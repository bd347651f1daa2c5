"""Several recordings of the same cameras make one rig; boards shown one after another give lenses."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.io.search.several_recordings import RecordedViews, joined
from quadrig.rig.calibration import calibrate
from quadrig.single.rectangle import WORLD


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


def test_a_surveyed_rectangle_stands_where_it_was_surveyed(two):
    made, _, scene = two
    rectangles = [
        replace(r, body=WORLD, body_from_rect=made.world_from_rect[r.name]) if r.name == "tag0" else r
        for r in made.rectangles
    ]
    again, _ = joined([scene, replace(scene, name="later")], made.inputs, rectangles)
    assert [r.name for r in again if r.name not in {r.name for r in rectangles}] == ["tag1 (later)"]
