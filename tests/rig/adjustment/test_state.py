"""The chain camera_from_rig @ rig_from_body @ body_from_rect and its derivatives, against numeric ones."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.adjustment.levenberg_marquardt import FreeParameters, adjust
from quadrig.rig.adjustment.motion import Motion
from quadrig.rig.adjustment.pose_priors import LayoutPrior, MotionPrior
from quadrig.rig.adjustment.state import State, chain_derivatives
from quadrig.rig.problem.build import build_problem
from quadrig.single.pose import stacked

STEP = 1e-6


@pytest.fixture(scope="module")
def box(bodies, table_lens):
    """Observations of a box of tags, and a state near the truth, its layout found, given roughly and given."""
    made = bodies.turntable(np.random.default_rng(4), table_lens, 8)
    places = {name: place[0] for name, place in made.made.world_from_rect.items()}

    def told(rectangle):
        if rectangle.name not in ("tag1", "tag2"):
            return rectangle
        sigma = (0.01, 0.002) if rectangle.name == "tag1" else (0.0, 0.0)
        on_body = places["tag2"].inverse() @ places[rectangle.name]
        return replace(rectangle, body_from_rect=on_body, layout_sigma=sigma)

    problem = build_problem(made.made.inputs, [told(r) for r in made.made.rectangles], made.made.views)
    assert problem.layouts.found == 4
    assert len(problem.layouts.names) == 5
    world = made.made.world_from_rect["tag2"]
    rng = np.random.default_rng(0)
    layouts = stacked([places["tag2"].inverse() @ places[name] for name in problem.layouts.names])
    state = State(
        made.made.lenses,
        made.rig_from_camera.inverse(),
        stacked([world[node.frameset] for node in problem.nodes]),
        layouts,
    )
    shake = [3e-3 * rng.normal(size=(count, 6)) for count in (2, len(problem.nodes), 4)]
    return problem, state.moved(np.zeros((2, 9)), *shake)


def moves(state, part, row, axis, size):
    twists = {"cameras": np.zeros((2, 6)), "nodes": np.zeros((len(state.rig_from_body.translation), 6))}
    twists["layouts"] = np.zeros((4, 6))
    twists[part][row, axis] = size
    return state.moved(np.zeros((2, 9)), twists["cameras"], twists["nodes"], twists["layouts"])


@pytest.mark.parametrize("part", ["cameras", "nodes", "layouts"])
def test_the_chain_moves_as_its_derivatives_say(box, part):
    problem, state = box
    observations = problem.observations()
    chain = chain_derivatives(observations, state)
    by = {"cameras": chain.by_camera, "nodes": chain.by_node, "layouts": chain.by_layout}[part]
    whose = {"cameras": problem.camera, "nodes": problem.node, "layouts": observations.joins.layout}[part]
    here = state.camera_from_rect(observations)
    for row in range(4 if part == "layouts" else 2):
        own = whose == row
        assert own.any()
        for axis in range(6):
            after = moves(state, part, row, axis, STEP).camera_from_rect(observations)
            before = moves(state, part, row, axis, -STEP).camera_from_rect(observations)
            slope = (here.step_to(after) - here.step_to(before)) / (2 * STEP)
            np.testing.assert_allclose(slope[own], by[own][:, :, axis], atol=1e-7)
            assert not slope[~own].any()


def test_a_clock_moves_a_rectangle_with_its_body(box):
    problem, state = box
    observations, views = problem.observations(), len(problem.views)
    rng = np.random.default_rng(1)
    rate, bend = rng.normal(size=(2, views, 6))
    rows, whole = 300 * rng.normal(size=(2, views)), np.ones((2, 2), bool)
    moves = Motion(rate, bend, 0.01 * rng.normal(size=views), rows[0], rows[1], whole[:, 0], whole)
    moving = replace(state, motion=moves, clocks=np.zeros((2, 2)))
    by_clock = chain_derivatives(observations, moving).by_camera[:, :, 6:]
    here = moving.camera_from_rect(observations)
    for column, size in enumerate((STEP, 1e-2 * STEP)):
        clocks = size * np.eye(2)[column] * np.ones((2, 1))
        after, before = (
            here.step_to(replace(moving, clocks=side * clocks).camera_from_rect(observations)) for side in (1, -1)
        )
        # A rotation during the lag turns the rate, which the derivative leaves out: a hundredth of it here.
        close = 0.06 * np.abs(moves.by_clock[:, column]).max()
        np.testing.assert_allclose((after - before) / (2 * size), by_clock[:, :, column], atol=close)


def test_normal_equations_have_the_cost_s_gradient_and_curvature(box):
    """Of every unknown of the reduced system, of ties between cameras and layouts, and with all priors."""
    problem, state = box
    observations, cameras = problem.observations(), 2
    layouts = LayoutPrior(problem.layouts.given[:4], problem.layouts.information[:4])
    twists = np.linalg.qr(np.array([[0.1, 1.0, 0.0, 0.6, 0.0, 0.8], [0.0, 0.3, 1.0, 0.0, 0.2, 0.1]]).T)[0]
    # Near by, as what it holds is: far off the motion's rotation vector is no linear one.
    held = MotionPrior(1, twists, state.camera_from_rig[1].inverse().retract(np.full(6, 1e-3)), 1e4)
    free = FreeParameters(
        np.zeros((cameras, 9), bool), np.array([False, True]), np.ones(observations.nodes, bool), state.lens,
        np.zeros((cameras, 9, 9)), layouts=layouts, motions=(held,),
    )  # fmt: skip

    def fit(at):
        return adjust(observations, at, free, 0.2, most_steps=0)

    found = fit(state)
    units = [("cameras", 1), *(("layouts", row) for row in range(4))]
    for part, row in units:
        unit = row if part == "cameras" else cameras + row
        for axis in range(6):
            plus, minus = (fit(moves(state, part, row, axis, side * 1e-5)).costs[0] for side in (1, -1))
            gradient = -(plus - minus) / (4 * 1e-5)
            assert found.normal.unit_gradient[unit, axis] == pytest.approx(gradient, rel=1e-3, abs=1.0)
    rows = observations.joins.layout
    for tie, (left, right) in enumerate(
        zip(
            found.tables.block_left[found.tables.tie_block],
            found.tables.block_right[found.tables.tie_block],
            strict=True,
        )
    ):
        own = (problem.camera == left) & (rows == right - cameras)
        chain = chain_derivatives(observations, state)
        expected = sum(
            chain.by_camera[v].T @ found.linearised.gram[v, :6, :6] @ chain.by_layout[v] for v in np.flatnonzero(own)
        )
        np.testing.assert_allclose(found.normal.ties[tie], expected, rtol=1e-9, atol=1e-6)
    assert found.tables.units == cameras + 4


def test_all_unknowns_together_come_to_rest(box):
    """Shaken from the least cost all come back to it, layouts and cameras and poses following each other."""
    problem, state = box
    observations = problem.observations()
    layouts = LayoutPrior(problem.layouts.given[:4], problem.layouts.information[:4])
    free = FreeParameters(
        np.zeros((2, 9), bool), np.array([False, True]), np.ones(observations.nodes, bool), state.lens,
        np.zeros((2, 9, 9)), layouts=layouts,
    )  # fmt: skip
    found = adjust(observations, state, free, 0.2)
    rng = np.random.default_rng(7)
    twists = [2e-3 * rng.normal(size=(count, 6)) for count in (1, observations.nodes, 4)]
    twists[0] = np.concatenate([np.zeros((1, 6)), twists[0]])
    again = adjust(observations, found.state.moved(np.zeros((2, 9)), *twists), free, 0.2)
    assert again.costs[0] > 5 * found.costs[-1]
    assert again.costs[-1] == pytest.approx(found.costs[-1], rel=1e-6)
    for one in ("camera_from_rig", "rig_from_body", "body_from_rect"):
        assert np.abs(getattr(found.state, one).step_to(getattr(again.state, one))).max() < 1e-5
