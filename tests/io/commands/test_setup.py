"""rig setup from end to end, on rendered videos of somebody who holds a tag here and there before three cameras."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import pytest

from quadrig.io.commands.main import run
from quadrig.io.config.rig_toml import parse_config
from quadrig.io.live.capture.chosen_sources import named_sources
from quadrig.io.live.record.kept_views import read_kept_views
from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.io.rig_file.rig_mcap import read_rig
from quadrig.single.errors import QuadrigError


@pytest.fixture(scope="module")
def videos(tmp_path_factory, room) -> Path:
    """A folder with rig.toml and cam0.avi to cam2.avi."""
    folder = tmp_path_factory.mktemp("videos")
    (folder / "rig.toml").write_text(room.CONFIG)
    for camera in range(3):
        writer = cv2.VideoWriter(
            str(folder / f"cam{camera}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), room.RATE, (room.WIDTH, room.HEIGHT)
        )
        for pose in room.held_poses():
            colour = cv2.cvtColor(room.picture(camera, pose), cv2.COLOR_GRAY2BGR)
            for _ in range(room.HELD):
                writer.write(colour)
        writer.release()
    return folder


def arguments(videos: Path, output: Path, *more: str) -> list[str]:
    sources = [str(videos / f"cam{k}.avi") for k in range(3)]
    return ["setup", *sources, "--config", str(videos / "rig.toml"), "-o", str(output), *more]


def test_videos_become_a_rig_a_recording_and_a_picture_in_rerun(videos, tmp_path, capsys, room):
    output = tmp_path / "rig.mcap"
    assert run(arguments(videos, output, "--fast", "--json", "--save", str(tmp_path / "live.rrd"))) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["cameras"] == ["cam0", "cam1", "cam2"]
    assert result["framesets"] == room.HOLDS * room.HELD
    # A sheet held still is kept once.
    assert result["kept"] <= room.HOLDS + 2
    rig = read_rig(output)
    for camera, lens in zip(rig.cameras, room.LENSES, strict=True):
        # Five sigmas, and half a pixel for what rendering with 2 x 2 samples bends.
        assert abs(camera.intrinsics.focal - lens.focal) < 5 * rig.focal_sigma(camera.name) + 0.5
    recording = open_recording([Path(result["recording"])])
    assert {camera.name: camera.frames for camera in recording.cameras} == dict.fromkeys(
        ["cam0", "cam1", "cam2"], room.HOLDS * room.HELD
    )
    assert "mm" in Path(result["report"]).read_text(encoding="utf-8")
    assert (tmp_path / "live.rrd").stat().st_size > 10_000


def test_it_stops_at_the_accuracy_asked_for_and_goes_on_from_there(videos, tmp_path, capsys, room):
    output = tmp_path / "rig.mcap"
    assert run(arguments(videos, output, "--no-viewer", "--json", "--fast", "--until", "50mm")) == 0
    first = json.loads(capsys.readouterr().out)
    assert first["ending"] == "reached 50 mm"
    assert first["framesets"] < room.HOLDS * room.HELD
    assert run(arguments(videos, output, "--no-viewer", "--json", "--fast")) == 1
    assert "--resume" in capsys.readouterr().err
    assert run(arguments(videos, output, "--no-viewer", "--json", "--fast", "--resume")) == 0
    second = json.loads(capsys.readouterr().out)
    assert second["kept"] > first["kept"]
    assert second["recording"].endswith("rig-recording-2.mcap")
    assert second["working_accuracy_mm"] < first["working_accuracy_mm"]


def started(videos: Path, output: Path, *more: str, before: tuple[str, ...] = ()) -> subprocess.Popen:
    """A session that waits for a stream that never comes, and so goes on after the videos' end.

    before: a command that the session is given to.
    """
    command = [*before, sys.executable, "-m", "quadrig.io", *arguments(videos, output, *more)]
    return subprocess.Popen(
        [*command, f"late=watch:{output.parent}"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for_kept(recording: Path, framesets: int) -> None:
    until = time.monotonic() + 120
    while not recording.exists() or len({v.frameset for v in read_kept_views(recording)[0]}) < framesets:
        assert time.monotonic() < until, "nothing was kept"
        time.sleep(0.1)


@pytest.mark.parametrize("how", ["Enter", "Ctrl-C"])
def test_enter_and_interrupt_leave_a_rig_and_a_recording(videos, tmp_path, how):
    process = started(videos, tmp_path / "rig.mcap", "--no-viewer", "--fast")
    try:
        wait_for_kept(tmp_path / "rig-recording.mcap", 5)
        if how == "Ctrl-C":
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=120)
        else:
            out, err = process.communicate("\n", timeout=120)
    finally:
        process.kill()
    assert process.returncode == 0, err
    assert "Traceback" not in err
    assert ("Enter was pressed" if how == "Enter" else "interrupted") in out
    # The camera that never came is named; the others are a rig.
    assert "late" in out
    assert {camera.name for camera in read_rig(tmp_path / "rig.mcap").cameras} == {"cam0", "cam1", "cam2"}
    assert open_recording([tmp_path / "rig-recording.mcap"]).indexed


@pytest.mark.parametrize("before", [(), ("nice", "-n", "10")], ids=["usual", "nice"])
def test_killed_and_resumed(videos, tmp_path, capsys, before):
    process = started(videos, tmp_path / "rig.mcap", "--no-viewer", "--fast", before=before)
    try:
        wait_for_kept(tmp_path / "rig-recording.mcap", 4)
    finally:
        os.kill(process.pid, signal.SIGKILL)
        # Its worker holds the other end of these pipes: it is gone as well.
        process.communicate(timeout=120)
    before = {view.frameset for view in read_kept_views(tmp_path / "rig-recording.mcap")[0]}
    assert all(camera.frames for camera in open_recording([tmp_path / "rig-recording.mcap"]).cameras)
    assert run(arguments(videos, tmp_path / "rig.mcap", "--no-viewer", "--json", "--fast", "--resume")) == 0
    assert json.loads(capsys.readouterr().out)["kept"] >= len(before)


def test_sources_of_the_command_line_and_of_rig_toml(tmp_path, room):
    (tmp_path / "left.mp4").write_bytes(b"")
    config = parse_config(
        room.CONFIG.replace('"cam0"', '"r"')
        + '[[camera]]\nname = "l"\nsource = "left.mp4"\n[[camera]]\nname = "r"\nsource = 1\n'
    )
    assert {name: spec.kind for name, spec in named_sources([], config, tmp_path).items()} == {
        "l": "video",
        "r": "camera",
    }
    named = named_sources(["0", "right=/dev/video1", "http://127.0.0.1/x"], config, tmp_path)
    assert {name: spec.kind for name, spec in named.items()} == {"cam0": "camera", "right": "device", "cam2": "http"}
    with pytest.raises(QuadrigError, match="two sources are called"):
        named_sources(["a=0", "a=1"], config, tmp_path)
    with pytest.raises(QuadrigError, match="no cameras"):
        named_sources([], parse_config(room.CONFIG), tmp_path)


@pytest.mark.parametrize("display", ["", ":987"])
def test_without_a_screen_the_session_is_told_on_the_terminal(videos, tmp_path, capsys, monkeypatch, display):
    for name in ("WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("DISPLAY", display)
    assert run(arguments(videos, tmp_path / "rig.mcap", "--fast")) == 0
    said = capsys.readouterr()
    assert len([line for line in said.err.splitlines() if "viewer" in line and "--no-viewer" in line]) == 1
    assert said.out.startswith("Good for ")
