from collections import Counter

import numpy as np
import pytest

from quadrig.io.sheet.box import box_pdf, on_box
from quadrig.io.sheet.layout import paper_named, scaled, sheet_size
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Rectangle, rectangle_corners

FRONT, RIGHT, BACK, LEFT, TOP, BOTTOM = range(6)
BOTTOM_RIGHT, BOTTOM_LEFT, TOP_LEFT, TOP_RIGHT = range(4)


def a_box(side=0.04):
    return on_box(
        [Rectangle(f"t{n}", side, side, TagMarking("apriltag_36h11", n), moving=True) for n in range(6)], "b"
    )


def corners_in_body(faces):
    """Corners (6, 4, 3) of the faces with their white borders, in the frame of the body."""
    side = sheet_size(faces[0])[0] * 1e-3
    poses = [face.body_from_rect for face in faces if face.body_from_rect is not None]
    return np.array([rectangle_corners(side, side) @ pose.rotation.T + pose.translation for pose in poses])


def test_folded_faces_close_to_a_cube_whose_prints_look_outward():
    faces = a_box()
    corners = corners_in_body(faces)
    met = Counter(tuple(np.round(corner, 9) + 0.0) for corner in corners.reshape(-1, 3))
    assert sorted(met.values()) == [3] * 8
    for face in faces:
        assert face.body_from_rect is not None
        assert face.body_from_rect.translation @ face.body_from_rect.rotation[:, 2] < 0


@pytest.mark.parametrize(
    ("one", "edge", "other", "beside"),
    [
        (FRONT, (TOP_LEFT, TOP_RIGHT), TOP, (BOTTOM_LEFT, BOTTOM_RIGHT)),
        (FRONT, (BOTTOM_LEFT, BOTTOM_RIGHT), BOTTOM, (TOP_LEFT, TOP_RIGHT)),
        (FRONT, (TOP_RIGHT, BOTTOM_RIGHT), RIGHT, (TOP_LEFT, BOTTOM_LEFT)),
        (FRONT, (TOP_LEFT, BOTTOM_LEFT), LEFT, (TOP_RIGHT, BOTTOM_RIGHT)),
        (BOTTOM, (BOTTOM_LEFT, BOTTOM_RIGHT), BACK, (TOP_LEFT, TOP_RIGHT)),
    ],
)
def test_what_touches_on_the_paper_touches_on_the_cube(one, edge, other, beside):
    corners = corners_in_body(a_box())
    np.testing.assert_allclose(corners[one, edge], corners[other, beside], atol=1e-12)


def test_a_print_that_came_out_smaller_makes_a_smaller_cube():
    faces = [scaled(face, 0.99) for face in a_box()]
    np.testing.assert_allclose(corners_in_body(faces), 0.99 * corners_in_body(a_box()), atol=2e-6)


def test_a_cube_that_the_paper_does_not_hold_is_refused():
    assert box_pdf(a_box(0.04), paper_named("A4", across=False)).startswith(b"%PDF")
    with pytest.raises(QuadrigError, match="does not fit on A4"):
        box_pdf(a_box(0.05), paper_named("A4", across=False))
