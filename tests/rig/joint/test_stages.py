"""Least squares to the end of a long recording."""

import sys

import pytest

from quadrig.rig.calibration import calibrate


@pytest.mark.parametrize("seed", [0, 1])
def test_what_a_long_recording_teaches_does_not_lead_it_away(load_script, simulated, seed):
    """300 framesets of one carried board: what is learned of lenses and sheet once took cameras 180 mm from where
    they were, six of their sigmas. Five sigmas are met by chance once in a million."""
    sys.modules.setdefault("simulated", simulated)
    choice = load_script("benchmarks/choice.py")
    one = choice.take(seed)
    rig = calibrate(one.made.inputs, one.made.rectangles, one.views, "cam0")
    error, sigma, _ = choice.judge(one.made, rig)
    assert error < 5 * sigma
    # Corners of 0.1 px at 2.5 m and a focal of 1000 px are 0.25 mm: a board's 40 cm bring no camera 20 mm astray.
    assert error < 20
