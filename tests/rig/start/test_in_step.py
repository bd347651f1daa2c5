"""Cameras whose recordings were made one after another, however alike their stamps look."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.rig.problem.build import build_problem
from quadrig.rig.start.in_step import groups_in_step
from quadrig.rig.start.lenses_and_poses import first_cameras


def at_other_times(made, names, seed=0):
    """What these cameras saw of the sheet, each in an order of its own, as if their videos all began at zero."""
    views = [v for v in made.views if v.rectangle == "sheet"]
    count = 1 + max(v.frameset for v in views)
    orders = {name: np.random.default_rng([seed, k]).permutation(count) for k, name in enumerate(names)}
    return [replace(v, frameset=int(orders[v.camera][v.frameset])) if v.camera in names else v for v in views]


def groups(made, views):
    seeing = {view.camera for view in views}
    problem = build_problem([c for c in made.inputs if c.name in seeing], made.rectangles, views)
    found = groups_in_step(problem, first_cameras(problem).candidates)
    return {frozenset(problem.cameras[i].name for i in group) for group in found}


@pytest.mark.parametrize("seed", range(4))
def test_who_saw_the_sheet_at_other_times_stands_apart(simulated, seed):
    made = simulated.simulate(seed, simulated.Scene(cameras=4, framesets=40))
    assert groups(made, made.views) == {frozenset(c.name for c in made.inputs)}
    rest = frozenset({"cam0", "cam2", "cam3"})
    assert groups(made, at_other_times(made, ["cam1"], seed)) == {frozenset({"cam1"}), rest}


def test_a_sheet_that_hardly_moves_joins_whoever_sees_it(simulated):
    """Any instant fits any other then, and rightly so."""
    made = simulated.simulate(3, simulated.Scene(cameras=3, framesets=40))
    shown = {v.camera: v for v in made.views if v.rectangle == "sheet" and v.frameset == 5}
    rng = np.random.default_rng(0)
    still = [
        replace(v, frameset=frameset, pixels=v.pixels + rng.normal(0, 0.2, v.pixels.shape))
        for frameset in range(20)
        for v in shown.values()
    ]
    assert len(shown) > 1
    assert frozenset(shown) in groups(made, still)


def test_each_has_its_lens_and_the_others_their_poses(simulated):
    made = simulated.simulate(12, simulated.Scene(cameras=3, framesets=40))
    found = calibrate(made.inputs, made.rectangles, at_other_times(made, ["cam1"]))
    assert {c.name for c in found.cameras} == {"cam0", "cam2"}
    assert "poses need a rectangle that cameras see at one time" in found.missing["cam1"]
    step = found.camera("cam2").rig_from_camera.step_to(made.rig_from_camera("cam0", "cam2"))
    assert step @ np.linalg.solve(found.pose_covariance("cam2"), step) < 6 * 2.2**2
    ((rig, camera),) = found.lens_only
    assert abs(camera.intrinsics.focal - made.lenses[made.index("cam1"), 0]) < 4 * rig.focal_sigma("cam1")


def test_boards_shown_one_after_another_give_every_lens(simulated):
    made = simulated.simulate(14, simulated.Scene(cameras=3, framesets=24))
    found = calibrate(made.inputs, made.rectangles, at_other_times(made, ["cam1", "cam2"]))
    lenses = {found.cameras[0].name: found, **{camera.name: rig for rig, camera in found.lens_only}}
    assert lenses.keys() == {c.name for c in made.inputs}
    for name, rig in lenses.items():
        error = rig.camera(name).intrinsics.focal - made.lenses[made.index(name), 0]
        assert abs(error) < 4 * rig.focal_sigma(name)
        assert rig.focal_sigma(name) < 0.02 * rig.camera(name).intrinsics.focal


def test_who_saw_other_sheets_of_a_room_is_not_out_of_step(bodies, table_lens):
    """How two sheets of a room look from two cameras says nothing of when, before it is known how these stand."""
    made = bodies.carried(np.random.default_rng(2), table_lens, 40).made
    watchers = {}
    for view in made.views:
        watchers.setdefault((view.rectangle, view.frameset), set()).add(view.camera)
    alone = [view for view in made.views if len(watchers[view.rectangle, view.frameset]) == 1]
    assert groups(made, alone) == {frozenset(camera.name for camera in made.inputs)}
