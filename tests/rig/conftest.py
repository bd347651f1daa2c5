"""Simulated rigs for every test of this room: the same that the benchmarks use."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

_FILE = Path(__file__).resolve().parents[2] / "benchmarks" / "simulated.py"


@pytest.fixture(scope="session")
def simulated() -> ModuleType:
    """benchmarks/simulated.py: simulate, ring, Scene, errors."""
    spec = importlib.util.spec_from_file_location("simulated", _FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their own module up by name.
    sys.modules["simulated"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def board_rig(simulated):
    """Three cameras, a moving board, two tags; and the Rig that its Views give."""
    from quadrig.rig.calibration import calibrate

    made = simulated.simulate(11, simulated.Scene(cameras=3, framesets=12))
    return made, calibrate(made.inputs, made.rectangles, made.views)
