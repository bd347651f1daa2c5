"""What the covariance becomes where one camera's pictures are noisier than the fit took them for."""

import numpy as np
import pytest

from quadrig.rig.joint.widened import widened_covariance


def test_all_pictures_alike_scale_what_priors_do_not_hold(jointly, simulated):
    _, joint = jointly(simulated.simulate(7, simulated.Scene(cameras=3, framesets=14)))
    none = np.zeros((len(joint.observations.camera), 6))
    alike, errors = widened_covariance(joint, np.ones(3), none), joint.bordered.widened(None, None) - joint.covariance
    same = widened_covariance(joint, np.ones(3) * (1 + 1e-12), none)
    np.testing.assert_allclose(same, alike, rtol=1e-6, atol=1e-9 * np.abs(joint.covariance).max())
    twice = np.diagonal(widened_covariance(joint, np.full(3, 2.0), none) - errors)
    once = np.diagonal(joint.covariance)
    free = once > 0
    assert (twice[free] > once[free]).all()
    assert (twice[free] < 2.0000001 * once[free]).all()
    # Poses hang on the Views alone, all but for what the priors say of the lenses.
    assert np.median(twice[free] / once[free]) > 1.6


def test_the_noisier_camera_is_the_less_sure_one(jointly, simulated):
    _, joint = jointly(simulated.simulate(8, simulated.Scene(cameras=3, framesets=14)))
    size, none = len(joint.covariance) // 3, np.zeros((len(joint.observations.camera), 6))
    errors = joint.bordered.widened(None, None) - joint.covariance
    wider = np.diagonal(widened_covariance(joint, np.array([1.0, 1.0, 4.0]), none) - errors)
    growth = wider.reshape(3, size)[:, 0] / np.diagonal(joint.covariance).reshape(3, size)[:, 0]
    assert growth[2] == pytest.approx(growth.max())
    assert growth[2] > 2 * growth[:2].max() / 1.5
