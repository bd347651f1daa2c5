"""`rig compare` as a command: differences beside their sigmas, and one sentence for each failure."""

import json
import re
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
    assert {name: bool(one["differs"]) for name, one in answer["cameras"].items()} == {
        "cam0": False,
        "cam1": False,
        "cam2": False,
        "cam3": True,
    }
    assert answer["agree"] is False
    assert answer["chance"] < 0.01
    assert np.shape(answer["a_from_b"]) == (4, 4)
    assert run([*arguments, "--save", str(tmp_path / "c.rrd")]) == 0
    said = capsys.readouterr().out
    assert "differ by more than their sigmas allow, at cam3." in said
    # The words repeat the figures of the table.
    shift = re.search(r"cam3 differs in .*position \((.* ± .*) mm\)", said)
    assert shift is not None
    assert shift[1] in said.split("cam3 differs")[0]
    assert _entities(tmp_path / "c.rrd") >= {"/space/first/cam3", "/space/second/cam3", "/space/shifts", "/summary"}


def test_rigs_without_shared_names_are_one_sentence_and_can_be_renamed(example_rig, rig_path, tmp_path, capsys):
    others = tuple(replace(camera, name=f"other{i}") for i, camera in enumerate(example_rig.cameras))
    write_rig(tmp_path / "b.mcap", replace(example_rig, cameras=others, reference="other0", fits=()))
    arguments = ["compare", str(rig_path), str(tmp_path / "b.mcap")]
    assert run(arguments) == 1
    said = capsys.readouterr().err
    assert "the first has cam0, cam1, cam2, cam3; the second other0, other1, other2, other3" in said
    assert run([*arguments, *(f"--rename=other{i}=cam{i}" for i in range(4))]) == 0
    assert "The rigs agree" in capsys.readouterr().out
    assert run([*arguments, "--rename=other0"]) == 1
    assert "give OLD=NEW" in capsys.readouterr().err


def _entities(path):
    from rerun.chunk import RrdReader

    return {str(chunk.entity_path) for chunk in RrdReader(str(path)).stream()}


def test_identity_is_no_difference(rig_path, capsys):
    assert run(["compare", str(rig_path), str(rig_path), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["chance"] == pytest.approx(1)
    np.testing.assert_allclose(answer["a_from_b"], Pose.identity().matrix(), atol=1e-9)
