"""rig.toml: what is read is what was meant, what is wrong is said in one sentence, what is written is read back."""

import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from quadrig.io.config.rig_toml import RigConfig, config_text, parse_config, read_config, write_config
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.circle_grid import CircleGridMarking
from quadrig.single.markings.registry import marking_kinds, register
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Marking

ROOM = """
reference = "cam0"      # the rig frame

[[rectangle]]
name = "desk"
width = 0.297
height = 0.21
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 7 }
world_from_rect = { translation = [0, 0, 1], angles_deg = [0, 90, 0] }

[[rectangle]]
name = "board"
moving = true
marking = { kind = "charuco", columns = 4, rows = 5, square = 0.054, marker = 0.04, dictionary = "aruco_4x4_1000" }

[[rectangle]]
name = "sheet"
width = 0.21
height = 0.148
marking = { kind = "plain" }

[[camera]]
name = "cam0"
topic = "/cam0/image"
source = 0
focal = 900
distortion = [-0.1, 0.02]
lens = "full"
"""


def test_a_room_is_read_as_meant() -> None:
    config = parse_config(ROOM)
    desk, board, sheet = config.rectangles
    assert config.reference == "cam0"
    assert desk.marking == TagMarking("apriltag_36h11", 7)
    assert board.marking == CharucoMarking(4, 5, 0.054, 0.04, "aruco_4x4_1000")
    assert (board.width, board.height, board.moving) == (pytest.approx(0.216), pytest.approx(0.27), True)
    assert (sheet.width, sheet.moving) == (0.21, False)
    assert desk.body_from_rect is not None
    # Ry(90 degrees) takes the sheet's z to the world's x.
    np.testing.assert_allclose(desk.body_from_rect.transform(np.array([0.0, 0.0, 1.0])), [1, 0, 1], atol=1e-12)


def test_prior_intrinsics_reach_the_camera() -> None:
    known = parse_config(ROOM).camera_input("cam0", 1280, 720)
    assert known.intrinsics is not None
    assert known.intrinsics.focal == 900
    np.testing.assert_allclose(known.intrinsics.principal_point, [639.5, 359.5])
    np.testing.assert_allclose(known.intrinsics.distortion, [-0.1, 0.02, 0, 0, 0])
    assert known.lens == "full"
    assert parse_config(ROOM).camera_input("other", 640, 480).intrinsics is None


def test_written_and_read_back_is_the_same(tmp_path) -> None:
    config = parse_config(ROOM)
    write_config(config, tmp_path / "rig.toml")
    again = read_config(tmp_path / "rig.toml")
    assert again.rectangles == config.rectangles
    assert again.cameras[0].__dict__ == config.cameras[0].__dict__
    assert again.reference == config.reference
    np.testing.assert_allclose(_world(again), _world(config), atol=1e-12)
    assert parse_config(config_text(again)).rectangles == again.rectangles
    assert [path.name for path in tmp_path.iterdir()] == ["rig.toml"]


def _world(config: RigConfig) -> np.ndarray:
    pose = config.rectangles[0].body_from_rect
    assert pose is not None
    return pose.matrix()


