"""The demo: what it leaves, and that its truth lies within the sigmas."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from quadrig.io.config.rig_toml import read_config
from quadrig.io.demo.scene import BOARD, demo_scene, looking
from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.io.rig_file.rig_mcap import read_rig_file

RIG = Path(sys.executable).with_name("rig")
FRAMESETS = 6


@pytest.fixture(scope="module")
def ran(tmp_path_factory) -> tuple[Path, dict]:
    """The folder and the JSON of a short demo, called where there is a folder io/, as in a checkout."""
    place = tmp_path_factory.mktemp("checkout")
    (place / "io").mkdir()
    (place / "io" / "__init__.py").write_text("raise ImportError('this is not the standard library')")
    arguments = [str(RIG), "demo", "-o", "out", "--framesets", str(FRAMESETS), "--json"]
    done = subprocess.run(arguments, cwd=place, capture_output=True, text=True, env={**os.environ, "TERM": "dumb"})
    assert done.returncode == 0, done.stderr
    return place / "out", json.loads(done.stdout)


def test_the_truth_lies_within_the_sigmas(ran) -> None:
    _, result = ran
    within = [held for camera in result["truth"].values() for held in camera["within_sigma"].values()]
    assert len(within) == 12
    # One of twelve figures may lie outside of 99.7 % by chance once in thirty recordings; two do not.
    assert sum(within) >= 11


def test_every_camera_is_found_where_it_is(ran) -> None:
    _, result = ran
    scene = demo_scene(FRAMESETS)
    assert set(result["cameras"]) == {camera.name for camera in scene.cameras}
    assert not result["missing"]
    for camera in scene.cameras:
        found = result["cameras"][camera.name]
        # 0.1 % of the focal and 5 mm in a room of 6 m: a tenth of what a tape measure and a data sheet give.
        assert found["camera_matrix"][0][0] == pytest.approx(camera.intrinsics.focal, rel=1e-3)
        assert result["truth"][camera.name]["position_error_m"] < 5e-3


def test_it_leaves_what_it_says(ran) -> None:
    folder, _ = ran
    assert sorted(path.name for path in folder.iterdir()) == ["demo.rrd", "recording.mcap", "rig.mcap", "rig.toml"]
    recording = open_recording([folder / "recording.mcap"])
    assert [(camera.name, camera.frames) for camera in recording.cameras] == [
        (f"cam{index}", FRAMESETS) for index in range(4)
    ]
    config = read_config(folder / "rig.toml")
    assert config.rectangles == demo_scene(FRAMESETS).rectangles
    held = read_rig_file(folder / "rig.mcap")
    assert held.config_text == (folder / "rig.toml").read_text()
    assert len(held.times) == FRAMESETS


def test_examples_read_what_it_leaves(ran) -> None:
    folder, _ = ran
    script = Path(__file__).resolve().parents[3] / "examples" / "04_recording_to_rig.py"
    done = subprocess.run([sys.executable, str(script), str(folder)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "cam3: focal 70" in done.stdout or "cam3: focal 69" in done.stdout


def test_every_camera_sees_the_board_and_tags(ran) -> None:
    folder, _ = ran
    fits = read_rig_file(folder / "rig.mcap").rig.fits
    for camera in demo_scene(FRAMESETS).cameras:
        seen = {fit.view.rectangle for fit in fits if fit.view.camera == camera.name}
        assert BOARD in seen
        assert len(seen) >= 3


def test_looking_is_a_rotation_upright() -> None:
    pose = looking(np.array([1.0, 2.0, 3.0]), np.array([-1.0, -2.0, -1.5]))
    np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose.rotation) == pytest.approx(1)
    # y points down: against the world's z.
    assert pose.rotation[2, 1] < 0
