"""What rig target puts into a rig.toml leaves all else as a person wrote it."""

from quadrig.io.config.edit_toml import with_rectangles
from quadrig.io.config.rig_toml import parse_config
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Rectangle

WRITTEN = """# our room
reference = "left"   # the one at the door

[[rectangle]]
name = "desk"        # by the window
size = "A4"
scale_sigma = 0.0005 # measured with a steel rule
marking = { kind = "plain" }

# the cameras
[[camera]]
name = "left"
"""
DESK = Rectangle("desk", 0.15, 0.15, TagMarking("apriltag_36h11", 1))
SHELF = Rectangle("shelf", 0.2, 0.2, TagMarking("apriltag_36h11", 2))


def test_a_rectangle_is_replaced_and_another_added_and_comments_stay():
    edited = with_rectangles(WRITTEN, [DESK, SHELF])
    desk, shelf = parse_config(edited).rectangles
    assert (desk.width, desk.height, desk.marking, desk.scale_sigma) == (0.15, 0.15, DESK.marking, 0.0005)
    assert shelf.marking == SHELF.marking
    for comment in ("# our room", "# the one at the door", "# by the window", "steel rule", "# the cameras"):
        assert comment in edited
    again = with_rectangles(edited, [DESK, SHELF])
    assert sorted(again.splitlines()) == sorted(edited.splitlines())


def test_a_file_without_rectangles_gets_its_first():
    assert [one.name for one in parse_config(with_rectangles("# nothing yet\n", [SHELF])).rectangles] == ["shelf"]
