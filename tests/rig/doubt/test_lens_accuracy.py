"""The figure of a lens: where a point far away is seen, whatever the camera's pose."""

import numpy as np
import pytest

from quadrig.rig.doubt.lens_accuracy import accuracy_in_words, lens_accuracy
from quadrig.rig.result import Camera, Rig
from quadrig.single.lens import Intrinsics
from quadrig.single.pose import Pose


def of_one(covariance, focal=800.0):
    lens = Intrinsics.centred(1280, 960, focal)
    return Rig("a", (Camera("a", lens, Pose.identity(), ("focal",), views=9),), (), covariance)


def with_variance(*entries):
    covariance = np.zeros((15, 15))
    for index, sigma in entries:
        covariance[index, index] = sigma**2
    return covariance


def test_a_focal_stretches_the_picture():
    # A longer focal moves pixels away from the middle by their share of it: the root mean square of the distance.
    sigma = lens_accuracy(of_one(with_variance((0, 8.0))), "a")
    middles = (np.arange(8) + 0.5) / 8 - 0.5
    across, down = np.meshgrid(1280 * middles, 960 * middles)
    assert sigma == pytest.approx(8 / 800 * np.sqrt(np.mean(across**2 + down**2)), rel=1e-6)


def test_where_the_principal_point_lies_is_nearly_a_rotation():
    """With a long focal a shift of the picture is a rotation of the camera, to a share of a per cent."""
    assert lens_accuracy(of_one(with_variance((1, 5.0)), focal=20000.0), "a") < 0.01


def test_it_is_what_two_draws_of_the_lens_differ_by(board_rig):
    """Against draws of the lens itself, the best rotation taken out by Kabsch."""
    _, rig = board_rig
    name = rig.cameras[1].name
    lens, rng = rig.camera(name).intrinsics, np.random.default_rng(1)
    across, down = np.meshgrid(np.linspace(40, 1240, 12), np.linspace(20, 700, 12))
    rays = lens.unproject(np.column_stack([across.ravel(), down.ravel()]))
    draws = rng.multivariate_normal(np.zeros(9), rig.lens_covariance(name), 200)
    squares = []
    for draw in draws:
        seen = lens.with_parameters(lens.parameters + draw).unproject(lens.project(rays))
        u, _, vt = np.linalg.svd(seen.T @ rays)
        away = lens.project(rays @ (u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt).T) - lens.project(seen)
        squares.append(np.mean(np.sum(away**2, axis=1)))
    # Both axes together are between one and the square root of two of the worse.
    both = float(np.sqrt(np.mean(squares)))
    assert 0.9 * both / np.sqrt(2) < lens_accuracy(rig, name) < 1.1 * both


def test_the_words_name_points_or_directions(board_rig):
    _, rig = board_rig
    assert "volume" in accuracy_in_words(rig)
    assert "directions to 4.6 px" in accuracy_in_words(of_one(with_variance((0, 8.0)), 800.0))
