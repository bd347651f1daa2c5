"""What is weak in a rig is said where it is, and not where it is not."""

from dataclasses import replace

import numpy as np

from quadrig.rig.calibration import calibrate
from quadrig.rig.doubt.verdict import verdict, weak_points
from quadrig.rig.doubt.weaknesses import bent_sheets, clocks_apart, weaknesses
from quadrig.single.posterior.sheet_shape import SheetShape
from quadrig.single.rectangle import Rectangle


def left_out(rig, camera, strays):
    """The rig without those corners of a camera that stray(distance from its axis) says."""
    axis = rig.camera(camera).intrinsics.principal_point
    fits = [
        replace(fit, used=fit.used & ~strays(np.linalg.norm(fit.view.pixels - axis, axis=1)))
        if fit.view.camera == camera
        else fit
        for fit in rig.fits
    ]
    return replace(rig, fits=tuple(fits))


def test_a_lens_model_that_ends_before_its_picture_does_is_named(board_rig):
    """All corners farther out than three in four of them left out: it is said of that camera, and from there on."""
    _, rig = board_rig
    fits = [fit for fit in rig.fits if fit.view.camera == "cam1"]
    axis = rig.camera("cam1").intrinsics.principal_point
    far = np.quantile(np.linalg.norm(np.concatenate([fit.view.pixels for fit in fits]) - axis, axis=1), 0.75)
    [said] = [one for one in weaknesses(left_out(rig, "cam1", lambda d: d > far)) if "does not hold beyond" in one]
    edge = float(said.split("beyond ")[1].split(" px")[0])
    # As many again that fit lie within, until no more than half stray.
    assert said.startswith("cam1")
    assert edge < far + 1


def test_corners_that_stray_anywhere_accuse_no_lens(board_rig):
    _, rig = board_rig
    rng = np.random.default_rng(1)
    assert not [one for one in weaknesses(rig) if "does not hold" in one]
    scattered = left_out(rig, "cam1", lambda d: rng.uniform(size=len(d)) < 0.1)
    assert not [one for one in weaknesses(scattered) if "does not hold" in one]


def test_rectangles_that_nobody_saw_are_named_in_the_list_that_is_shown(board_rig):
    made, rig = board_rig
    wall = [Rectangle(f"wall{number}", 0.2, 0.2) for number in range(2)]
    more = calibrate(made.inputs, [*made.rectangles, *wall], made.views)
    (said,) = [sentence for sentence in weak_points(more) if "no camera saw" in sentence]
    assert said.startswith("no camera saw 'wall0' and 'wall1': show them")
    assert not [sentence for sentence in weak_points(rig) if "no camera saw" in sentence]


def test_of_one_camera_nothing_is_said_that_takes_several(board_rig):
    _, rig = board_rig
    alone = replace(rig, cameras=rig.cameras[:1], covariance=rig.covariance[:15, :15], dispersion=9.0)
    rejected = replace(alone, fits=tuple(replace(fit, rejected="why") for fit in rig.fits))
    said = [*weaknesses(alone), *weak_points(rejected)]
    assert [one for one in said if one.startswith("fifths")]
    assert [one for one in said if one.startswith("most Views were rejected")]
    assert not [one for one in said if "clocks" in one or "all cameras" in one]
    assert [one for one in weaknesses(replace(rig, dispersion=9.0)) if "clocks" in one]


def test_bent_sheets_are_in_the_list_and_no_reason_for_care(board_rig):
    _, rig = board_rig
    flat, bent = (SheetShape(np.full(7, value), 1e-8 * np.eye(7)) for value in (0.0, 0.004))
    first, *others = rig.rectangles
    bowed = replace(rig, rectangles=(replace(first, shape=bent), *(replace(one, shape=flat) for one in others)))
    (said,) = bent_sheets(bowed)
    assert f"{first.name!r} spans" in said
    assert said in weaknesses(bowed)
    assert verdict(replace(rig, weak=(said,))).grade == "with care"
    assert verdict(replace(bowed, weak=(said,))).grade == verdict(replace(rig, weak=())).grade


def test_clocks_disagree_only_where_they_surely_do_and_it_matters(board_rig):
    """A clock that is 5 ms late, known to 0.4 ms or to 2; and one that is 1 ms late, known well."""
    _, rig = board_rig

    def said(late, sigma):
        offsets = [-late / 2, late / 2]
        cameras = [
            replace(camera, clock_offset=offset, clock_offset_sigma=sigma / 2)
            for camera, offset in zip(rig.cameras, offsets, strict=False)
        ]
        return clocks_apart(replace(rig, cameras=(*cameras, *rig.cameras[2:])))

    (sentence,) = said(0.005, 0.0004)
    assert "taken 5.00 \u00b1 0.40 ms later by cam1" in sentence
    assert not said(0.005, 0.002)
    assert not said(0.001, 0.0001)
