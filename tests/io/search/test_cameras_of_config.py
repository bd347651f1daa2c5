"""Which cameras of a recording are used where rig.toml has tables for some of them."""

import cv2
import pytest

from quadrig.io.config.rig_toml import parse_config
from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.io.search.effort import Effort
from quadrig.io.search.whole_recording import search_recording
from quadrig.single.errors import QuadrigError

SHEET = """
[[rectangle]]
name = "tag"
width = 0.1
height = 0.1
marking = { kind = "tag", dictionary = "aruco_4x4_50", id = 7 }
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory, pictures):
    folder = tmp_path_factory.mktemp("three")
    for camera in ("left", "middle", "right"):
        (folder / camera).mkdir()
        for k in range(2):
            cv2.imwrite(str(folder / camera / f"{k}.png"), pictures.picture(k))
    return folder


def searched(recording, tables):
    return search_recording(recording, parse_config(SHEET + tables), Effort(workers=1, progress=False))


def test_a_table_that_only_knows_a_lens_drops_nobody(recording):
    found = searched(recording, '[[camera]]\nname = "left"\nfocal = 100.0\n')
    assert [camera.name for camera in found.cameras] == ["left", "middle", "right"]
    focals = [camera.intrinsics.focal if camera.intrinsics else None for camera in found.cameras]
    assert focals == [100.0, None, None]
    assert (
        "rig.toml has no [[camera]] for middle, right: used all the same, with nothing known beforehand"
        in found.notes
    )


def test_tables_with_topics_choose_and_say_whom_they_left_out(recording):
    found = searched(recording, '[[camera]]\nname = "eye"\ntopic = "right"\n')
    assert [camera.name for camera in found.cameras] == ["eye"]
    assert "not asked for, and left out: left, middle; name them in a [[camera]] to use them" in found.notes


def test_a_table_for_a_camera_that_is_not_there_is_an_error(recording):
    with pytest.raises(QuadrigError, match="no topic for camera 'front'; the images are on"):
        searched(recording, '[[camera]]\nname = "front"\nfocal = 100.0\n')


def test_pictures_by_number_have_no_clock(recording):
    assert all(not camera.source.timed for camera in open_recording(recording).cameras)
    assert searched(recording, "").times == [0, 10**9]


@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_longer_lists_of_opencv_are_read_where_the_rest_is_zero(count):
    values = [-0.2, 0.05, 0.001, -0.001, 0.01][:count] + [0.0] * (count - 5)
    table = f'[[camera]]\nname = "left"\nfocal = 100.0\ndistortion = {values}\n'
    (camera,) = parse_config(SHEET + table).cameras
    assert list(camera.distortion) == values[:5]
    if count > 5:
        values[6] = 0.3
        with pytest.raises(QuadrigError, match=r"line 10: camera 'left' has \d+ coefficients, but the lenses here"):
            parse_config(SHEET + f'[[camera]]\nname = "left"\nfocal = 100.0\ndistortion = {values}\n')
