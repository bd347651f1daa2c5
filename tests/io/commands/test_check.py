"""`rig check` as a command: exit codes, JSON, and one sentence for each failure."""

import json
from dataclasses import replace

import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.io.formats.registry import export_files
from quadrig.io.rig_file.rig_mcap import write_rig
from quadrig.rig.moved import find_moved


@pytest.fixture
def looked(monkeypatch, example):
    """Lets Views stand for a recording, so that a check needs no pictures."""
    from quadrig.io.commands import check as check_command

    rectangles = tuple(placed.rectangle for placed in example[0].rectangles)

    def with_views(views):
        monkeypatch.setattr(
            check_command,
            "views_of",
            lambda _held, _paths, _most: (rectangles, list(views)),
        )

    return with_views


def new_views(example, moved=None):
    """Views of the example's truth again, one camera elsewhere."""
    rig, cameras, rectangles = example
    rng = np.random.default_rng(7)
    placed = {one.name: one for one in rectangles}
    views = []
    for fit in rig.fits:
        view = fit.view
        camera = next(one for one in cameras if one.name == view.camera)
        rectangle = placed[view.rectangle]
        pose = rectangle.rig_from_rect[view.frameset] if rectangle.rectangle.moving else rectangle.rig_from_rect
        rig_from_camera = camera.rig_from_camera
        if view.camera == moved:
            rig_from_camera = rig_from_camera.retract(np.array([0.004, 0.01, 0, 0.03, 0, -0.02]))
        pixels = camera.intrinsics.project((rig_from_camera.inverse() @ pose).transform(view.points))
        views.append(replace(view, pixels=pixels + rng.normal(0, rig.noise, pixels.shape)))
    return views


@pytest.fixture
def rig_path(example_rig, tmp_path):
    write_rig(tmp_path / "rig.mcap", example_rig)
    return tmp_path / "rig.mcap"


def test_a_rig_of_another_program_is_measured_and_not_judged(example, looked, tmp_path, capsys):
    rig = example[0]
    for name, text in export_files(rig, "colmap").items():
        (tmp_path / name).write_text(str(text))
    looked(new_views(example))
    assert run(["check", str(tmp_path), "night.mcap"]) == 1
    said = capsys.readouterr()
    assert said.out.count("cannot tell: the rig does not say how sure it is") == len(rig.cameras)
    assert "cannot be determined" in said.err


def test_rectangles_that_the_file_does_not_hold_are_asked_for(example_rig, tmp_path, capsys):
    (tmp_path / "rig.yml").write_text(str(export_files(example_rig, "opencv")["rig.yml"]))
    assert run(["check", str(tmp_path / "rig.yml"), str(tmp_path)]) == 1
    assert "--config" in capsys.readouterr().err


def test_an_unmoved_rig_leaves_with_zero(example, rig_path, looked, capsys):
    looked(new_views(example))
    assert run(["check", str(rig_path), "night.mcap", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["moved"] == []
    assert {one["state"] for one in answer["cameras"].values()} == {"unmoved"}


def test_a_moved_camera_leaves_with_three(example, rig_path, looked, capsys):
    looked(new_views(example, "cam2"))
    assert run(["check", str(rig_path), "night.mcap", "--json"]) == 3
    answer = json.loads(capsys.readouterr().out)
    assert answer["moved"] == ["cam2"]
    assert answer["cameras"]["cam2"]["shift_mm"] == pytest.approx(1e3 * np.hypot(0.03, 0.02), rel=0.2)
    assert run(["check", str(rig_path), "night.mcap"]) == 3
    assert "cam2: moved by" in capsys.readouterr().out


def test_where_nothing_can_be_told_it_says_so(rig_path, looked, capsys):
    looked([])
    assert run(["check", str(rig_path), "night.mcap"]) == 1
    caught = capsys.readouterr()
    assert "cannot be determined" in caught.err
    assert "Traceback" not in caught.err


def test_the_command_and_the_function_agree(example, rig_path, looked, capsys):
    rig, _, rectangles = example
    views = new_views(example, "cam1")
    looked(views)
    assert run(["check", str(rig_path), "night.mcap", "--json"]) == 3
    answer = json.loads(capsys.readouterr().out)["cameras"]
    for move in find_moved(rig, [placed.rectangle for placed in rectangles], views):
        assert answer[move.name]["state"] == move.state
        assert answer[move.name]["shift_mm"] == pytest.approx(1e3 * move.shift)


def test_a_recording_of_other_cameras_is_one_sentence(rig_path, tmp_path, capsys):
    import cv2

    folder = tmp_path / "other"
    folder.mkdir()
    cv2.imwrite(str(folder / "0.png"), np.zeros((60, 80), np.uint8))
    assert run(["check", str(rig_path), str(folder)]) == 1
    assert "its cameras are other" in capsys.readouterr().err
    (tmp_path / "cam0").mkdir()
    cv2.imwrite(str(tmp_path / "cam0" / "0.png"), np.zeros((60, 80), np.uint8))
    assert run(["check", str(rig_path), str(tmp_path / "cam0")]) == 1
    assert "80x60" in capsys.readouterr().err
