"""corners.toml: what was pointed at comes back, what a person wrote stays, what is wrong is one sentence."""

import numpy as np
import pytest

from quadrig.io.config.corners_toml import CORNER_NAMES, PointedCorners, keep_corners, read_corners
from quadrig.io.config.rig_toml import parse_config, read_config
from quadrig.single.errors import QuadrigError

ROOM = """
[[rectangle]]
name = "court"
size = "tennis court"
marking = { kind = "points" }

[[rectangle]]
name = "sheet"
size = "A4 upright"
moving = true
marking = { kind = "points" }

[[rectangle]]
name = "tag"
width = 0.2
height = 0.2
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 7 }
"""
COURT, SHEET, TAG = parse_config(ROOM).rectangles
PIXELS = np.array([[900.25, 700.0], [100.0, 650.5], [300.0, 200.0], [800.0, 210.75]])
TABLE = """
# clicked on Tuesday
[[corners]]
camera = "left"       # the one by the net
rectangle = "court"
sigma = 2
bottom_right = [900, 700]
bottom_left = [100, 650]
top_left = [300, 200]
top_right = [800, 210]
"""


def test_a_known_size_is_the_rectangle_s():
    assert (COURT.width, COURT.height) == (23.77, 10.97)
    assert (SHEET.width, SHEET.height) == (0.210, 0.297)
    with pytest.raises(QuadrigError, match=r"line 4: rectangle 'court': no size is called 'tenis'"):
        parse_config(ROOM.replace("tennis court", "tenis"))
    with pytest.raises(QuadrigError, match=r"line 4: rectangle 'court' has a size by name and a width"):
        parse_config(ROOM.replace('court"\nmarking', 'court"\nwidth = 20.0\nmarking', 1))


def test_what_is_kept_comes_back_and_comments_stay(tmp_path):
    path = tmp_path / "corners.toml"
    path.write_text(TABLE)
    keep_corners(path, PointedCorners("left", COURT, PIXELS, sigma=1.5))
    keep_corners(path, PointedCorners("right", SHEET, PIXELS + 1, image=3))
    text = path.read_text()
    assert "# clicked on Tuesday" in text
    assert "# the one by the net" in text
    first, second = read_corners(path, [COURT, SHEET])
    assert (first.camera, first.rectangle.name, first.image, first.sigma) == ("left", "court", None, 1.5)
    assert (second.camera, second.rectangle.name, second.image, second.sigma) == ("right", "sheet", 3, 1.0)
    np.testing.assert_array_equal(first.pixels, PIXELS)
    np.testing.assert_array_equal(second.pixels, PIXELS + 1)


def test_some_corners_are_kept_too_and_none_is_no_table(tmp_path):
    path = tmp_path / "corners.toml"
    some = PIXELS.copy()
    some[1:3] = np.nan
    keep_corners(path, PointedCorners("left", COURT, PIXELS))
    keep_corners(path, PointedCorners("left", COURT, some))
    (read,) = read_corners(path, [COURT])
    np.testing.assert_array_equal(read.pixels, some)
    assert not read.complete
    keep_corners(path, PointedCorners("left", COURT, np.full((4, 2), np.nan)))
    assert read_corners(path, [COURT]) == ()
    keep_corners(path, PointedCorners("left", COURT, PIXELS))
    assert len(read_corners(path, [COURT])) == 1


def test_they_lie_beside_rig_toml_and_may_be_absent(tmp_path):
    (tmp_path / "rig.toml").write_text(ROOM)
    assert read_config(tmp_path / "rig.toml").corners == ()
    (tmp_path / "corners.toml").write_text(TABLE)
    (read,) = read_config(tmp_path / "rig.toml").corners
    assert read.camera == "left"


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("[300, 200]", "[nan, 200]", r"corners.toml, line 9: top_left of rectangle 'court' in camera 'left'.*pixels"),
        ("sigma = 2", "sigma = inf", r"line 6: sigma of rectangle 'court'"),
        ("sigma = 2", "sigma = -1", r"line 6: sigma"),
        ('"court"', '"cuort"', r"line 5: .*'cuort', which is not in rig.toml; .* are court, sheet"),
        ('"court"', '"tag"', r"line 3: .*'tag' in camera 'left': it is found by its marking.*remove this table"),
        ("[300, 200]", "[300]", r"line 9: top_left"),
        ("top_left", "topleft", r"line 9: corners 1 has no key 'topleft'; allowed are .*top_left"),
        ("[[corners]]", "[[corners", r"corners.toml: this is not TOML"),
    ],
)
def test_what_is_wrong_is_one_sentence_with_its_line(tmp_path, before, after, says):
    path = tmp_path / "corners.toml"
    path.write_text(TABLE.replace(before, after, 1))
    with pytest.raises(QuadrigError, match=says) as raised:
        read_corners(path, [COURT, SHEET, TAG])
    assert "\n" not in str(raised.value)


def test_corners_given_twice_are_refused(tmp_path):
    path = tmp_path / "corners.toml"
    path.write_text(TABLE + TABLE)
    with pytest.raises(QuadrigError, match=r"line 13: .*given twice"):
        read_corners(path, [COURT])


def test_a_file_that_was_broken_by_hand_is_not_overwritten(tmp_path):
    path = tmp_path / "corners.toml"
    path.write_text("[[corners")
    with pytest.raises(QuadrigError, match="this is not TOML"):
        keep_corners(path, PointedCorners("left", COURT, PIXELS))
    assert path.read_text() == "[[corners"


def test_the_names_are_those_of_the_corners():
    for name, (x, y, _) in zip(CORNER_NAMES, COURT.corners, strict=True):
        assert name == f"{'bottom' if y > 0 else 'top'}_{'right' if x > 0 else 'left'}"


def test_nested_too_deep_is_one_sentence(tmp_path):
    (tmp_path / "corners.toml").write_text("corners = " + "[" * 5000 + "]" * 5000)
    with pytest.raises(QuadrigError, match=r"corners\.toml: lists, tables or keys are nested too deep"):
        read_corners(tmp_path / "corners.toml", [])
