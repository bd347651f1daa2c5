"""A lens that is focused anew while it is recorded is named, with the instant; one that stays is not."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.rig.joint.refocused import focal_steps


@pytest.fixture(scope="module")
def made(simulated):
    return simulated.simulate(5, simulated.Scene(cameras=3, framesets=24, noise=0.1))


def refocusing(made, camera, frameset, share):
    """Its Views with one camera's pictures larger by a share from a frameset on, about its principal point."""
    centre = made.lenses[made.index(camera), 1:3]
    return [
        replace(view, pixels=centre + (1 + share) * (view.pixels - centre), time=view.frameset / 10)
        if view.camera == camera and view.frameset >= frameset
        else replace(view, time=view.frameset / 10)
        for view in made.views
    ]


def told(made, views):
    rig = calibrate(made.inputs, made.rectangles, views)
    return [sentence for sentence in rig.weak if "focused anew" in sentence]


def test_a_lens_that_stays_is_not_accused(made):
    assert not told(made, made.views)


def test_a_lens_that_is_focused_anew_is_named_with_the_instant(made):
    """By 3 %, a third into the recording; webcams were seen to change by 2 and more."""
    [said] = told(made, refocusing(made, "cam1", 8, 0.03))
    assert said.startswith("cam1: its focal changed by +")
    frameset = int(said.split("frameset ")[1].split(" ")[0])
    assert abs(frameset - 8) <= 2
    assert said.endswith("leave out its pictures before")


def test_steps_are_those_that_were_made_and_as_sure_as_noise_allows():
    """Views of one linear model of three parameters, the first of which grows by five sigmas after two thirds."""
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(60, 8, 3))
    late = np.arange(60) >= 40
    values = np.array([1.0, -2.0, 0.5]) + 0.5 * late[:, None] * [1, 0, 0]
    seen = np.einsum("vrk,vk->vr", rows, values) + rng.normal(size=(60, 8))
    information = np.swapaxes(rows, 1, 2) @ rows
    pull = np.einsum("vrk,vr->vk", rows, seen)
    [step], [sigma] = focal_steps(information, pull, np.zeros((3, 3)), np.zeros(3), np.array([40]))
    expected = np.sqrt(60 / (8 * 40 * 20))
    assert sigma == pytest.approx(expected, rel=0.35)
    assert abs(step - 0.5) < 3 * sigma
