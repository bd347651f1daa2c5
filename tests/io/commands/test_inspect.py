"""`rig inspect` as a command: files written whole or not at all, pictures of the recording found by their times."""

import os
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.io.rig_file.rig_mcap import write_rig
from quadrig.io.viewer.inspect.pictures import rig_pictures
from quadrig.single.errors import QuadrigError


@pytest.fixture
def rig_path(example_rig, tmp_path):
    write_rig(tmp_path / "rig.mcap", example_rig)
    return tmp_path / "rig.mcap"


@pytest.fixture
def pictures(tmp_path) -> Path:
    """Folders of twelve pictures a camera, each of one grey that encodes camera and frameset."""
    for camera in range(4):
        folder = tmp_path / "room" / f"cam{camera}"
        folder.mkdir(parents=True)
        for frameset in range(12):
            grey = np.full((720, 1280), 10 + 50 * camera + 3 * frameset, np.uint8)
            cv2.imwrite(str(folder / f"{frameset:03d}.png"), grey)
    return tmp_path / "room"


def test_a_file_for_rerun_is_written(rig_path, tmp_path, capsys):
    assert run(["inspect", str(rig_path), "--save", str(tmp_path / "x.rrd")]) == 0
    assert str(tmp_path / "x.rrd") in capsys.readouterr().err
    assert (tmp_path / "x.rrd").stat().st_size > 10_000


def vulkan_driver() -> bool:
    named = any(os.environ.get(name) for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"))
    return named or any(any(Path(root).glob("vulkan/icd.d/*.json")) for root in ("/usr/share", "/etc"))


@pytest.mark.skipif(sys.platform == "linux" and not vulkan_driver(), reason="no Vulkan driver draws here")
def test_a_picture_is_taken_without_a_screen(rig_path, tmp_path, monkeypatch):
    # The viewer's notes fade over many seconds; here they may still lie on the picture.
    monkeypatch.setattr("quadrig.io.viewer.screenshot._NOTES_SECONDS", 3.0)
    monkeypatch.setattr("quadrig.io.viewer.screenshot._SIZE", "640x400")
    assert run(["inspect", str(rig_path), "--screenshot", str(tmp_path / "x.png")]) == 0
    picture = cv2.imread(str(tmp_path / "x.png"))
    assert picture is not None
    assert picture.shape == (400, 640, 3)
    # The room is on the left: cameras in their colours stand out from its ground and its grey grid.
    room = picture[40:230, :350].astype(int)
    assert ((room.max(axis=2) - room.min(axis=2)) > 90).mean() > 0.005


def test_pictures_stand_at_their_framesets(example_rig, pictures):
    found = list(rig_pictures(example_rig, (), [pictures]))
    assert len(found) == 4 * 12
    for frameset, camera, jpeg in found[::7]:
        grey = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert grey is not None
        assert abs(int(grey.mean()) - (10 + 50 * int(camera[3:]) + 3 * frameset)) <= 1
    assert len(list(rig_pictures(example_rig, (), [pictures], most=3))) == 4 * 3


def test_pictures_go_into_the_file(rig_path, pictures, tmp_path):
    from rerun.chunk import RrdReader

    assert run(["inspect", str(rig_path), str(pictures), "--save", str(tmp_path / "x.rrd")]) == 0
    rows = 0
    for chunk in RrdReader(str(tmp_path / "x.rrd")).stream():
        if str(chunk.entity_path) == "/space/cameras/cam1/picture":
            rows += chunk.to_record_batch().num_rows
    assert rows == 12


def test_a_recording_without_the_cameras_is_one_sentence(example_rig, rig_path, tmp_path, capsys):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    cv2.imwrite(str(folder / "000.png"), np.zeros((60, 80), np.uint8))
    with pytest.raises(QuadrigError, match="cam"):
        list(rig_pictures(example_rig, (), [folder]))
    assert run(["inspect", str(rig_path), str(folder), "--save", str(tmp_path / "x.rrd")]) == 1
    caught = capsys.readouterr()
    assert "Traceback" not in caught.err
    assert not (tmp_path / "x.rrd").exists()
    assert {path.name for path in tmp_path.iterdir()} == {"rig.mcap", "elsewhere"}


def test_what_is_no_rig_is_one_sentence(tmp_path, capsys):
    (tmp_path / "x.mcap").write_bytes(b"nothing")
    assert run(["inspect", str(tmp_path / "x.mcap"), "--save", str(tmp_path / "x.rrd")]) == 1
    assert "x.mcap" in capsys.readouterr().err
    assert run(["inspect"]) == 2


def test_without_a_screen_it_says_what_to_do(rig_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    assert run(["inspect", str(rig_path)]) == 1
    assert "--web" in capsys.readouterr().err
