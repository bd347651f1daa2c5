"""Which model a lens has is found from boards in all of its picture, also where the first focal is far off."""

import numpy as np
import pytest

from quadrig.rig.problem.build import build_problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.start.lens_models import with_lens_models
from quadrig.rig.start.lenses_and_poses import first_cameras
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.boards import board_points
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.rotation import rotation_from_vector
from quadrig.single.view import View

WIDTH, HEIGHT = 1280, 720
POINTS = board_points(9, 7, 0.04)
# A full-frame camera's fisheye as mrcal has it, 150 degrees across; and a webcam's pinhole.
FISHEYE = Intrinsics(
    WIDTH, HEIGHT, 441.5, np.array([639.5, 358.0]), np.array([0.043, 0, 0.007, -0.002, 0]), 1, "fisheye"
)
PINHOLE = Intrinsics(WIDTH, HEIGHT, 769.0, np.array([661.0, 380.0]), np.array([0.06, -0.1, 0, 0.001, 0]))


def problem_of(lens, facing, seed):
    """Boards wherever the lens has a pixel, towards the camera but for some tilt."""
    rng = np.random.default_rng(seed)
    views = []
    for frameset in range(30):
        sight = lens.unproject(rng.uniform([0, 0], [WIDTH, HEIGHT]))
        place = sight * rng.uniform(0.35, 0.9)
        turn = rotation_from_vector(0.4 * rng.normal(size=3)) @ facing(np.zeros(3), place).rotation
        pixels = lens.project(Pose(turn, place).transform(POINTS))
        with np.errstate(invalid="ignore"):
            seen = ((pixels > 0) & (pixels < [WIDTH, HEIGHT])).all(axis=1)
        if seen.sum() >= 12:
            noisy = pixels[seen] + 0.1 * rng.normal(size=(int(seen.sum()), 2))
            views.append(View("board", POINTS[seen], noisy, "wide", frameset))
    return build_problem([CameraInput("wide", WIDTH, HEIGHT)], [Rectangle("board", 0.36, 0.28, moving=True)], views)


@pytest.mark.parametrize("seed", range(2))
def test_a_fisheye_is_found_and_begins_near_its_focal(simulated, seed):
    """Of pinholes its boards have the focal 60 % too long; a fit that stops on its way there is no fault of the
    model's."""
    problem, alone = with_lens_models(*begun(problem_of(FISHEYE, simulated.facing, seed)))
    assert problem.cameras[0].lens == "fisheye"
    assert alone.lens[0, 0] == pytest.approx(FISHEYE.focal, rel=0.03)


def test_a_pinhole_remains_one(simulated):
    problem, _ = with_lens_models(*begun(problem_of(PINHOLE, simulated.facing, 0)))
    assert problem.cameras[0].lens == "auto"


def begun(problem):
    return problem, first_cameras(problem)