WRONG = {
    "unknown key": ("moving = true", "movin = true", ["line 13", "movin", "moving"]),
    "unknown key of a marking": ("id = 7", "id = 7, foo = 1", ["line 8", "foo", "dictionary"]),
    "unknown top key": ("reference", "refference", ["line 2", "refference", "reference"]),
    "negative width": ("width = 0.297", "width = -0.297", ["line 6", "desk", "-0.297"]),
    "width that is no number": ("0.297", "'wide'", ["line 6", "width", "no length"]),
    "endless height": ("height = 0.21\n", "height = inf\n", ["line 7", "desk", "inf"]),
    "no height": ("height = 0.21\n", "", ["desk", "height"]),
    "unknown kind": ('"charuco"', '"charuca"', ["line 14", "charuca", "chessboard"]),
    "unknown dictionary": ("apriltag_36h11", "apriltag_36h12", ["line 8", "desk", "apriltag_36h12"]),
    "a tag that is not": ("id = 7", "id = 999", ["line 8", "desk", "999"]),
    "no kind": ('kind = "charuco", ', "", ["line 14", "kind"]),
    "half a square": ("columns = 4", "columns = 4.5", ["line 14", "columns", "whole"]),
    "tag as large as its square": ("marker = 0.04", "marker = 0.06", ["line 14", "marker"]),
    "width against the board": ("moving = true", "width = 0.3", ["line 13", "0.216"]),
    "unknown lens": ('"full"', '"fill"', ["line 28", "fill", "auto"]),
    "a name twice": ('"sheet"', '"desk"', ["line 17", "desk"]),
    "reference nowhere": ('reference = "cam0"', 'reference = "cam9"', ["line 2", "cam9", "cam0"]),
    "reference that moves": ('reference = "cam0"', 'reference = "board"', ["line 2", "board", "moves"]),
    "prior without focal": ("focal = 900\n", "", ["cam0", "focal"]),
    "two rotations": ("angles_deg", "quaternion_xyzw = [0, 0, 0, 1], angles_deg", ["line 9", "angles_deg"]),
    "no number": ("angles_deg = [0", "angles_deg = [nan", ["line 9", "nan, which is no pose"]),
    "beyond the moon": ("angles_deg = [0", "angles_deg = [1e300", ["line 9", "1e+300, which is no pose"]),
    "a topic twice": (
        "[[camera]]",
        '[[camera]]\nname = "cam1"\ntopic = "/cam0/image"\n\n[[camera]]',
        ["line 28", "'cam1' and 'cam0' have the same topic"],
    ),
    "a key of two lines": ("reference", '"a\\nb"', [r"has no key 'a\nb'"]),
    "digits without end": ("0.297", "9" * 5000, ["a number has thousands of digits"]),
    "not TOML": ("[[camera]]", "[[camera]", ["not TOML", "line 22"]),
    "no rectangle": (ROOM, "reference = 'cam0'", ["[[rectangle]]"]),
}


def test_cameras_without_a_table_may_be_the_reference_where_no_table_names_a_topic() -> None:
    text = ROOM.replace('topic = "/cam0/image"\n', "").replace('reference = "cam0"', 'reference = "cam3"')
    assert parse_config(text).reference == "cam3"


def test_utf8_is_read_with_and_without_its_mark_and_another_coding_is_named(tmp_path) -> None:
    path = tmp_path / "rig.toml"
    for coding in ("utf-8", "utf-8-sig"):
        path.write_text(ROOM, encoding=coding)
        assert read_config(path).text == ROOM
    path.write_text(ROOM, encoding="utf-16")
    with pytest.raises(QuadrigError, match=r"rig\.toml: .*save it as UTF-8"):
        read_config(path)


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said_in_one_sentence(name: str) -> None:
    right, wrong, words = WRONG[name]
    assert right in ROOM
    with pytest.raises(QuadrigError) as caught:
        parse_config(ROOM.replace(right, wrong), "room.toml")
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("room.toml")
    for word in words:
        assert word in message


def test_lengths_may_have_their_unit() -> None:
    text = """
[[rectangle]]
name = "desk"
width = "16cm"
height = "160mm"
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 1 }
world_from_rect = { translation = ["1m", -0.2, "-3in"], angles_deg = [0, 0, 0] }
[[rectangle]]
name = "board"
marking = { kind = "circles", columns = 7, rows = 6, spacing = "3in", diameter = "2in" }
"""
    desk, board = parse_config(text).rectangles
    assert (desk.width, desk.height, board.marking) == (0.16, 0.16, CircleGridMarking(7, 6, 0.0762, 0.0508))
    assert desk.body_from_rect is not None
    assert desk.body_from_rect.translation.tolist() == [1.0, -0.2, -0.0762]
    for wrong, words in (('"160"', "'160' has no unit"), ('"wide"', "no length"), ("true", "expected a length")):
        with pytest.raises(QuadrigError, match=f"line 4: width in rectangle 1: .*{words}"):
            parse_config(text.replace('"16cm"', wrong))


