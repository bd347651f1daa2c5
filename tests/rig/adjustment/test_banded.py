"""Steps and covariances of many cameras in the order in which they are tied: those of the dense system."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quadrig.rig.adjustment.banded import BandBordered
from quadrig.rig.adjustment.bordered import solve_bordered
from quadrig.rig.joint.cross_validation import cross_validate
from quadrig.rig.joint.widened import gradient_covariance

# Shares of a sigma: what inverses of so weak a ring of cameras lose to rounding.
ROUNDING = 1e-3


@pytest.fixture(scope="module")
def ring(simulated, jointly):
    """The same end of a fit, once by bands and once dense."""
    with pytest.MonkeyPatch.context() as patch:
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
    np.testing.assert_allclose(ring.banded.node_steps, ring.dense.node_steps, rtol=ROUNDING, atol=1e-12)


def test_covariances_are_those_of_the_dense_system(ring):
    every = np.arange(len(ring.sigma))
    close(ring.banded.columns(every), ring.dense.joint_covariance, ring.sigma)
    close(ring.dense.columns(every), ring.dense.joint_covariance, ring.sigma)
    sheets = np.arange(len(ring.joint.values)).reshape(-1, 7)
    errors = ring.dense.error_covariances(sheets)
    close(ring.banded.error_covariances(sheets), errors, np.sqrt(np.einsum("kii->ki", errors)))
    lenses = ring.dense.lens_covariances(ring.joint.adjustment)
    close(ring.banded.lens_covariances(ring.joint.adjustment), lenses, np.sqrt(np.einsum("kii->ki", lenses)))
    common = ring.joint.errors.common
    np.testing.assert_allclose(ring.banded.error_products(common), ring.dense.error_products(common), rtol=ROUNDING)


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
    dense = ring.dense.widened(gradient, None)
    close(ring.banded.widened(gradient, None), dense, np.sqrt(np.diagonal(dense)))


def test_folds_are_held_against_one_another_alike(ring):
    banded, dense = (
        cross_validate(ring.problem, replace(ring.joint, bordered=one)) for one in (ring.banded, ring.dense)
    )
    np.testing.assert_allclose(banded.squares, dense.squares, rtol=ROUNDING)
    np.testing.assert_allclose(banded.dispersion, dense.dispersion, rtol=ROUNDING)
