"""Every kind of marking answers what it is asked, and one more may be added."""

from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
import pytest

from quadrig.single.errors import QuadrigError
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.registry import marking_kinds, marking_values, register
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Marking, Rectangle
from quadrig.single.render.marking_image import marking_patches

EXAMPLES = {
    "tag": {"dictionary": "apriltag_36h11", "id": 5},
    "charuco": {"columns": 5, "rows": 4, "square": 0.05, "marker": 0.038, "dictionary": "aruco_4x4_50"},
    "aprilgrid": {"columns": 4, "rows": 3, "tag": 0.05, "spacing": 0.3},
    "circles": {"columns": 5, "rows": 4, "spacing": 0.04},
    "chessboard": {"columns": 7, "rows": 5, "square": 0.04},
}


def marked(kind: str) -> Rectangle:
    marking = marking_kinds()[kind](**EXAMPLES.get(kind, {}))
    return Rectangle("r", *(marking.size or (0.3, 0.2)), marking)


@pytest.mark.parametrize("kind", marking_kinds())
def test_points_and_drawing_stay_on_the_sheet(kind):
    rectangle = marked(kind)
    points = rectangle.marking.points(rectangle)
    assert (np.abs(points) <= [rectangle.width / 2, rectangle.height / 2, 0]).all()
    sheet, *patches = marking_patches(rectangle)
    assert sheet.right == pytest.approx(rectangle.width / 2 + rectangle.marking.quiet_zone(rectangle))
    for patch in patches:
        assert -rectangle.width / 2 - 1e-9 <= patch.left < patch.right <= rectangle.width / 2 + 1e-9
        assert -rectangle.height / 2 - 1e-9 <= patch.top < patch.bottom <= rectangle.height / 2 + 1e-9


@pytest.mark.parametrize("kind", marking_kinds())
def test_plain_values_make_the_same_marking_again(kind):
    marking = marked(kind).marking
    values = marking_values(marking)
    assert set(values) == {"kind", *(field.name for field in fields(marking))}
    assert marking_kinds()[values.pop("kind")](**values) == marking


@pytest.mark.parametrize("kind", marking_kinds())
def test_what_is_not_found_is_named_with_advice(kind):
    assert "was not found; show" in marked(kind).marking.not_found


@pytest.mark.parametrize("kind", ["charuco", "aprilgrid", "chessboard"])
def test_a_printers_scale_changes_all_lengths_of_a_board_alike(kind):
    marking = marked(kind).marking
    assert marking.size is not None
    scaled = marking.scaled(0.99).size
    assert scaled == pytest.approx(0.99 * np.array(marking.size), abs=1e-5)
    assert marked("tag").marking.scaled(0.99) == marked("tag").marking


def test_a_board_bears_tags_that_count_on_row_by_row():
    board = CharucoMarking(4, 3, 0.05, 0.04, "DICT_4X4_50", first_id=7)
    assert board.dictionary == "aruco_4x4_50"
    assert board.tags.ids == frozenset(range(7, 13))
    assert board.tag_squares[:3] == [(1, 0), (3, 0), (0, 1)]


@pytest.mark.parametrize("values", [(1, 4, 0.05), (4, 0, 0.05), (4, 4, 0.0), (4, 4, np.nan)])
def test_a_board_that_cannot_be_is_refused(values):
    with pytest.raises(QuadrigError, match=r"columns|rows|square"):
        ChessboardMarking(*values)


def test_a_tag_that_does_not_fit_its_square_is_refused():
    with pytest.raises(QuadrigError, match="smaller"):
        CharucoMarking(5, 4, 0.05, 0.05, "aruco_4x4_50")


def test_a_name_serves_one_kind_only():
    @dataclass(frozen=True)
    class Other(Marking):
        kind: ClassVar[str] = "tag"

    with pytest.raises(QuadrigError, match="'tag' already"):
        register(Other)
    assert marking_kinds()["tag"] is TagMarking
    assert register(TagMarking) is TagMarking
