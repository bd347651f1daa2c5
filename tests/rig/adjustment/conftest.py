"""Small rigs for the joint adjustment, at their true state."""

import pytest


@pytest.fixture(scope="session")
def states(load_script):
    """problem_of, true_state, shaken, open_freedom, whole_cost, full_system."""
    return load_script("tests/rig/adjustment/states.py")


@pytest.fixture(scope="session", params=["pinhole", "fisheye"])
def small(request, simulated, states):
    scene = simulated.Scene(
        cameras=3, framesets=12, tags=1, model=request.param,
        focals=(800, 1000) if request.param == "pinhole" else (400, 500),
    )  # fmt: skip
    made = simulated.simulate(3, scene)
    problem = states.problem_of(made)
    return problem.observations(), states.true_state(made, problem)
