"""A lens of 180 degrees, of which nothing is given: real corners of a body with five boards all around it."""

import numpy as np
import pytest

# Corners of a few pictures as one smooth lens leaves them when it is fitted to the very pictures it is tested on
# (python -m benchmarks wide has the figures of others): with flat boards 0.26 px, with bent ones a little less.
_TEST_RMS = 0.25


@pytest.fixture(scope="module")
def wide(load_script):
    return load_script("benchmarks/wide.py")


@pytest.fixture(scope="module")
def rig(wide, shared_data):
    return wide.solved(shared_data / "cube", "auto")


def test_it_is_found_to_be_a_fisheye_that_sees_to_its_side(wide, rig, shared_data):
    lens = rig.cameras[0].intrinsics
    assert lens.model == "fisheye"
    pixels = np.concatenate([view.pixels for view in wide.views(shared_data / "cube", "train")])
    rays = lens.unproject(pixels)
    assert np.isfinite(rays).all()
    assert rays[:, 2].min() < np.cos(np.radians(88))
    # What boards 0 and all boards say by another program's fit of the same model.
    assert lens.focal == pytest.approx(350.6, abs=1.0)


def test_pictures_that_took_no_part_fit_as_those_that_did(wide, rig, shared_data):
    by_board, _ = wide.left_over(shared_data / "cube", rig.cameras[0].intrinsics, rig.rectangles)
    assert by_board < _TEST_RMS


def test_boards_beside_the_camera_are_used(rig):
    assert sum(bool(fit.rejected) for fit in rig.fits) <= 1
