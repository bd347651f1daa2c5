"""A search in which nothing can come of it ends early, and a wrong reference is refused before any."""

import cv2
import numpy as np
import pytest

from quadrig.io.config.rig_toml import parse_config
from quadrig.io.search import detections
from quadrig.io.search.effort import Effort
from quadrig.io.search.whole_recording import calibrate_searched, search_recording
from quadrig.single.errors import QuadrigError

ROOM = """
[[rectangle]]
name = "desk"
width = 0.1
height = 0.1
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 7 }
"""


@pytest.fixture
def blank(tmp_path):
    """Two hundred pictures of nothing, seven batches."""
    for number in range(200):
        cv2.imwrite(str(tmp_path / f"{number:03}.png"), np.full((48, 64), 128, np.uint8))
    return tmp_path


def test_nothing_in_images_spread_over_all_ends_the_search(blank, monkeypatch):
    monkeypatch.setattr(detections, "_PROBE", 2)
    monkeypatch.setattr(detections, "_FEW_BATCHES", 4)
    searched = search_recording(blank, parse_config(ROOM), Effort(workers=1, progress=False, rate=10.0))
    (note,) = [note for note in searched.notes if "the search stopped" in note]
    assert int(note.split()[0]) < 100
    with pytest.raises(QuadrigError, match="no rectangle was found"):
        calibrate_searched(searched)


def test_a_wrong_reference_is_refused_before_the_search(blank, monkeypatch):
    monkeypatch.setattr(detections, "_search", None)
    with pytest.raises(QuadrigError, match=r"'door'.*desk"):
        search_recording(blank, parse_config('reference = "door"\n' + ROOM), Effort(workers=1, rate=10.0))
