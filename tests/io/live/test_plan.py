"""All of a rig.toml is checked before a session's first picture."""

import pytest

from quadrig.io.config.rig_toml import parse_config
from quadrig.io.live.plan import check_plan
from quadrig.single.errors import QuadrigError

DESK = """[[rectangle]]
name = "desk"
width = 0.2
height = 0.2
marking = {{ kind = "{}" }}
"""


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('reference = "hall"\n' + DESK.format("plain"), "reference is 'hall', which is none of left, right, desk"),
        (DESK.format("points"), "only rectangles whose corners are given by hand"),
    ],
)
def test_what_comes_to_nothing_is_refused(text, words):
    with pytest.raises(QuadrigError, match=words):
        check_plan(parse_config(text), ["left", "right"])


def test_what_is_not_used_is_said():
    text = DESK.format("plain") + DESK.format("points").replace("desk", "door") + '[[camera]]\nname = "hall"\n'
    notes = check_plan(parse_config(text), ["left", "right"])
    assert len(notes) == 2
    assert "door" in notes[0]
    assert "hall" in notes[1]
    assert check_plan(parse_config('reference = "left"\n' + DESK.format("plain")), ["left"]) == ()
