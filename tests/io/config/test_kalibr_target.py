"""Kalibr's own target files, named by a rig.toml."""

import pytest

from quadrig.io.config.rig_toml import config_text, parse_config, read_config
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.april_grid import AprilGridMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.circle_grid import CircleGridMarking

ROOM = """
[[rectangle]]
name = "board"
moving = true
target = "targets/board.yaml"   # measured on Monday
"""
APRILGRID = """
target_type: 'aprilgrid' #gridtype
tagCols: 6               #number of apriltags
tagRows: 5               #number of apriltags
tagSize: 0.088           #size of apriltag, edge to edge [m]
tagSpacing: 0.3          #ratio of space between tags to tagSize
                         #example: tagSize=2m, spacing=0.5m --> tagSpacing=0.25[-]
"""
CHECKERBOARD = """
target_type: checkerboard
targetCols: 6
targetRows: 7
rowSpacingMeters: 0.06
colSpacingMeters: 0.06
"""
CIRCLES = 'target_type: "circlegrid"\ntargetCols: 4\ntargetRows: 11\nspacingMeters: 0.02\nasymmetricGrid: True\n'


def room(tmp_path, target: str):
    (tmp_path / "targets").mkdir()
    (tmp_path / "targets" / "board.yaml").write_text(target)
    (tmp_path / "rig.toml").write_text(ROOM)
    return tmp_path / "rig.toml"


@pytest.mark.parametrize(
    ("target", "marking"),
    [
        (APRILGRID, AprilGridMarking(6, 5, 0.088, 0.3)),
        (CHECKERBOARD, ChessboardMarking(7, 8, 0.06)),
        (CIRCLES, CircleGridMarking(4, 11, 0.02, asymmetric=True)),
    ],
)
def test_a_target_is_read_and_the_text_stands_alone(tmp_path, target, marking):
    config = read_config(room(tmp_path, target))
    (board,) = config.rectangles
    assert board.marking == marking
    assert board.moving
    # Workers and the result keep the text, where the file is not.
    assert parse_config(config.text).rectangles == config.rectangles
    assert parse_config(config_text(config)).rectangles == config.rectangles


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("target_type: 'apriltag'\n", "board.yaml: target_type is 'apriltag'; it may be aprilgrid, checkerboard"),
        (APRILGRID.replace("tagSize", "size"), "the aprilgrid target lacks tagSize"),
        (APRILGRID.replace("0.088", "large"), "large"),
        (APRILGRID.replace("tagRows: 5", "tagRows: 500"), "has no tag"),
        (CHECKERBOARD.replace("colSpacingMeters: 0.06", "colSpacingMeters: 0.05"), "square ones only"),
    ],
)
def test_what_is_wrong_is_said_with_line_and_file(tmp_path, target, said):
    path = room(tmp_path, target)
    with pytest.raises(QuadrigError) as error:
        read_config(path)
    assert str(error.value).startswith(f"{path}, line 5: ")
    assert said in str(error.value)


def test_a_file_that_is_not_there_is_named(tmp_path):
    (tmp_path / "rig.toml").write_text(ROOM)
    with pytest.raises(QuadrigError, match=r"line 5: .*board.yaml cannot be read"):
        read_config(tmp_path / "rig.toml")


def test_a_line_that_is_no_toml_is_one_sentence(tmp_path):
    (tmp_path / "rig.toml").write_text('[[rectangle]]\nname = "board"\ntarget = "\\q.yaml"\n')
    with pytest.raises(QuadrigError, match=r"rig\.toml.*not TOML"):
        read_config(tmp_path / "rig.toml")
