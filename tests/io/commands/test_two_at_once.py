"""Two commands at once on one output: the second says who is at work, before it begins."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.io.commands.main import run

pytestmark = pytest.mark.skipif(os.name == "nt", reason="locks are POSIX's")

HOLD = """
import sys
from contextlib import ExitStack
from quadrig.io.whole_file import place_held
with ExitStack() as held:
    for path in sys.argv[1:]:
        held.enter_context(place_held(path))
    print("held", flush=True)
    sys.stdin.read()
"""
ROOM = """
[[rectangle]]
name = "desk"
width = 0.1
height = 0.1
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 7 }
"""
COMMANDS = {
    "calibrate cam0 --rate 1 -o rig.mcap": "rig.mcap",
    "calibrate cam0 --rate 1 -o other.mcap --cache kept.mcap": "kept.mcap",
    "calibrate . --each --rate 1 -o rigs": "*.rig.mcap",
    "record cam0 --rate 1 -o room.mcap": "room.mcap",
    "record watch:cam0 --seconds 1 -o room.mcap": "room.mcap",
    "setup cam0 --fast --no-viewer -o rig.mcap": "rig.mcap",
    "setup cam0 --fast --no-viewer -o desk.mcap": "desk-recording.mcap",
}


@pytest.fixture(scope="module")
def at_work(tmp_path_factory):
    """A folder in which another process is at work on all of these outputs; that process."""
    folder = tmp_path_factory.mktemp("two")
    for name in ("cam0", "rigs"):
        (folder / name).mkdir()
    (folder / "rig.toml").write_text(ROOM)
    cv2.imwrite(str(folder / "cam0" / "0.png"), np.full((48, 64), 128, np.uint8))
    places = [str(folder / ("rigs/" if "*" in name else "") / name) for name in sorted(set(COMMANDS.values()))]
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, *places], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    yield folder, process
    process.communicate()


@pytest.mark.parametrize("command", COMMANDS)
def test_the_second_says_who_is_at_work(at_work, monkeypatch, capsys, command):
    folder, process = at_work
    monkeypatch.chdir(folder)
    before = sorted(folder.rglob("*"))
    assert run(command.split()) == 1
    said = capsys.readouterr().err
    assert f"{COMMANDS[command]} is being written by process {process.pid} (" in said
    assert len(said.splitlines()) == 1
    assert sorted(folder.rglob("*")) == before


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="a folder in which nobody may write")
@pytest.mark.parametrize(
    "command", ["calibrate cam0 --rate 1", "record watch:cam0", "record cam0 --rate 1", "setup cam0"]
)
def test_a_folder_that_cannot_be_written_to_is_said_before_the_work(at_work, monkeypatch, capsys, command):
    monkeypatch.chdir(at_work[0])
    assert run([*command.split(), "-o", "/proc/rig.mcap"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("rig: cannot write /proc/rig.mcap: ")
    assert len(said.splitlines()) == 1
