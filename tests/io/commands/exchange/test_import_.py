"""`rig import`, and the commands that read a rig of any format."""

import json

import numpy as np

from quadrig.io.commands.main import run
from quadrig.io.formats.registry import export_files
from quadrig.io.rig_file.rig_mcap import read_rig, write_rig


def written(folder, rig, form):
    for name, text in export_files(rig, form).items():
        (folder / name).write_text(text)
    return [str(folder / name) for name in export_files(rig, form)]


def test_a_rig_of_another_program_becomes_a_rig_mcap(example_rig, tmp_path, capsys):
    [path] = written(tmp_path, example_rig, "kalibr")
    output = tmp_path / "rig.mcap"
    assert run(["import", path, "-o", str(output)]) == 0
    said = capsys.readouterr()
    assert said.out == f"{output}: 4 cameras in the frame of cam0\n"
    assert "how sure" in said.err
    again = read_rig(output)
    assert [camera.name for camera in again.cameras] == [camera.name for camera in example_rig.cameras]
    assert np.isnan(again.focal_sigma("cam0"))


def test_what_is_not_known_is_said_as_such(example_rig, tmp_path, capsys):
    [path] = written(tmp_path, example_rig, "opencv")
    output, page = tmp_path / "rig.mcap", tmp_path / "rig.html"
    assert run(["import", path, "-o", str(output)]) == 0
    capsys.readouterr()
    assert run(["info", str(output)]) == 0
    assert "unknown" in capsys.readouterr().out
    assert run(["info", str(output), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["cameras"]["cam1"]["sigma"]["position_m"] is None
    assert run(["report", str(output), "-o", str(page)]) == 0
    assert "does not state it" in page.read_text()
    assert run(["inspect", str(output), "--save", str(tmp_path / "rig.rrd")]) == 0


def test_the_unit_is_asked_for_and_taken(example_rig, tmp_path, capsys):
    paths = written(tmp_path, example_rig, "colmap")
    for path in paths:
        if path.endswith("cameras.txt"):
            text = (tmp_path / "cameras.txt").read_text()
            (tmp_path / "cameras.txt").write_text(text.split("\n", 1)[1])
    output = tmp_path / "rig.mcap"
    assert run(["import", str(tmp_path), "-o", str(output)]) == 1
    assert "--unit" in capsys.readouterr().err
    assert not output.exists()
    assert run(["import", str(tmp_path), "-o", str(output), "--unit", "cm"]) == 0
    shift = read_rig(output).camera("cam1").rig_from_camera.translation
    np.testing.assert_allclose(shift, 0.01 * example_rig.camera("cam1").rig_from_camera.translation)


def test_compare_takes_any_format_and_says_what_it_cannot(example_rig, tmp_path, capsys):
    write_rig(tmp_path / "rig.mcap", example_rig)
    [path] = written(tmp_path, example_rig, "opencv")
    assert run(["compare", str(tmp_path / "rig.mcap"), path]) == 0
    said = capsys.readouterr().out
    assert "cannot be said" in said
    assert "agree within" not in said
    assert run(["compare", str(tmp_path / "rig.mcap"), path, "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["chance"] is None
    assert max(camera["shift_mm"] for camera in values["cameras"].values()) < 1e-9
    assert run(["compare", str(tmp_path / "rig.mcap"), path, "--save", str(tmp_path / "both.rrd")]) == 0
