"""What is taken for granted of a lens before its Views speak."""

import numpy as np

from quadrig.rig.adjustment.priors import prior
from quadrig.rig.problem.build import build_problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single.lens import Intrinsics


def test_a_lens_is_straight_and_looks_at_the_middle_until_its_views_say_otherwise():
    known = Intrinsics(640, 480, 500.0, np.array([300.0, 250.0]), np.array([-0.2, 0.1, 0.001, 0.0, 0.0]), 1.01)
    problem = build_problem([CameraInput("a", 1280, 720), CameraInput("b", 640, 480, known)], [], [])
    mean, information = prior(problem, 0.02)
    assert mean[0].tolist() == [0, 639.5, 359.5, 0, 0, 0, 0, 0, 1]
    np.testing.assert_array_equal(mean[1], known.parameters)
    # Nothing is known of a focal; an axis lies within 2 % of the picture's larger side, alike in both directions.
    assert information[:, 0].tolist() == [0, 0]
    sigma = 1 / np.sqrt(information[:, 1:])
    np.testing.assert_allclose(sigma[:, :2], [[25.6, 25.6], [12.8, 12.8]])
    # Webcams bend by a k1 of a tenth and less; their pixels are square to a per cent.
    np.testing.assert_array_equal(sigma[0, 2:], sigma[1, 2:])
    assert (sigma[0, [2, 3]] > 0.1).all()
    assert (sigma[0, [4, 5, 7]] < 0.01).all()
