"""Errors of whole Views: as large as they are, found for what moves, and none where there are none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from quadrig.rig.joint.view_errors import _not_negative, view_error_variances
from quadrig.single.lens import project


@pytest.fixture(scope="module")
def made(simulated):
    return simulated.simulate(8, simulated.Scene(cameras=4, framesets=40, tags=1, noise=0.2))


def strayed(made, sigma):
    """The moving sheet shifted by so much (m, one direction) in each View by itself."""
    rng, views = np.random.default_rng(0), []
    moving = {rectangle.name for rectangle in made.rectangles if rectangle.moving}
    for view in made.views:
        if view.rectangle not in moving:
            views.append(view)
            continue
        index = made.index(view.camera)
        pose = made.world_from_camera[index].inverse() @ made.world_from_rect[view.rectangle][view.frameset]
        seen, off = (
            project(made.lenses[index], pose.retract(step).transform(view.points), "pinhole")
            for step in (np.zeros(6), np.concatenate([np.zeros(3), sigma * rng.normal(size=3)]))
        )
        views.append(replace(view, pixels=view.pixels + off - seen))
    return replace(made, views=tuple(views))


def median_shift(made, jointly):
    """Sigmas (m) of shifts: of the moving sheet's Views, and of those of what stands still."""
    problem, joint = jointly(made)
    variances = view_error_variances(problem, joint)
    moving = np.array([problem.rectangles[view.rectangle].moving for view in problem.views])
    return tuple(float(np.sqrt(np.median(variances[rows, 3:]))) for rows in (moving, ~moving))


def test_shifts_of_views_are_found_about_as_large_as_they_are(made, jointly):
    sigma = 0.0005
    shift, still = median_shift(strayed(made, sigma), jointly)
    # Some 100 Views, three to a pose of the sheet that follows them, four cameras with a figure each: it came out 5 %
    # to 40 % too small in four rigs.
    assert 0.6 * sigma < shift < 1.2 * sigma
    assert still < sigma / 3


def test_where_no_view_strays_there_is_next_to_nothing(made, jointly):
    shift, still = median_shift(made, jointly)
    assert max(shift, still) < 0.0002


@pytest.mark.parametrize("right", [(1.0, 2.0), (-1.0, 2.0), (1.0, -2.0), (-1.0, -2.0), (0.3, 4.0)])
def test_no_variance_is_below_zero(right):
    matrix = np.array([[2e-8, 3e-6], [1e-6, 4.0]])
    scale = np.sqrt(np.diagonal(matrix))
    expected = nnls(matrix / scale / scale[:, None], right / scale)[0] / scale
    np.testing.assert_allclose(_not_negative(matrix, np.array(right)), expected, rtol=1e-9)


def test_a_pose_that_one_view_alone_tells_shows_no_error_of_it(simulated, jointly):
    """Nothing is left over: what rounding leaves would be taken for errors of many metres."""
    made = simulated.simulate(8, simulated.Scene(cameras=1, framesets=6, tags=3, noise=0.05))
    problem, joint = jointly(made)
    moving = np.array([problem.rectangles[view.rectangle].moving for view in problem.views])
    assert moving.any()
    np.testing.assert_array_equal(view_error_variances(problem, joint)[moving], 0.0)
    assert view_error_variances(problem, joint).max() < 1.0
