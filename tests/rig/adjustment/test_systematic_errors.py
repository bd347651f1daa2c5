"""Errors that many corners share: taken off, Views are as they would be without them."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.adjustment.normal_equations import residual_squares
from quadrig.rig.adjustment.systematic_errors import sheet_rows, systematic_errors
from quadrig.single.lens import project
from quadrig.single.posterior.sheet_shape import shape_basis


@pytest.fixture(scope="module")
def made(simulated):
    return simulated.simulate(5, simulated.Scene(cameras=3, framesets=12, tags=1))


def bent(made, shapes):
    """The same pictures, of sheets that are not what they are said to be."""
    views = []
    for view in made.views:
        rectangle = next(r for r in made.rectangles if r.name == view.rectangle)
        pose = made.world_from_rect[view.rectangle]
        pose = pose[view.frameset] if rectangle.moving else pose
        camera_from_rect = made.world_from_camera[made.index(view.camera)].inverse() @ pose
        points = view.points + np.einsum("pki,k->pi", shape_basis(rectangle, view.points), shapes[view.rectangle])
        lens = made.lenses[made.index(view.camera)]
        located = camera_from_rect.transform(points)
        views.append(replace(view, pixels=project(lens, located, "pinhole")))
    return replace(made, views=tuple(views))


def test_bent_sheets_are_seen_where_their_shape_has_them(made, states):
    rng = np.random.default_rng(1)
    shapes = {r.name: 0.002 * rng.normal(size=7) for r in made.rectangles}
    seen = bent(made, shapes)
    problem = states.problem_of(seen)
    observations, truth = problem.observations(), states.true_state(seen, problem)
    errors = systematic_errors(problem, observations)
    values = np.zeros(len(errors.held))
    values[: 7 * len(problem.rectangles)] = np.concatenate([shapes[name] for name in problem.rectangles])
    missed = [
        s[g.weights > 0] for g, s in zip(observations.groups, residual_squares(observations, truth), strict=True)
    ]
    assert np.sqrt(np.concatenate(missed).mean()) > 0.1
    right = errors.corrected(observations, values)
    for group, square in zip(right.groups, residual_squares(right, truth), strict=True):
        assert square[group.weights > 0].max() < 1e-12
    for name, shape in shapes.items():
        np.testing.assert_array_equal(values[sheet_rows(list(problem.rectangles), name)], shape)