def test_a_line_time_has_its_unit_or_is_of_seconds() -> None:
    text = """
[[rectangle]]
name = "desk"
size = "A4"
marking = { kind = "plain" }
[[camera]]
name = "cam0"
line_time = LINE
"""
    for given, seconds in (('"20us"', 2e-5), ('"0.02 ms"', 2e-5), ("2e-5", 2e-5), ("0", 0.0), ('"-15µs"', -1.5e-5)):
        config = parse_config(text.replace("LINE", given))
        assert config.cameras[0].line_time == seconds
        assert parse_config(config_text(config)).cameras[0].line_time == seconds
        assert config.camera_input("cam0", 640, 480).line_time == config.cameras[0].line_time
    assert parse_config(text.replace("line_time = LINE", "")).cameras[0].line_time is None
    wrong = {
        "20": "20 s is no camera's",
        '"20"': "no time with its unit",
        '"20mm"': "no time",
        "true": "expected a time",
    }
    for given, words in (wrong | {"nan": "nan s is no camera's", '"33ms"': "no camera's"}).items():
        with pytest.raises(QuadrigError, match=f"line 8: line_time in camera 1: .*{words}"):
            parse_config(text.replace("LINE", given))


def test_a_file_that_is_not_there_is_named(tmp_path) -> None:
    with pytest.raises(QuadrigError, match=r"nowhere\.toml"):
        read_config(tmp_path / "nowhere.toml")
    with pytest.raises(QuadrigError, match="cannot be read"):
        read_config(tmp_path)


def test_a_kind_of_marking_from_outside_is_read_and_written(monkeypatch) -> None:
    # Other tests hold the kinds against what is written of them.
    monkeypatch.setattr("quadrig.single.markings.registry._KINDS", {**marking_kinds()})

    @register
    @dataclass(frozen=True)
    class Crosses(Marking):
        count: int
        arm: float = 0.01

        kind: ClassVar[str] = "crosses"

    text = '[[rectangle]]\nname = "r"\nwidth = 0.2\nheight = 0.1\nmarking = { kind = "crosses", count = 3 }\n'
    (rectangle,) = parse_config(text).rectangles
    assert rectangle.marking == Crosses(3)
    assert config_text(parse_config(text)) == text
    with pytest.raises(QuadrigError, match=r"line 5.*count"):
        parse_config(text.replace("count = 3", "count = 'three'"))
    with pytest.raises(QuadrigError, match=r"line 5.*legs.*count, arm"):
        parse_config(text.replace("count = 3", "count = 3, legs = 2"))


@pytest.mark.parametrize(
    "text",
    [
        "x = " + "[" * 5000 + "]" * 5000,
        "x = " + "{a=" * 5000 + "1" + "}" * 5000,
        "a." * 45000 + "b = 1",
        "[" + "'a' . " * 45000 + "b]",
    ],
)
def test_nested_too_deep_is_one_sentence(text):
    with pytest.raises(QuadrigError, match="lists, tables or keys are nested too deep"):
        parse_config(text)


def test_ten_thousand_rectangles_take_no_time():
    table = '[[rectangle]]\nname = "r{}"\nwidth = 0.1\nheight = 0.1\nmarking = {{ kind = "points" }}\n'
    began = time.process_time()
    assert len(parse_config("".join(table.format(k) for k in range(10_000))).rectangles) == 10_000
    assert time.process_time() - began < 2
    with pytest.raises(QuadrigError, match="line 49997: two rectangles are called 'r0'"):
        parse_config("".join(table.format(k % 9999) for k in range(10_000)))


