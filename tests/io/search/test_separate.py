"""Which paths are one recording."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.io.search.separate import separate_recordings


@pytest.fixture
def folders(tmp_path):
    for recording in ("boards", "scene"):
        for camera in ("left", "right"):
            (tmp_path / recording / camera).mkdir(parents=True)
            for number in range(2):
                picture = np.full((12, 16), 40 * number, np.uint8)
                cv2.imwrite(str(tmp_path / recording / camera / f"{number}.png"), picture)
    return tmp_path


def test_a_camera_that_comes_again_is_another_recording(folders):
    boards, scene = folders / "boards", folders / "scene"
    assert separate_recordings([boards, scene], 1.0) == [[boards], [scene]]
    assert separate_recordings([boards / "left", scene], 1.0) == [[boards / "left"], [scene]]


def test_different_cameras_are_one_recording(folders):
    paths = [folders / "boards" / "left", folders / "boards" / "right"]
    assert separate_recordings(paths, 1.0) == [paths]
    assert separate_recordings(str(paths[0]), 1.0) == [[paths[0]]]


def test_what_cannot_be_opened_is_left_to_who_opens_it(folders):
    assert separate_recordings([Path("nowhere"), folders / "scene"], 1.0) == [[Path("nowhere"), folders / "scene"]]
