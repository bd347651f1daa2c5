"""A disk that is full, wherever it is noticed: one sentence, the old file whole, nothing else left."""

import errno
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.record.recorder import LiveRecorder
from quadrig.io.rig_file.rig_mcap import write_rig
from quadrig.io.search.detection_file import keep_detections
from quadrig.single.errors import QuadrigError

resource = pytest.importorskip("resource")


@contextmanager
def no_room(bytes_left: int) -> Iterator[None]:
    """No file grows beyond these bytes: for whoever writes it is as if the disk were full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    # Python would cut off the bytecode of what is imported meanwhile, and never read it again without an error.
    bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_left, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = bytecode


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.fixture
def folder(tmp_path, monkeypatch, example_rig, example_config) -> Path:
    """A folder to stand in, with a rig.mcap, pictures, and old files of every name that is written."""
    monkeypatch.chdir(tmp_path)
    write_rig(tmp_path / "rig.mcap", example_rig, example_config)
    (tmp_path / "cam0").mkdir()
    noise = np.random.default_rng(0).integers(0, 255, (64, 96), dtype=np.uint8)
    for number in range(2):
        cv2.imwrite(str(tmp_path / "cam0" / f"{number}.png"), noise)
    for kind in ("rrd", "html", "json", "yaml", "mcap", "pdf", "png", "svg"):
        (tmp_path / f"x.{kind}").write_text("old")
    # Only a rig is written over a rig, a recording over a recording.
    (tmp_path / "x.rig.mcap").write_bytes((tmp_path / "rig.mcap").read_bytes())
    (tmp_path / "x.mcap").write_bytes(b"\x89MCAP0\r\n of yesterday")
    return tmp_path


COMMANDS = [
    "report rig.mcap -o x.html",
    "export rig.mcap --format json -o x.json",
    "export rig.mcap --format kalibr -o x.yaml",
    "import rig.mcap -o x.rig.mcap",
    "record cam0 --rate 1 --again -o x.mcap",
    "target --ids 0-3 -o x.pdf",
    "target --ids 0-3 -o x.png",
    "target --ids 0 -o x.svg",
]


@pytest.mark.parametrize("command", COMMANDS)
# Not even the name of who is at work finds room; the file itself does not.
@pytest.mark.parametrize("room", [5, 1000])
def test_a_command_says_so_in_one_sentence(folder, capsys, command, room):
    before = contents(folder)
    with no_room(room):
        assert run(command.split()) == 1
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith(f"rig: cannot write {command.split()[-1]}: ")
    assert "make room" in said
    assert contents(folder) == before


# In the first bytes, and when most of the file is there.
@pytest.mark.parametrize("room", [20, 20_000, 150_000])
def test_what_rerun_writes_is_said_as_well(folder, capsys, room):
    before = contents(folder)
    with no_room(room):
        assert run(["inspect", "rig.mcap", "--save", "x.rrd"]) == 1
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith("rig: cannot write x.rrd: ")
    assert "make room" in said
    assert contents(folder) == before


def record_live(path: Path) -> None:
    recorder = LiveRecorder(path)
    noise = np.random.default_rng(0).integers(0, 255, 60_000, np.uint8).tobytes()
    for stamp in range(8):
        recorder.write(Frame("a", stamp, 0.0, encoded=noise), wait=True)
    recorder.close()


def keep(path: Path) -> None:
    with keep_detections(path, {"a": "key"}, {}, {}) as writer:
        for image in range(2000):
            writer.write("a", image, image, f"cannot be read, for reason {os.urandom(20).hex()}")
            writer.flush()


@pytest.mark.parametrize("write", [record_live, keep])
def test_what_is_written_over_a_long_time_says_so_too(folder, write: Callable[[Path], None]):
    before = contents(folder)
    with no_room(20_000), pytest.raises(QuadrigError, match="make room") as raised:
        write(folder / "x.mcap")
    assert ("kept for the next run" in str(raised.value)) == (folder / ".x.mcap.part").exists()
    # What was found before is kept for the next run, beside the old file.
    assert {name: data for name, data in contents(folder).items() if name != ".x.mcap.part"} == before
    write(folder / "x.mcap")
    assert contents(folder).keys() == before.keys()


class FullOutput(StringIO):
    """Standard output into a file on a full disk."""

    def write(self, _text: str, /) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("command", ["info rig.mcap", "info rig.mcap --json", "--help"])
def test_output_without_room_is_one_sentence(command, monkeypatch, capsys) -> None:
    with monkeypatch.context() as standing:
        standing.setattr("sys.stdout", FullOutput())
        assert run(command.split()) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "cannot write the output: no space left" in said
