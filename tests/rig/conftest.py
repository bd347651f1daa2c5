"""Simulated rigs for every test of this room: the same that the benchmarks use."""

import sys

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.rig.joint.stages import Joint, solve_jointly
from quadrig.rig.problem.build import build_problem
from quadrig.rig.start.lenses_and_poses import first_cameras
from quadrig.rig.start.pose_graph import first_rig


@pytest.fixture(scope="session")
def simulated(load_script):
    """benchmarks/simulated.py: simulate, ring, Scene, errors."""
    return load_script("benchmarks/simulated.py")


@pytest.fixture(scope="session")
def bodies(load_script):
    """benchmarks/body_worlds.py: carried, turntable, vehicle, back_to_back, spinning."""
    for name in ("simulated", "worlds"):
        # Benchmarks import one another by name.
        sys.modules.setdefault(name, load_script(f"benchmarks/{name}.py"))
    return load_script("benchmarks/body_worlds.py")


@pytest.fixture(scope="session")
def table_lens(load_script, bodies):
    """Lenses as benchmarks/worlds.py draws them, whose rooms those of the bodies are."""
    assert bodies
    return load_script("benchmarks/worlds.py").table_lens


@pytest.fixture(scope="session")
def board_rig(simulated):
    """Three cameras, a moving board, two tags; and the Rig that its Views give."""
    made = simulated.simulate(11, simulated.Scene(cameras=3, framesets=12))
    return made, calibrate(made.inputs, made.rectangles, made.views)


@pytest.fixture(scope="session")
def jointly():
    """From a simulated rig to its problem and the end of the joint adjustment."""

    def solved(made):
        problem = build_problem(made.inputs, made.rectangles, made.views)
        alone = first_cameras(problem)
        standing = np.arange(len(problem.cameras)) == 0
        joint = solve_jointly(problem, alone, first_rig(problem, alone.candidates, 0), standing)
        assert isinstance(joint, Joint)
        return problem, joint

    return solved
