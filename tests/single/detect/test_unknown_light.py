"""Light that no model of an edge has: where corners are off by it, their sigma says so."""

import numpy as np
import pytest

from quadrig.single.arrays import Picture
from quadrig.single.detect.image_search import detect_views
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.blank_sheet import PlainMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.capture import SRGB, Capture, Shadow
from quadrig.single.render.picture import Sheet, ray_grid, render_image
from quadrig.single.view import View

LENS = Intrinsics(640, 480, 700.0, np.array([321.0, 238.0]))
GRID = ray_grid(LENS)
TAG = Rectangle("tag", 0.16, 0.16, TagMarking("apriltag_36h11", 5))
SHEET = Rectangle("sheet", 0.297, 0.21, PlainMarking())
# Sigmas of a corner that one in 1000 is beyond.
FAR = 4.0


def picture(rectangle: Rectangle, pose: Pose, **light) -> Picture:
    capture = Capture(noise=2.0, curve=SRGB, jpeg=92, **light)
    return render_image(
        GRID, Pose.identity(), [Sheet(rectangle, pose)], background=0.25, capture=capture, samples=3, colour=False
    )


def distances(view: View, pose: Pose) -> np.ndarray:
    """Of the corners from their places, in sigmas, of the reading that fits best."""
    seen = [LENS.project(pose.transform(points)) for points in view.readings]
    gap = view.pixels - min(seen, key=lambda one: float(np.abs(view.pixels - one).max()))
    common = np.zeros_like(gap) if view.common is None else view.common
    covariance = view.sigma**2 * np.eye(2) + common[:, :, None] * common[:, None]
    return np.sqrt(np.einsum("pi,pij,pj->p", gap, np.linalg.inv(covariance), gap))


@pytest.mark.parametrize("exposure", [1.5, 2.0])
@pytest.mark.parametrize(("rectangle", "blur"), [(SHEET, 0.7), (SHEET, 1.5), (TAG, 0.7)])
def test_white_that_is_cut_off_is_doubted(rectangle, blur, exposure):
    pose = Pose.from_vectors(np.array([0.4, -0.3, 0.2]), np.array([0.02, 0.0, 0.8]))
    for view in detect_views(picture(rectangle, pose, blur=blur, exposure=exposure), [rectangle]):
        assert distances(view, pose).max() < FAR


@pytest.mark.parametrize("across", np.linspace(0.1, 3.0, 4))
def test_the_border_of_a_soft_shadow_across_a_tag_is_doubted(across):
    pose = Pose.from_vectors(np.array([0.3, 0.2, 0.5]), np.array([0.0, 0.0, 0.9]))
    along, out = np.array([np.cos(across), np.sin(across)]), np.array([-np.sin(across), np.cos(across)])
    ends = [np.array(LENS.principal_point) + part for part in (-900 * along, 900 * along)]
    outline = [*ends, ends[1] + 900 * out, ends[0] + 900 * out]
    shadow = Shadow(tuple((float(x), float(y)) for x, y in outline), 0.45, 10.0)
    for view in detect_views(picture(TAG, pose, blur=0.8, shadows=(shadow,)), [TAG]):
        assert distances(view, pose).max() < FAR
