"""Steps and covariances of many cameras in the order in which they are tied: those of the dense system."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quadrig.rig.adjustment.banded import BandBordered
from quadrig.rig.adjustment.bordered import solve_bordered
from quadrig.rig.joint.cross_validation import cross_validate
from quadrig.rig.joint.delivered_lens import delivered_lenses
from quadrig.rig.joint.widened import gradient_covariance

# Shares of a sigma: what inverses of so weak a ring of cameras lose to rounding.
ROUNDING = 1e-3


@pytest.fixture(scope="module", params=["fields", "none"])
def ring(request, simulated, jointly):
    """The same end of a fit, once by bands and once dense."""
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "none":
            # As for some hundreds of cameras, whose lenses have no fields of their own.
            none = np.zeros((0, 2), int)
            patch.setattr("quadrig.rig.adjustment.systematic_errors.degrees_of", lambda _: none)
        problem, joint = jointly(simulated.ring(30, 10))
    banded = joint.bordered
    assert isinstance(banded, BandBordered)
    dense = solve_bordered(
        banded.border, joint.errors, joint.values, joint.adjustment, joint.reduced, joint.covariance
    ).with_step_in_doubt()
    sigma = np.sqrt(np.diagonal(dense.joint_covariance))
    return SimpleNamespace(problem=problem, joint=joint, banded=banded, dense=dense, sigma=sigma)


def close(found, expected, sigma):
    """To a share of what the two numbers' own sigmas allow."""
    np.testing.assert_array_less(
        np.abs(found - expected), ROUNDING * sigma[..., :, None] * sigma[..., None, :] + 1e-300
    )


def test_the_step_is_that_of_the_dense_system(ring):
    steps = [np.concatenate([one.unit_steps.ravel(), one.step]) for one in (ring.banded, ring.dense)]
    assert (np.abs(steps[0] - steps[1]) <= ROUNDING * ring.sigma).all()
    assert ring.banded.fall == pytest.approx(ring.dense.fall, rel=ROUNDING)
    assert ring.banded.effective == pytest.approx(ring.dense.effective, rel=1e-6)
    covariances = ring.dense.node_covariances(ring.joint.adjustment, ring.joint.reduced)
    away = np.abs(ring.banded.node_steps - ring.dense.node_steps)
    assert (away <= ROUNDING * np.sqrt(np.einsum("kii->ki", covariances))).all()


def test_covariances_are_those_of_the_dense_system(ring):
    every = np.arange(len(ring.sigma))
    close(ring.banded.columns(every), ring.dense.joint_covariance, ring.sigma)
    close(ring.dense.columns(every), ring.dense.joint_covariance, ring.sigma)
    sheets = np.arange(7 * len(ring.problem.rectangles)).reshape(-1, 7)
    errors = ring.dense.error_covariances(sheets)
    close(ring.banded.error_covariances(sheets), errors, np.sqrt(np.einsum("kii->ki", errors)))
    lenses = ring.dense.lens_covariances(ring.joint.adjustment)
    close(ring.banded.lens_covariances(ring.joint.adjustment), lenses, np.sqrt(np.einsum("kii->ki", lenses)))
    common = ring.joint.errors.common
    banded, product = (one.error_products(common) for one in (ring.banded, ring.dense))
    allowed = ring.sigma[-len(common) :] * np.sqrt(common @ product)
    assert (np.abs(banded - product) <= ROUNDING * allowed).all()


def test_bodies_follow_cameras_and_sheets_alike(ring):
    banded, dense = (
        one.node_covariances(ring.joint.adjustment, ring.joint.reduced) for one in (ring.banded, ring.dense)
    )
    close(banded, dense, np.sqrt(np.einsum("kii->ki", dense)))


@pytest.mark.parametrize("wider", [False, True])
def test_noisier_pictures_widen_both_alike(ring, wider):
    joint, gradient = ring.joint, None
    if wider:
        widening = np.random.default_rng(0).uniform(1, 2, joint.observations.cameras)
        none = np.zeros((len(joint.observations.camera), 6))
        gradient = gradient_covariance(
            joint.observations, joint.adjustment, joint.free, joint.reduced, widening, none
        )
    taken = delivered_lenses(joint).taken
    dense = ring.dense.widened(gradient, taken)
    close(ring.banded.widened(gradient, taken), dense, np.sqrt(np.diagonal(dense)))


def test_folds_are_held_against_one_another_alike(ring):
    banded, dense = (
        cross_validate(ring.problem, replace(ring.joint, bordered=one)) for one in (ring.banded, ring.dense)
    )
    np.testing.assert_allclose(banded.squares, dense.squares, rtol=ROUNDING)
    np.testing.assert_allclose(banded.dispersion, dense.dispersion, rtol=ROUNDING)
