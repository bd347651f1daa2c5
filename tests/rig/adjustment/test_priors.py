"""Priors of lenses: all is free but what is fixed, and data weigh the classes the same whatever prior they met."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.adjustment.priors import estimated_lenses, first_priors, weighed_priors
from quadrig.rig.problem.build import build_problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single.lens import LENS_PARAMETERS, Intrinsics


@pytest.fixture
def problem():
    known = Intrinsics.centred(1280, 720, 900.0)
    return build_problem(
        [
            CameraInput("auto", 1280, 720),
            CameraInput("asked", 1280, 720, lens="f k1"),
            CameraInput("fisheye", 1280, 720, replace(known, model="fisheye")),
            CameraInput("fixed", 1280, 720, known, fixed=True),
        ],
        [],
        [],
    )


def test_nothing_is_decided_away_but_what_is_given_or_asked_for(problem):
    names = [camera.name for camera in problem.cameras]
    free = dict(zip(names, estimated_lenses(problem), strict=True))
    assert free["auto"].all()
    assert [n for n, one in zip(LENS_PARAMETERS, free["asked"], strict=True) if one] == ["focal", "k1"]
    assert [n for n, one in zip(LENS_PARAMETERS, free["fisheye"], strict=True) if not one] == ["k3"]
    assert not free["fixed"].any()


def test_data_weigh_the_classes_the_same_whatever_prior_the_fit_had(problem):
    rng = np.random.default_rng(0)
    free = np.ones((4, 9), bool)
    first = first_priors(problem, np.full(4, 900.0))
    sigma = np.array([20, 8, 8, 0.02, 0.04, 5e-4, 5e-4, 0.05, 1e-3])
    data, lens = np.diag(sigma**-2), np.array([905, 650, 350, -0.3, 0.1, 3e-4, -2e-4, 0.0, 1.0005])
    found = []
    for scale in (1.0, 0.3):
        # The posterior of these data under a prior that is as it is, and under one that is wider and elsewhere.
        elsewhere = first.mean + (1 - scale) * rng.normal() * 3
        prior = replace(first, information=first.information * scale, mean=elsewhere)
        both = data + prior.information
        middle = np.linalg.solve(both, (data @ lens + (prior.information @ prior.mean[..., None])[..., 0])[..., None])
        found.append(
            weighed_priors(
                problem, prior, free, np.asarray(middle[..., 0], float), np.asarray(np.linalg.inv(both), float)
            )
        )
    # The focal about which each prior is linearised differs a little.
    np.testing.assert_allclose(found[0].kinds, found[1].kinds, atol=0.01)
    assert found[0].kinds[0, 0] > first.kinds[0, 0]


def test_data_that_say_nothing_leave_the_classes_as_they_were(problem):
    first = first_priors(problem, np.full(4, 900.0))
    again = weighed_priors(
        problem, first, np.ones((4, 9), bool), first.mean, np.asarray(np.linalg.inv(first.information), float)
    )
    np.testing.assert_allclose(again.kinds, first.kinds, atol=1e-6)


def test_a_focal_of_flat_views_is_held_as_firmly_as_its_information_is_noise(problem):
    first = first_priors(problem, np.full(4, 900.0))
    held = first.holding_focals(np.full(4, 0.25))
    np.testing.assert_allclose(held.information[:, 0, 0], 4 * first.information[:, 0, 0])
    np.testing.assert_allclose(held.information[:, 1:, 1:], first.information[:, 1:, 1:])
    np.testing.assert_allclose(held.holding_focals(np.ones(4)).information, first.information)
