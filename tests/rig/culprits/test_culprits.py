"""One fault planted in a good rig: the others' rig stays right, and a sentence names the culprit."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.rig.culprits.cameras import contradicting_camera
from quadrig.rig.problem.build import build_problem
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics

WIDTH, HEIGHT = 1280, 720


@pytest.fixture(scope="module")
def made(simulated):
    return simulated.simulate(5, simulated.Scene(cameras=4, framesets=8, tags=2))


def solved(made, inputs=None, views=None):
    return calibrate(inputs or made.inputs, made.rectangles, made.views if views is None else views)


def of_camera(made, name, change):
    return [change(view) if view.camera == name else view for view in made.views]


def assert_right(made, rig, names):
    """The cameras of these names are placed, poses in their 99.9 % regions and no wider than these Views allow."""
    assert {camera.name for camera in rig.cameras} == set(names)
    first, *others = names
    for name in others:
        step = (rig.camera(first).rig_from_camera.inverse() @ rig.camera(name).rig_from_camera).step_to(
            made.rig_from_camera(first, name)
        )
        assert step @ np.linalg.solve(rig.relative_covariance(first, name), step) < 22.5
        assert np.linalg.norm(step[3:]) < 0.03


def with_lens(made, name, factor, **more):
    index = made.index(name)
    lens = Intrinsics.centred(WIDTH, HEIGHT, 1.0).with_parameters(made.lenses[index] * [factor, *np.ones(8)])
    return [replace(one, intrinsics=lens, **more) if one.name == name else one for one in made.inputs]


EVERY = ("cam0", "cam1", "cam2", "cam3")
WITHOUT = ("cam0", "cam1", "cam3")


def test_a_good_rig_accuses_nobody(made):
    rig = solved(made)
    assert not rig.missing
    assert not any("check" in sentence for sentence in rig.weak)


@pytest.mark.parametrize("fixed", [False, True])
def test_a_lens_that_is_off_is_named_and_estimated(made, fixed):
    rig = solved(made, with_lens(made, "cam2", 1.15, fixed=fixed))
    assert_right(made, rig, EVERY)
    [sentence] = [one for one in rig.weak if "lens that was given" in one]
    assert sentence.startswith("cam2")
    assert ("fixed" in sentence) == fixed


@pytest.mark.parametrize("fixed", [False, True])
def test_a_lens_that_is_right_is_kept_and_not_accused(made, fixed):
    rig = solved(made, with_lens(made, "cam2", 1.0, fixed=fixed))
    assert not any("lens that was given" in one for one in rig.weak)
    assert (rig.focal_sigma("cam2") == 0) == fixed


def test_a_lens_for_pictures_of_another_size_is_scaled_to_these(made):
    views = of_camera(made, "cam2", lambda view: replace(view, pixels=(view.pixels + 0.5) / 2 - 0.5))
    inputs = [
        replace(one, width=WIDTH // 2, height=HEIGHT // 2) if one.name == "cam2" else one
        for one in with_lens(made, "cam2", 1.0)
    ]
    rig = solved(made, inputs, views)
    assert rig.camera("cam2").intrinsics.focal == pytest.approx(made.lenses[2, 0] / 2, rel=0.01)
    assert any(one.startswith("cam2") and "another size" in one for one in rig.weak)


@pytest.mark.parametrize("read_so", [False, True])
def test_mirrored_pictures_are_named(made, read_so):
    def mirrored(view):
        side = [-1, 1, 1] if read_so else [1, 1, 1]
        return replace(view, pixels=view.pixels * [-1, 1] + [WIDTH - 1, 0], points=view.points * side)

    rig = solved(made, views=of_camera(made, "cam2", mirrored))
    assert_right(made, rig, WITHOUT)
    assert rig.missing["cam2"].startswith("cam2: its pictures are mirrored")


def test_a_camera_of_another_room_is_named(simulated, made):
    other = simulated.simulate(89, simulated.Scene(cameras=4, framesets=8, tags=2))
    views = [v for v in made.views if v.camera != "cam2"] + [v for v in other.views if v.camera == "cam2"]
    rig = solved(made, views=views)
    assert_right(made, rig, WITHOUT)
    assert "contradicts the other cameras" in rig.missing["cam2"]
    # Its lens is known all the same.
    [alone] = [one for one in rig.apart if one.cameras[0].name == "cam2"]
    assert alone.cameras[0].intrinsics.focal == pytest.approx(other.lenses[2, 0], rel=0.05)


def test_corners_at_random_are_named(made):
    rng = np.random.default_rng(3)

    def scattered(view):
        return replace(view, pixels=rng.uniform([0, 0], [WIDTH - 1, HEIGHT - 1], view.pixels.shape))

    rig = solved(made, views=of_camera(made, "cam2", scattered))
    assert_right(made, rig, WITHOUT)
    assert "no pictures of any flat rectangle" in rig.missing["cam2"]


@pytest.mark.parametrize("size", [1e4, 1e6, 1e200])
def test_a_view_of_absurd_numbers_is_named_and_not_used(made, size):
    index = next(i for i, view in enumerate(made.views) if view.camera == "cam2" and view.rectangle == "sheet")
    views = list(made.views)
    views[index] = replace(views[index], pixels=size * (1 + views[index].pixels / WIDTH))
    rig = solved(made, views=views)
    assert_right(made, rig, EVERY)
    frameset = f"frameset {views[index].frameset}"
    [sentence] = [one for one in rig.weak if "outside of its picture" in one or "in no picture" in one]
    assert all(word in sentence for word in ("cam2", "'sheet'", frameset))


def test_a_picture_size_that_is_too_small_is_named(made):
    inputs = [replace(one, width=640, height=360) if one.name == "cam2" else one for one in made.inputs]
    rig = solved(made, inputs)
    assert_right(made, rig, WITHOUT)
    assert "another size; check its width and height" in rig.missing["cam2"]


def test_a_picture_size_that_is_too_large_is_named(made):
    views = of_camera(made, "cam2", lambda view: replace(view, pixels=view.pixels / 2))
    rig = solved(made, views=views)
    assert any(one.startswith("cam2") and "upper left quarter" in one for one in rig.weak)


def test_where_no_camera_has_a_usable_view_the_sentence_is_the_error(made):
    inputs = [replace(one, width=320, height=180) for one in made.inputs]
    with pytest.raises(QuadrigError, match="check its width and height"):
        solved(made, inputs)


def test_a_camera_that_saw_nothing_of_what_the_others_did_contradicts_nobody(bodies, table_lens):
    """Carried through a room and not placed, as where nothing turned: that nothing ties it accuses nobody."""
    made = bodies.carried(np.random.default_rng(2), table_lens, 30).made
    names = sorted({view.rectangle for view in made.views})
    own = {camera.name: set(names[k::4]) for k, camera in enumerate(made.inputs)}
    views = [view for view in made.views if view.rectangle in own[view.camera]]
    alone = calibrate(made.inputs[:1], made.rectangles, [view for view in views if view.camera == "cam0"])

    def solve(problem):
        raise AssertionError(f"nobody is suspected, not of {len(problem.views)} Views")

    assert contradicting_camera(build_problem(made.inputs, made.rectangles, views), alone, solve) is None
