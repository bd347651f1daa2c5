"""What the page of `rig pick` may ask, without a browser: corners are kept as asked, and nonsense is refused."""

import json

import cv2
import numpy as np
import pytest

from quadrig.io.config.corners_toml import read_corners
from quadrig.io.local_page import Request
from quadrig.io.pick.answers import answers
from quadrig.single.errors import QuadrigError


def asked(session, method, path, **values):
    """The JSON of an answer."""
    reply = answers(session)(Request(method, path, values))
    assert reply is not None
    return json.loads(reply.body)


def placed(session, **values):
    about = {"do": "place", "camera": "left", "rectangle": "court", "image": 0, "corner": 0, "x": 5.0, "y": 6.0}
    return asked(session, "POST", "change", **{**about, "snap": False, **values})


def test_a_picture_is_the_recording_s(session, court):
    reply = answers(session)(Request("GET", "picture", {"camera": "left", "image": "0"}))
    assert reply is not None
    shown = cv2.imdecode(np.frombuffer(reply.body, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert shown is not None
    assert shown.shape == (court.HEIGHT, court.WIDTH)


@pytest.mark.parametrize(
    "values",
    [
        {"camera": "centre"},
        {"rectangle": "pitch"},
        {"image": 1},
        {"image": -1},
        {"x": -3.0},
        {"y": 1e9},
        {"x": float("nan")},
        {"x": "left"},
        {"x": None},
        {"corner": 4},
        {"corner": -1},
        {"do": "place it"},
        {"do": "sigma", "sigma": 0},
        {"do": "sigma", "sigma": float("inf")},
    ],
)
def test_nonsense_is_refused_and_nothing_is_kept(session, values):
    with pytest.raises(QuadrigError):
        placed(session, **values)
    assert not session.path.exists()
    assert not session.done


@pytest.mark.parametrize("path", ["../rig.toml", "page.py", "session.py", "/etc/passwd", "picture/../page.js"])
def test_no_other_file_is_served(session, path):
    assert answers(session)(Request("GET", path, {})) is None


def test_undo_and_redo_go_through_all_that_was_done(session):
    places = [(100.0, 50.0), (110.0, 55.0), (120.0, 60.0)]
    for x, y in places:
        placed(session, x=x, y=y)
    seen = []
    for _ in places:
        asked(session, "POST", "change", do="undo")
        seen.append([one.pixels[0].tolist() for one in read_corners(session.path, session.rectangles)])
    assert seen == [[[110.0, 55.0]], [[100.0, 50.0]], []]
    answer = asked(session, "POST", "change", do="undo")
    assert (answer["changed"], answer["can_undo"], answer["can_redo"]) == (None, False, True)
    for _ in places:
        asked(session, "POST", "change", do="redo")
    (table,) = read_corners(session.path, session.rectangles)
    assert table.pixels[0].tolist() == [120.0, 60.0]


def test_a_moving_rectangle_has_corners_of_its_own_in_every_image(court, tmp_path, open_session):
    first, *_ = court.write(tmp_path)
    folder = tmp_path / "left"
    folder.mkdir()
    for number in range(2):
        (folder / f"{number}.png").write_bytes(first.read_bytes())
    text = court.CONFIG.replace('reference = "court"', "").split("[[rectangle]]")[1].split("world_from_rect")[0]
    (tmp_path / "rig.toml").write_text(f"[[rectangle]]{text}moving = true\n")
    session = open_session(tmp_path, [folder])
    placed(session, image=0, x=10.0)
    placed(session, image=1, x=20.0)
    read = read_corners(session.path, session.rectangles)
    assert [(one.image, one.pixels[0, 0]) for one in read] == [(0, 10.0), (1, 20.0)]
