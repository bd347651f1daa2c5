"""`rig compare` as a command: differences beside their sigmas, and one sentence for each failure."""

import json
from dataclasses import replace

import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.io.rig_file.rig_mcap import write_rig
from quadrig.single.pose import Pose


@pytest.fixture
def rig_path(example_rig, tmp_path):
    write_rig(tmp_path / "rig.mcap", example_rig)
    return tmp_path / "rig.mcap"


def test_compare_shows_differences_beside_sigmas(example_rig, rig_path, tmp_path, capsys):
    last = example_rig.cameras[3]
    moved = replace(last, rig_from_camera=last.rig_from_camera.retract(np.array([0, 0.02, 0, 0.1, 0, 0])))
    write_rig(tmp_path / "b.mcap", replace(example_rig, cameras=(*example_rig.cameras[:3], moved)))
    arguments = ["compare", str(rig_path), str(tmp_path / "b.mcap")]
    assert run([*arguments, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    sigmas = {name: one["sigmas"] for name, one in answer["cameras"].items()}
    assert max(sigmas, key=lambda name: sigmas[name]) == "cam3"
    assert answer["chance"] < 0.01
    assert np.shape(answer["a_from_b"]) == (4, 4)
    assert run([*arguments, "--save", str(tmp_path / "c.rrd")]) == 0
    assert "differ by more than their sigmas allow" in capsys.readouterr().out
    assert _entities(tmp_path / "c.rrd") >= {"/space/first/cam3", "/space/second/cam3", "/space/shifts", "/summary"}


def test_rigs_without_shared_cameras_are_one_sentence(example_rig, rig_path, tmp_path, capsys):
    others = tuple(replace(camera, name=f"other{i}") for i, camera in enumerate(example_rig.cameras))
    write_rig(tmp_path / "b.mcap", replace(example_rig, cameras=others, reference="other0", fits=()))
    assert run(["compare", str(rig_path), str(tmp_path / "b.mcap")]) == 1
    assert "fewer than two cameras" in capsys.readouterr().err


def _entities(path):
    from rerun.chunk import RrdReader

    return {str(chunk.entity_path) for chunk in RrdReader(str(path)).stream()}


def test_identity_is_no_difference(rig_path, capsys):
    assert run(["compare", str(rig_path), str(rig_path), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["chance"] == pytest.approx(1)
    np.testing.assert_allclose(answer["a_from_b"], Pose.identity().matrix(), atol=1e-9)
