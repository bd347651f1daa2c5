"""What is weak in a rig is said where it is, and not where it is not."""

from dataclasses import replace

import numpy as np

from quadrig.rig.doubt.weaknesses import weaknesses


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
