"""A rectangle that is not fixed to its body, or not where it was given, is named, with how far it is off."""

import re
from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.single.lens import project
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle

BY, TURNED = 0.012, np.radians(3.0)


@pytest.fixture(scope="module")
def made(bodies, table_lens):
    return bodies.turntable(np.random.default_rng(3), table_lens, 40)


def moved_from(made, name, first):
    """The Views as if that tag had slid on the box from a frameset on."""
    slid = Pose.from_vectors(np.array([0, 0, TURNED]), np.array([BY, 0, 0]))
    return moved(made, name, lambda frameset: slid if frameset >= first else Pose.identity())


def moved(made, name, slid):
    """The Views as if that tag had stood slid(frameset) away from its place on the box."""
    views, rng = [], np.random.default_rng(0)
    for view in made.made.views:
        if view.rectangle == name:
            camera = made.made.index(view.camera)
            place = made.made.world_from_rect[name][view.frameset] @ slid(view.frameset)
            located = (made.rig_from_camera[camera].inverse() @ place).transform(view.points)
            pixels = project(made.made.lenses[camera], located) + 0.2 * rng.normal(size=(4, 2))
            views.append(replace(view, pixels=pixels))
        else:
            views.append(view)
    return views


def test_a_tag_that_slid_is_named_with_how_far(made):
    first = sorted({v.frameset for v in made.made.views if v.rectangle == "tag4"})[12]
    rig = calibrate(made.made.inputs, made.made.rectangles, moved_from(made, "tag4", first), "cam0")
    (said,) = [sentence for sentence in rig.weak if "moved on body" in sentence]
    assert said.startswith("'tag4' moved on body 'box': by 1")
    by, turned = (float(figure) for figure in re.findall(r"by ([\d.]+) mm and ([\d.]+) degrees", said)[0])
    assert by == pytest.approx(1e3 * BY, abs=1.0)
    assert turned == pytest.approx(np.degrees(TURNED), abs=0.5)
    assert f"the first of them {first}" in said
    step = rig.camera("cam1").rig_from_camera.step_to(made.true(0, 1))
    assert np.sqrt(step @ np.linalg.solve(rig.pose_covariance("cam1"), step) / 6) < 2.5


def test_a_tag_that_moves_by_itself_is_named_and_no_camera_lost(made):
    def anywhere(frameset):
        rng = np.random.default_rng(frameset)
        return Pose.from_vectors(np.array([0, 0, rng.uniform(-1, 1)]), np.append(rng.uniform(-0.05, 0.05, 2), 0))

    rig = calibrate(made.made.inputs, made.made.rectangles, moved(made, "tag4", anywhere), "cam0")
    (said,) = [sentence for sentence in rig.weak if "moved on body" in sentence]
    assert said.startswith("'tag4' moved on body 'box': by ")
    assert not rig.missing
    step = rig.camera("cam1").rig_from_camera.step_to(made.true(0, 1))
    assert np.sqrt(step @ np.linalg.solve(rig.pose_covariance("cam1"), step) / 6) < 2.5


def test_of_bodies_that_hold_nobody_is_accused(made):
    rig = calibrate(made.made.inputs, made.made.rectangles, made.made.views, "cam0")
    assert not [sentence for sentence in rig.weak if "body" in sentence]


def test_a_layout_that_the_pictures_contradict_is_named(made):
    places = {r.name: made.made.world_from_rect[r.name][0] for r in made.made.rectangles}
    given = {name: places["tag0"].inverse() @ place for name, place in places.items()}
    given["tag1"] = given["tag1"] @ Pose.from_vectors(np.array([0, 0, TURNED]), np.array([BY, 0, 0]))

    def known(rectangle: Rectangle) -> Rectangle:
        return replace(rectangle, body_from_rect=given[rectangle.name])

    rig = calibrate(made.made.inputs, [known(r) for r in made.made.rectangles], made.made.views, "cam0")
    (said,) = [sentence for sentence in rig.weak if "was given" in sentence]
    assert said.startswith("'tag1' does not stand on body 'box' where it was given: the pictures have it 1")