@pytest.mark.parametrize(
    "marking",
    [
        '{ kind = "chessboard", columns = 2000000000, rows = 2000000000, square = 0.01 }',
        '{ kind = "charuco", columns = 2000, rows = 2000, square = 0.1, marker = 0.07, dictionary = "aruco_4x4_50" }',
        '{ kind = "chessboard", columns = 2, rows = ' + "9" * 5000 + ", square = 0.01 }",
    ],
)  # fmt: skip
def test_absurd_boards_are_one_sentence(marking):
    with pytest.raises(QuadrigError, match=r"squares fit on no sheet|this is not TOML"):
        parse_config(f'[[rectangle]]\nname = "board"\nmarking = {marking}\n')


BOX = """
[[body]]
name = "box"
moving = true

[[rectangle]]
name = "front"
width = 0.1
height = 0.1
body = "box"
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 1 }

[[rectangle]]
name = "back"
width = 0.1
height = 0.1
body = "box"
body_from_rect = { translation = [0, 0, 0.2], angles_deg = [0, 180, 0], sigma = 0.001, sigma_deg = 0.5 }
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 2 }
"""


def test_rectangles_of_a_body_move_as_it_does(tmp_path) -> None:
    config = parse_config(BOX)
    front, back = config.rectangles
    assert front.moving
    assert back.moving
    assert back.body == front.body == "box"
    assert back.layout_sigma == pytest.approx((np.radians(0.5), 0.001))
    assert back.body_from_rect is not None
    np.testing.assert_allclose(back.body_from_rect.transform(np.array([1.0, 0, 0])), [-1, 0, 0.2], atol=1e-12)
    write_config(config, tmp_path / "rig.toml")
    again = read_config(tmp_path / "rig.toml")
    assert again.rectangles == config.rectangles
    assert again.rectangles[1].body_from_rect is not None
    np.testing.assert_allclose(again.rectangles[1].body_from_rect.matrix(), back.body_from_rect.matrix(), atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('name = "box"\nmoving', 'name = "case"\nmoving', "line 3: no rectangle stands on body 'case'"),
        (BOX[BOX.rindex("[[rectangle]]") :], "", "body 'box' has one rectangle, 'front'"),
        ('body = "box"\nbody_from', 'world_from_rect = { translation = [0, 0, 0], angles_deg = [0, 0, 0] }\n'
         'body = "box"\nbody_from', "'back' is of two bodies, 'box' and the world"),
        ('body = "box"\nbody_from', "body_from", "'back' has body_from_rect and no body"),
        ("angles_deg = [0, 180, 0]", "angles_deg = [0, 180, 0], quaternion_xyzw = [0, 1, 0, 0]", ""),
        ("angles_deg = [0, 180, 0]", "angles_deg = [0, 180, 0], quaternion_xyzw = [1, 0, 0, 0]",
         "given twice, by angles_deg and by quaternion_xyzw, and they are 180 degrees apart"),
        ('body = "box"\nbody_from', 'world_from_rect = { translation = [0, 0, 1], angles_deg = [0, 0, 0] }\n'
         'body = "world"\nbody_from', "two poses on the world"),
    ],
)  # fmt: skip
def test_bodies_that_cannot_be_are_named(old, new, sentence) -> None:
    assert old in BOX
    if not sentence:
        parse_config(BOX.replace(old, new))
        return
    with pytest.raises(QuadrigError, match=sentence):
        parse_config(BOX.replace(old, new))


def test_a_rectangle_holds_plain_numbers() -> None:
    """What reads lengths with units stays in this file: results are written by who knows floats alone."""
    (rectangle,) = parse_config(
        '[[rectangle]]\nname = "court"\nsize = "A4"\nmarking = { kind = "points" }\n'
        'world_from_rect = { translation = [0, "5cm", 0], angles_deg = [0, 0, 0], sigma = "1mm" }\n'
    ).rectangles
    assert {type(value) for value in (rectangle.width, rectangle.height, *rectangle.layout_sigma)} == {float}
    assert rectangle.layout_sigma[1] == 0.001
