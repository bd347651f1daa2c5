"""Crossings of edges: found to a fraction of a pixel, never far from the place, and none where there is none."""

import cv2
import numpy as np
import pytest

from quadrig.single.subpixel.edge_crossing import FARTHEST, nearest_crossing

SIZE, FINE = 80, 16


def drawn(angle: float, corner: np.ndarray, kind: str) -> np.ndarray:
    """A picture (80, 80) of a corner of a sheet, of a line of paint 12 px wide, or of a crossing of a board."""
    y, x = np.mgrid[0 : SIZE * FINE, 0 : SIZE * FINE] / FINE - 0.5 + 0.5 / FINE
    c, s = np.cos(angle), np.sin(angle)
    u, v = c * (x - corner[0]) + s * (y - corner[1]), -s * (x - corner[0]) + c * (y - corner[1])
    inside = (u > 0) & (v > 0)
    if kind == "line":
        inside &= (u < 12) | (v < 12)
    if kind == "board":
        inside = (u > 0) == (v > 0)
    light = cv2.resize(np.where(inside, 200.0, 60.0), (SIZE, SIZE), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(0).normal(size=light.shape)
    return np.clip(cv2.GaussianBlur(light, (0, 0), 0.8) + 2 * noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("kind", ["sheet", "line", "board"])
@pytest.mark.parametrize("angle", [0.0, 0.3, 1.1, 2.5, -2.0])
def test_the_corner_is_found_to_a_fraction_of_a_pixel(kind, angle):
    corner = np.array([40.3, 38.6])
    picture = drawn(angle, corner, kind)
    for step in ([0, 0], [2.5, -2], [-3, 1]):
        found = nearest_crossing(picture, corner + step)
        assert found is not None
        np.testing.assert_allclose(found, corner, atol=0.15)


def test_nothing_farther_than_five_pixels_is_taken():
    corner = np.array([40.3, 38.6])
    picture = drawn(0.3, corner, "sheet")
    for angle in np.linspace(0, 6, 7):
        way = np.array([np.cos(angle), np.sin(angle)])
        assert nearest_crossing(picture, corner + (FARTHEST + 0.5) * way) is None
        assert nearest_crossing(picture, corner + (FARTHEST - 0.5) * way) is not None


def test_an_edge_alone_or_plain_ground_has_no_crossing():
    assert nearest_crossing(np.full((60, 60), 90, np.uint8), np.array([30.0, 30.0])) is None
    edge = drawn(0.3, np.array([40.0, -300.0]), "sheet")
    assert nearest_crossing(edge, np.array([40.0, 40.0])) is None
    noise = np.random.default_rng(1).normal(90, 4, (60, 60)).astype(np.uint8)
    assert nearest_crossing(noise, np.array([30.0, 30.0])) is None


def test_the_border_of_the_picture_is_no_edge():
    picture = drawn(0.0, np.array([2.5, 3.5]), "sheet")
    for place in ([0, 0], [79, 79], [0.0, 40.0]):
        found = nearest_crossing(picture, np.array(place, float))
        assert found is None or np.hypot(*(found - [2.5, 3.5])) < 0.5
