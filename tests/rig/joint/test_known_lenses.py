"""Lenses known before: in two steps the doubt is that of one, and what contradicts them is said."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics


def laboratory_and_site(simulated, seed):
    """A site with tags and a small sheet; and Views of a board that each camera was shown by itself before."""
    scene = simulated.Scene(framesets=12, board=False)
    site = simulated.simulate(seed, scene)
    views, sheet = [], None
    for k, camera in enumerate(site.inputs):
        shown = simulated.views_again(site, replace(scene, framesets=20, board=True), 100 * seed + k)
        views += [
            replace(v, rectangle="board", frameset=1000 * (k + 1) + v.frameset)
            for v in shown
            if v.camera == camera.name
        ]
    sheet = replace(next(r for r in site.rectangles if r.moving), name="board")
    return site, [*site.rectangles, sheet], views


def known(made, laboratory, **given):
    lenses = {c.name: (laboratory, c) for c in laboratory.cameras} | {c.name: (r, c) for r, c in laboratory.lens_only}
    return [
        replace(camera, intrinsics=lenses[camera.name][1].intrinsics, **{
            key: value(*lenses[camera.name]) for key, value in given.items()
        })
        for camera in made.inputs
    ]  # fmt: skip


def test_two_steps_end_with_the_doubt_of_one(simulated):
    """Lenses in the laboratory, poses on the site, against all Views together: sigmas of positions, rotations and
    focals within 5 % in the middle of rigs, each of which finds its own noise: a single one is off by as much."""
    ratios = []
    for seed in range(8):
        site, rectangles, views = laboratory_and_site(simulated, seed)
        joint = calibrate(site.inputs, rectangles, [*site.views, *views])
        laboratory = calibrate(site.inputs, rectangles, views)
        inputs = known(site, laboratory, lens_evidence=lambda _, camera: camera.lens_evidence)
        rig = calibrate(inputs, site.rectangles, site.views)
        for camera in site.inputs:
            figures = [rig.focal_sigma(camera.name) / joint.focal_sigma(camera.name)]
            if camera.name != rig.reference:
                figures.append(rig.position_sigma(camera.name) / joint.position_sigma(camera.name))
                figures.append(rig.rotation_sigma(camera.name) / joint.rotation_sigma(camera.name))
            ratios += figures
    assert np.exp(np.mean(np.log(ratios))) == pytest.approx(1, abs=0.05)


def test_lenses_whose_views_agree_are_not_accused(simulated):
    site, rectangles, views = laboratory_and_site(simulated, 3)
    laboratory = calibrate(site.inputs, rectangles, views)
    inputs = known(site, laboratory, lens_evidence=lambda _, camera: camera.lens_evidence)
    rig = calibrate(inputs, site.rectangles, site.views)
    assert not any("lens that was" in sentence for sentence in rig.weak)


def test_lenses_that_are_kept_are_the_same_after_as_before(simulated):
    site, rectangles, views = laboratory_and_site(simulated, 3)
    laboratory = calibrate(site.inputs, rectangles, views)
    inputs = known(site, laboratory, lens_covariance=lambda rig, camera: rig.lens_covariance(camera.name))
    rig = calibrate([replace(one, fixed=True) for one in inputs], site.rectangles, site.views)
    assert not any("lens that was" in sentence for sentence in rig.weak)
    for one in inputs:
        np.testing.assert_array_equal(rig.camera(one.name).intrinsics.parameters, one.intrinsics.parameters)
        assert rig.focal_sigma(one.name) == 0


def test_without_the_laboratory_the_same_site_knows_less(simulated):
    site, rectangles, views = laboratory_and_site(simulated, 3)
    laboratory = calibrate(site.inputs, rectangles, views)
    inputs = known(site, laboratory, lens_evidence=lambda _, camera: camera.lens_evidence)
    rig = calibrate(inputs, site.rectangles, site.views)
    alone = calibrate(site.inputs, site.rectangles, site.views)
    assert alone.focal_sigma("cam1") > 1.2 * rig.focal_sigma("cam1")
    assert alone.working_accuracy > 1.2 * rig.working_accuracy


def test_a_covariance_alone_is_a_prior(simulated):
    site, rectangles, views = laboratory_and_site(simulated, 1)
    laboratory = calibrate(site.inputs, rectangles, views)
    inputs = known(site, laboratory, lens_covariance=lambda rig, camera: rig.lens_covariance(camera.name))
    rig = calibrate(inputs, site.rectangles, site.views)
    before = {c.name: laboratory for c in laboratory.cameras} | {c.name: r for r, c in laboratory.lens_only}
    for camera in rig.cameras:
        assert rig.focal_sigma(camera.name) < 1.1 * before[camera.name].focal_sigma(camera.name)
        error = camera.intrinsics.focal - site.lenses[site.index(camera.name), 0]
        assert abs(error) < 4 * rig.focal_sigma(camera.name)
    assert not [sentence for sentence in rig.weak if "contradict" in sentence]


def test_another_camera_s_lens_is_said(simulated):
    site, rectangles, views = laboratory_and_site(simulated, 1)
    laboratory = calibrate(site.inputs, rectangles, views)
    inputs = known(site, laboratory, lens_evidence=lambda _, camera: camera.lens_evidence)
    first, second, *rest = inputs
    swapped = [
        replace(first, intrinsics=second.intrinsics, lens_evidence=second.lens_evidence),
        replace(second, intrinsics=first.intrinsics, lens_evidence=first.lens_evidence),
        *rest,
    ]
    rig = calibrate(swapped, site.rectangles, site.views)
    told = [sentence for sentence in rig.weak if "contradict the lens that was known" in sentence]
    assert {sentence.split(":")[0] for sentence in told} >= {"cam0", "cam1"} & {c.name for c in rig.cameras}


def test_what_is_known_must_be_of_a_lens():
    lens = Intrinsics.centred(640, 480, 500.0)
    for given, covariance, said in (
        (None, np.eye(9), "give its lens"),
        (lens, np.eye(8), "9 x 9"),
        (lens, -np.eye(9), "negative"),
    ):
        with pytest.raises(QuadrigError, match=said):
            CameraInput("a", 640, 480, given, lens_covariance=covariance)


@pytest.mark.parametrize(
    "change", [{"focal": 1e-320}, {"focal": 1e308}, {"distortion": np.full(5, 1e308)}, {"aspect": np.nan}]
)
def test_numbers_that_no_lens_has_are_refused(change):
    lens = replace(Intrinsics.centred(640, 480, 500.0), **change)
    with pytest.raises(QuadrigError, match="camera 'left': the lens given is that of no camera"):
        CameraInput("left", 640, 480, lens)
