"""The classes of lenses: their weights are Bayes's, their moments those of draws."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.single.lens import Intrinsics
from quadrig.single.lens_prior import CLASS_NAMES, lens_classes

SIGMA = np.array([5, 5, 5, 0.02, 0.03, 5e-4, 5e-4, 0.05, 1e-3])


@pytest.fixture
def classes():
    return lens_classes([(1280, 720)] * 2, np.array([1000.0, 400.0]), ["pinhole", "fisheye"])


def weighed(classes, lens):
    information = np.tile(np.diag(SIGMA**-2), (len(classes.weight), 1, 1))
    return classes.weigh(information @ lens, information)


def test_weights_are_those_of_bayes(classes):
    lens = np.array([1000, 650, 350, -0.3, 0.1, 1e-4, 0, -0.03, 1.0])
    log = []
    for weight, mean, covariance in zip(classes.weight[0], classes.mean[0], classes.covariance[0], strict=True):
        unit = classes.unit[0]
        spread = covariance * np.outer(unit, unit) + np.diag(SIGMA**2)
        off = lens - classes.offset[0] - unit * mean
        density = -0.5 * off @ np.linalg.solve(spread, off) - 0.5 * np.linalg.slogdet(spread)[1]
        log.append(np.log(weight) + density if weight > 0 else -np.inf)
    expected = np.exp(np.array(log) - max(log))
    np.testing.assert_allclose(weighed(classes, lens)[0], expected / expected.sum(), atol=1e-9)


def test_moments_are_those_of_draws(classes):
    rng = np.random.default_rng(0)
    row = rng.choice(classes.weight.shape[1], 200_000, p=classes.weight[0])
    half = np.linalg.cholesky(classes.covariance[0])
    drawn = classes.mean[0, row] + (half[row] @ rng.normal(size=(len(row), 9, 1)))[..., 0]
    drawn = classes.offset[0] + classes.unit[0] * drawn
    mean, covariance = classes.moments()
    sigma = np.sqrt(np.diagonal(covariance[0]))
    np.testing.assert_allclose((drawn.mean(axis=0) - mean[0]) / sigma, 0, atol=0.01)
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(np.cov(drawn.T) / scale, covariance[0] / scale, atol=0.03)


@pytest.mark.parametrize(("k", "name"), [((-0.3, 0.1, -0.03), "barrel"), ((0.0, 0.0, 0.0), "nearly straight")])
def test_a_lens_is_known_by_its_bends(classes, k, name):
    lens = np.array([1000, 640, 360, k[0], k[1], 0, 0, k[2], 1.0])
    kinds = replace(classes, weight=weighed(classes, lens)).kinds()[0]
    assert CLASS_NAMES[int(np.argmax(kinds))] == name
    assert kinds.sum() == pytest.approx(1)


def test_a_given_lens_is_believed_where_the_data_agree_and_dropped_where_they_do_not():
    given = Intrinsics.centred(1280, 720, 1000.0)
    classes = lens_classes([(1280, 720)], np.array([1000.0]), ["pinhole"], [(given, None)])
    seen = [given.parameters * [scale, *[1] * 8] for scale in (1, 1.15)]
    kinds = [replace(classes, weight=weighed(classes, lens)).kinds()[0] for lens in seen]
    assert kinds[0][CLASS_NAMES.index("as given")] > 0.9
    assert kinds[1][CLASS_NAMES.index("as given")] < 1e-6
