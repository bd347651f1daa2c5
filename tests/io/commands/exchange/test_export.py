"""`rig export`: which format, where to, and what is said."""

import json

import pytest

from quadrig.io.commands.main import run
from quadrig.io.formats.any_file import read_any_rig
from quadrig.io.formats.registry import FORMATS
from quadrig.io.rig_file.rig_mcap import write_rig

WRITTEN = [name for name, form in FORMATS.items() if form.write is not None]


@pytest.fixture
def rig(example_rig, tmp_path):
    write_rig(tmp_path / "rig.mcap", example_rig)
    return str(tmp_path / "rig.mcap")


@pytest.mark.parametrize("form", [name for name in WRITTEN if name not in ("maps", "ffmpeg")])
def test_every_format_is_written(form, rig, tmp_path, capsys):
    output = tmp_path / "out"
    assert run(["export", rig, "--undistorted", "--format", form, "-o", str(output)]) == 0
    written = capsys.readouterr().out.split()
    assert written
    assert all((tmp_path / name).stat().st_size for name in written)


@pytest.mark.parametrize(
    ("name", "form"),
    [("a.json", "json"), ("a.yml", "opencv"), ("a.yaml", "kalibr"), ("a.urdf", "urdf"), ("Calib.toml", "pose2sim"),
     ("transforms.json", "nerfstudio"), ("camera_array.toml", "caliscope"), ("a.launch.xml", "tf"),
     ("a.xml", "opencv-xml"), ("a.usda", "usd"), ("a.py", "blender")],
)  # fmt: skip
def test_the_suffix_says_the_format(name, form, rig, tmp_path):
    by_suffix, by_name = tmp_path / "one", tmp_path / "two"
    by_suffix.mkdir()
    by_name.mkdir()
    assert run(["export", rig, "--undistorted", "-o", str(by_suffix / name)]) == 0
    assert run(["export", rig, "--undistorted", "--format", form, "-o", str(by_name / name)]) == 0
    assert (by_suffix / name).read_bytes() == (by_name / name).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["-o", "a.toml"], "may be anipose, freemocap, pose2sim, caliscope"),
        (["-o", "a.png"], "its suffix says no format"),
        (["-f", "kalibr", "-o", "a.json"], "a kalibr file ends in .yaml or .yml"),
        (["-f", "colmap"], "name a folder with -o"),
        (["-f", "usd", "-o", "a.usda"], "--undistorted"),
        (["-o", "nowhere/a.json"], "there is no folder"),
    ],
)
def test_what_is_wrong_is_one_sentence_and_nothing_is_written(
    arguments, sentence, rig, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    assert run(["export", rig, *arguments]) == 1
    said = capsys.readouterr().err
    assert sentence in said
    assert len(said.splitlines()) == 1
    assert sorted(tmp_path.iterdir()) == before


def test_of_several_files_all_are_written_or_none(rig, tmp_path, capsys):
    (tmp_path / "lenses" / "cam2.yaml").mkdir(parents=True)
    assert run(["export", rig, "-f", "ros", "-o", str(tmp_path / "lenses")]) == 1
    assert "is a folder" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "lenses").iterdir()] == ["cam2.yaml"]


def test_a_format_that_is_none_is_wrong_usage(rig, tmp_path, capsys):
    assert run(["export", rig, "--format", "word"]) == 2
    assert run(["export", str(tmp_path / "absent.mcap")]) == 1
    assert "Traceback" not in capsys.readouterr().err


def test_names_that_are_changed_are_said(rig, tmp_path, capsys):
    assert run(["export", rig, "-o", str(tmp_path / "camera_array.toml")]) == 0
    said = capsys.readouterr().err.splitlines()
    assert said[1] == "note: caliscope cannot hold the name 'cam1': it is '1' there"
    assert len(said) == 4


def test_the_list_says_of_every_format_what_it_loses(capsys):
    assert run(["export", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == WRITTEN
    assert all("without " in line for line in lines)


def test_the_schema_is_shown(capsys):
    assert run(["export", "--schema"]) == 0
    assert "$defs" in json.loads(capsys.readouterr().out)


def test_a_base_frame_carries_the_rig(rig, example_rig, tmp_path):
    lenses, frames = str(tmp_path / "lenses"), str(tmp_path / "rig.urdf")
    assert run(["export", rig, "-f", "ros", "-o", lenses]) == 0
    assert run(["export", rig, "-o", frames, "--base", "base_link", "--base-from-rig", "1 200cm 3m 0 0 90"]) == 0
    again = read_any_rig(*sorted((tmp_path / "lenses").iterdir()), frames)
    assert again.reference == "base_link"
    x, y, z = example_rig.camera("cam1").rig_from_camera.translation
    assert again.camera("cam1").rig_from_camera.translation == pytest.approx([1 - y, 2 + x, 3 + z])
