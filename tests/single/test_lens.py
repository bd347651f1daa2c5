"""Lenses: rays come back from pixels, derivatives are those of differences, numbers are OpenCV's."""

import cv2
import numpy as np
import pytest

from quadrig.single.lens import (
    LENS_PARAMETERS,
    Intrinsics,
    LensModel,
    fill_projection_rows,
    image_middle,
    project,
    project_with_derivatives,
    unproject,
)

PINHOLE = np.array([900.0, 655.0, 340.0, -0.21, 0.06, 0.003, -0.002, -0.01, 1.01])
FISHEYE = np.array([420.0, 655.0, 340.0, 0.03, -0.008, 0.002, -0.0004, 0.0, 0.99])
BOTH = pytest.mark.parametrize(("lens", "model"), [(PINHOLE, "pinhole"), (FISHEYE, "fisheye")])


def points_in_view(model, count=200, seed=0):
    rng = np.random.default_rng(seed)
    widest = 0.6 if model == "pinhole" else 1.4
    angle, turn, distance = (
        rng.uniform(0, widest, count),
        rng.uniform(0, 2 * np.pi, count),
        rng.uniform(0.5, 5, count),
    )
    unit = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=-1)
    return unit * distance[:, None]


@BOTH
def test_a_ray_leads_back_from_its_pixel(lens, model):
    points = points_in_view(model)
    rays = unproject(lens, project(lens, points, model), model)
    np.testing.assert_allclose(rays, points / np.linalg.norm(points, axis=1, keepdims=True), atol=1e-9)


@BOTH
def test_a_pixel_comes_back_from_its_ray(lens, model):
    rng = np.random.default_rng(1)
    pixels = rng.uniform([0, 0], [1280, 720], (300, 2))
    rays = unproject(lens, pixels, model)
    # By itself, too: the two differ by less than Newton's method leaves.
    np.testing.assert_allclose(unproject(lens, pixels[0], model), rays[0], atol=1e-12)
    assert np.isfinite(rays).all()
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, atol=1e-14)
    np.testing.assert_allclose(project(lens, rays, model), pixels, atol=1e-6)


@BOTH
def test_derivatives_are_those_of_differences(lens, model):
    points = points_in_view(model, 40, 2)
    pixels, by_lens, by_point = project_with_derivatives(lens, points, model)
    np.testing.assert_allclose(pixels, project(lens, points, model), atol=1e-10)
    for column in range(len(LENS_PARAMETERS)):
        if model == "fisheye" and LENS_PARAMETERS[column] == "k3":
            np.testing.assert_array_equal(by_lens[..., column], 0)
        step = np.zeros(9)
        step[column] = 1e-6 * max(1.0, abs(lens[column]))
        numeric = (project(lens + step, points, model) - project(lens - step, points, model)) / (2 * step[column])
        np.testing.assert_allclose(by_lens[..., column], numeric, atol=2e-6, rtol=1e-6)
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        numeric = (project(lens, points + step, model) - project(lens, points - step, model)) / 2e-6
        np.testing.assert_allclose(by_point[..., axis], numeric, atol=2e-5, rtol=1e-6)


@BOTH
def test_derivatives_on_the_axis_are_finite_and_right(lens, model):
    axis = np.array([[0.0, 0.0, 2.0]])
    pixels, by_lens, by_point = project_with_derivatives(lens, axis, model)
    np.testing.assert_allclose(pixels[0], lens[1:3], atol=1e-12)
    assert np.isfinite(by_lens).all()
    step = 1e-5 * np.eye(3)
    numeric = (project(lens, axis + step, model) - project(lens, axis - step, model)) / 2e-5
    np.testing.assert_allclose(by_point[0], numeric.T, atol=1e-4)


def test_rows_may_be_laid_out_as_the_caller_likes():
    points = points_in_view("pinhole", 30)
    by_lens, by_point = np.zeros((30, 9, 2)), np.zeros((30, 3, 2))
    pixels = fill_projection_rows(
        PINHOLE[:, None], points.T, list(by_lens.transpose(1, 2, 0)), by_point.transpose(1, 2, 0), "pinhole"
    )
    expected = project_with_derivatives(PINHOLE, points)
    np.testing.assert_allclose(pixels.T, expected[0], atol=1e-10)
    np.testing.assert_allclose(np.swapaxes(by_lens, 1, 2), expected[1], atol=1e-9)
    np.testing.assert_allclose(np.swapaxes(by_point, 1, 2), expected[2], atol=1e-9)


def test_pixels_are_opencvs():
    models: dict[LensModel, np.ndarray] = {"pinhole": PINHOLE, "fisheye": FISHEYE}
    for model, lens in models.items():
        points = points_in_view(model)
        camera = Intrinsics(1280, 720, lens[0], lens[1:3], lens[3:8], lens[8], model)
        here = points[None].astype(np.float64)
        if model == "pinhole":
            theirs = cv2.projectPoints(here, np.zeros(3), np.zeros(3), camera.camera_matrix, lens[3:8])[0]
        else:
            theirs = cv2.fisheye.projectPoints(here, np.zeros(3), np.zeros(3), camera.camera_matrix, lens[3:7])[0]
        np.testing.assert_allclose(camera.project(points), theirs.reshape(-1, 2), atol=1e-8)


def test_a_pinhole_sees_nothing_behind_itself_and_a_fisheye_sees_past_its_side():
    behind, beside = np.array([0.3, 0.2, -1.0]), np.array([1.0, 0.5, -0.2])
    assert np.isnan(project(PINHOLE, behind)).all()
    found = project(FISHEYE, beside, "fisheye")
    assert np.isfinite(found).all()
    np.testing.assert_allclose(unproject(FISHEYE, found, "fisheye"), beside / np.linalg.norm(beside), atol=1e-9)


def test_a_pixel_past_the_fold_of_a_lens_has_no_ray():
    folding = np.array([900.0, 640, 360, -0.5, 0, 0, 0, 0, 1.0])
    # r (1 - 0.5 r^2) is never more than 0.544: 490 px from the middle.
    inside, outside = np.array([640 + 480.0, 360]), np.array([640 + 500.0, 360])
    assert np.isfinite(unproject(folding, inside)).all()
    assert np.isnan(unproject(folding, outside)).all()


def test_one_pixel_without_a_ray_costs_the_others_nothing():
    folding = np.array([900.0, 640, 360, -0.5, 0, 0, 0, 0, 1.0])
    rays = unproject(folding, np.array([[700.0, 400.0], [1140.0, 360.0]]))
    np.testing.assert_allclose(project(folding, rays[0]), [700, 400], atol=1e-6)
    assert np.isnan(rays[1]).all()


@BOTH
def test_parameters_come_back_from_intrinsics(lens, model):
    camera = Intrinsics.centred(1280, 720, 500.0, model).with_parameters(lens)
    np.testing.assert_array_equal(camera.parameters, lens)
    assert (camera.width, camera.height, camera.model) == (1280, 720, model)
    np.testing.assert_array_equal(Intrinsics.centred(1280, 720, 5).principal_point, image_middle(1280, 720))
