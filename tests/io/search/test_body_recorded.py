"""Bodies from recordings: real corners by way of pictures, framesets and search, and a real video of a wall."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import ClassVar

import cv2
import numpy as np
import pytest

from quadrig.io.config.rig_toml import parse_config
from quadrig.io.search.effort import Effort
from quadrig.io.search.whole_recording import calibrate_recording, calibrate_searched, search_recording
from quadrig.single.markings.registry import marking_kinds, register
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Marking
from quadrig.single.view import View

CUBE = """
[[body]]
name = "cube"
moving = true

[[camera]]
name = "wide"
model = "fisheye"
focal = 350

""" + "\n".join(
    f"""[[rectangle]]
name = "board{board}"
width = 0.6
height = 0.6
body = "cube"
marking = {{ kind = "published", board = {board} }}
"""
    for board in range(5)
)
WALL = """
[[body]]
name = "wall"
moving = true

""" + "\n".join(
    f"""[[rectangle]]
name = "tag{number}"
width = 0.1651
height = 0.1651
body = "wall"
marking = {{ kind = "tag", dictionary = "apriltag_36h11", id = {number} }}
"""
    for number in (3, 4)
)


@pytest.fixture
def cube(load_script, shared_data, tmp_path, monkeypatch):
    """The folder of a recording whose pictures say their number, a marking whose corners are those that were
    published of that picture, and the benchmark that reads them."""
    wide, folder = load_script("benchmarks/wide.py"), shared_data / "cube"

    @cache
    def published() -> Mapping[tuple[int, str], View]:
        return {(view.frameset, view.rectangle): view for view in wide.views(folder, "train")}

    @dataclass(frozen=True)
    class Published(Marking):
        """A board whose corners somebody else has found."""

        board: int

        kind: ClassVar[str] = "published"

        @property
        def marks(self):
            return frozenset({("published", self.board)})

        def find(self, grey, rectangle, _found, /):
            return published().get((int(grey[0, 0]), rectangle.name))

    monkeypatch.setattr("quadrig.single.markings.registry._KINDS", {**marking_kinds()})
    register(Published)
    pictures = tmp_path / "wide"
    pictures.mkdir()
    width, height = wide.SIZE
    for number in sorted({number for number, _ in published()}):
        cv2.imwrite(str(pictures / f"{number:04d}.png"), np.full((height, width), number, np.uint8))
    return pictures, wide, folder


def test_boards_of_a_real_body_stand_where_another_tool_has_them(cube):
    """As rectangles of a rig.toml in a recording: as near as the same corners are in Python."""
    pictures, wide, folder = cube
    rig = calibrate_recording(pictures, parse_config(CUBE), Effort(workers=1))
    (body,) = rig.bodies
    boards = wide.boards(folder)
    placed = {
        number: pose @ Pose(np.eye(3), boards[number][1]) for number, pose in wide.body_from_boards(folder).items()
    }
    assert len({fit.view.frameset for fit in rig.fits}) == len(list(pictures.iterdir()))
    for number in (1, 2, 4):
        found, covariance = body.rect_from_other("board0", f"board{number}")
        step = found.step_to(placed[0].inverse() @ placed[number])
        # A few tenths of a millimetre and a twentieth of a degree is what the other tool is good for.
        assert np.linalg.norm(step[3:]) < 1e-3
        assert np.degrees(np.linalg.norm(step[:3])) < 0.07
        assert np.sqrt(np.diag(covariance)[3:]).max() < 1e-3


def apart(three: View, four: View) -> float:
    """The distance (m) of the middles of two tags of one wall, by the plane of the first and no lens at all."""
    plane, _ = cv2.findHomography(three.pixels, three.points[:, :2])
    assert plane is not None
    there = cv2.perspectiveTransform(four.pixels[None], plane)[0]
    return float(np.linalg.norm(there.mean(axis=0)))


def test_tags_of_a_real_wall_are_as_far_apart_as_its_pictures_show(shared_data):
    """Of a video of one camera. Nominally they are 0.565 m apart; the pictures say otherwise, without a lens too."""
    video = Path(shared_data / "field" / "walk.mp4")
    searched = search_recording(video, parse_config(WALL), Effort(share=0.06, workers=1))
    rig = calibrate_searched(searched)
    (wall,) = rig.bodies
    found, covariance = wall.rect_from_other("tag3", "tag4")
    distance = float(np.linalg.norm(found.translation))
    way = found.translation / distance
    sigma = float(np.sqrt(way @ covariance[3:, 3:] @ way))
    by_frame: dict[int, dict[str, View]] = {}
    for fit in rig.fits:
        by_frame.setdefault(fit.view.frameset, {})[fit.view.rectangle] = fit.view
    plain = float(np.median([apart(own["tag3"], own["tag4"]) for own in by_frame.values() if len(own) == 2]))
    # Four corners of one tag, carried on over three tags' widths without a lens: good to some per cent.
    assert abs(distance - plain) < 3 * sigma + 0.03 * plain
    assert sigma < 0.02
    assert distance + 3 * sigma < 0.565
    assert plain < 0.54
    # They hang on one wall.
    assert found.rotation[2, 2] > np.cos(np.radians(5))
