"""Simulated rigs for every test of this room: the same that the benchmarks use."""

import pytest

from quadrig.rig.calibration import calibrate


@pytest.fixture(scope="session")
def simulated(load_script):
    """benchmarks/simulated.py: simulate, ring, Scene, errors."""
    return load_script("benchmarks/simulated.py")


@pytest.fixture(scope="session")
def board_rig(simulated):
    """Three cameras, a moving board, two tags; and the Rig that its Views give."""
    made = simulated.simulate(11, simulated.Scene(cameras=3, framesets=12))
    return made, calibrate(made.inputs, made.rectangles, made.views)
