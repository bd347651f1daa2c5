"""Files appear whole or not at all, where a person meant them to be, and never over what is no file."""

import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from quadrig.io.recording.decode_image import decode_file
from quadrig.io.whole_file import only_read, place_held, refuse_no_place, write_text, written_beside
from quadrig.single.errors import QuadrigError


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_file_follows_the_umask_and_keeps_its_mode_when_it_is_written_again(tmp_path):
    path = tmp_path / "rig.toml"
    before = os.umask(0o027)
    try:
        write_text(path, "one")
        assert mode_of(path) == 0o640
        path.chmod(0o604)
        write_text(path, "two")
    finally:
        os.umask(before)
    assert (path.read_text(), mode_of(path)) == ("two", 0o604)


@pytest.mark.parametrize("there", [True, False], ids=["a file", "nothing yet"])
def test_a_link_stays_and_what_it_leads_to_is_written(tmp_path, there):
    (tmp_path / "elsewhere").mkdir()
    target, link = tmp_path / "elsewhere" / "true.toml", tmp_path / "rig.toml"
    if there:
        target.write_text("before")
    link.symlink_to("elsewhere/true.toml")
    write_text(link, "after")
    assert link.is_symlink()
    assert target.read_text() == "after"
    assert [path.name for path in target.parent.iterdir()] == ["true.toml"]


@pytest.mark.skipif(os.name == "nt", reason="devices and pipes are POSIX's")
@pytest.mark.parametrize("what", ["pipe", "device", "link to a device", "link to itself", "folder", "below a file"])
def test_what_is_no_plain_file_is_never_replaced(tmp_path, what):
    path = tmp_path / "out"
    if what == "pipe":
        os.mkfifo(path)
    elif what == "device":
        path = Path("/dev/null")
    elif what == "folder":
        path.mkdir()
    elif what == "below a file":
        path.write_text("")
        path = path / "out"
    else:
        path.symlink_to("/dev/null" if "device" in what else "out")
    before = None if what == "below a file" else path.lstat().st_mode
    with pytest.raises(QuadrigError, match=r"device|itself|levels|folder|directory"):
        write_text(path, "text")
    assert before is None or path.lstat().st_mode == before


def test_a_link_into_a_folder_that_is_not_there_names_that_folder(tmp_path):
    (tmp_path / "out").symlink_to(tmp_path / "gone" / "out")
    with pytest.raises(QuadrigError, match=r"no folder .*gone"):
        refuse_no_place(tmp_path / "out")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="nothing is read-only for root")
def test_what_is_read_only_stays(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text("mine")
    path.chmod(0o444)
    with pytest.raises(QuadrigError, match="read-only"):
        write_text(path, "text")
    assert path.read_text() == "mine"


def test_what_fails_half_way_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text("old")

    def half() -> None:
        with written_beside(path) as beside:
            beside.write_text("ne")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        half()
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("rig.toml", "old")]


WRITES_UNTIL_KILLED = """
import sys
from quadrig.io.whole_file import written_beside
with written_beside(sys.argv[1]) as beside:
    beside.write_text("half")
    print("at work", flush=True)
    sys.stdin.read()
"""


@contextmanager
def at_work(path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that writes this file, killed at the end."""
    process = subprocess.Popen(
        [sys.executable, "-c", WRITES_UNTIL_KILLED, str(path)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "at work\n"
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.skipif(os.name == "nt", reason="locks are POSIX's")
def test_two_at_once_the_second_says_who_is_at_work_and_goes_on_where_that_one_was_killed(tmp_path):
    path = tmp_path / "rig[1].toml"
    path.write_text("old")
    with at_work(path) as process:
        with pytest.raises(QuadrigError, match=rf"rig\[1\].toml is being written by process {process.pid} \(-c"):
            write_text(path, "second")
        write_text(tmp_path / "another.toml", "")
    assert path.read_text() == "old"
    assert len(list(tmp_path.iterdir())) > 2
    with place_held(path):
        assert sorted(one.name for one in tmp_path.iterdir()) == [".rig[1].toml.lock", "another.toml", path.name]
        write_text(path, "third")
    assert sorted((one.name, one.read_text()) for one in tmp_path.iterdir()) == [
        ("another.toml", ""),
        ("rig[1].toml", "third"),
    ]


def test_an_error_of_what_is_read_is_not_blamed_on_what_is_written(tmp_path):
    def fails() -> None:
        with written_beside(tmp_path / "out") as beside:
            beside.write_bytes((tmp_path / "in").read_bytes())

    with pytest.raises(FileNotFoundError, match="in'"):
        fails()
    assert list(tmp_path.iterdir()) == []


def mcap(profile: str = "", library: str = "quadrig") -> bytes:
    """The beginning of an MCAP."""
    words = b"".join(len(word).to_bytes(4, "little") + word.encode() for word in (profile, library))
    return b"\x89MCAP0\r\n\x01" + len(words).to_bytes(8, "little") + words


def picture(suffix: str) -> bytes:
    """A picture as any program writes it."""
    return cv2.imencode(suffix, np.arange(300, dtype=np.uint8).reshape(15, 20))[1].tobytes()


RECORDING, RIG, PDF, PAGE = mcap(), mcap("quadrig"), b"%PDF-1.4 (quadrig)", b"<!doctype html> quadrig"
FOREIGN = "that quadrig did not write and would be replaced"


@pytest.mark.parametrize(
    ("there", "new", "said"),
    [
        (RECORDING, PAGE, "is a recording and would be replaced by a page;"),
        (mcap("ros2", "rosbag2"), RIG, "is a recording and would be replaced by a rig;"),
        (RIG, RECORDING, "is a rig and would be replaced by a recording;"),
        (b"reference = 'cam0'", RIG, "is a text and would be replaced by a rig;"),
        (b"\0\1\2", b'{"a": 1}', "is another file and would be replaced by JSON;"),
        (picture(".png"), PDF, f"is a picture {FOREIGN} by a PDF;"),
        (picture(".png"), picture(".png"), f"is a picture {FOREIGN} by a picture;"),
        (picture(".jpg"), picture(".jpg"), f"is a picture {FOREIGN} by a picture;"),
        (b"%PDF-1.7 my thesis", PDF, f"is a PDF {FOREIGN} by a PDF;"),
        (b"<!DOCTYPE html> mine", PAGE, f"is a page {FOREIGN} by a page;"),
        (b"\0\0\0 ftypisom" + bytes(3000), b"\0\0\0 ftypisom quadrig", f"is a video {FOREIGN} by a video;"),
        (b"RRF2 another program's", b"RRF2 quadrig", f"is a file of rerun {FOREIGN} by a file of rerun;"),
    ],
)
def test_a_file_of_another_kind_or_made_by_others_is_not_replaced(tmp_path, there, new, said):
    path = tmp_path / "precious"
    path.write_bytes(there)
    with pytest.raises(QuadrigError, match=said), written_beside(path) as beside:
        beside.write_bytes(new)
    assert path.read_bytes() == there
    assert [each.name for each in tmp_path.iterdir()] == ["precious"]


@pytest.mark.parametrize("same", [RECORDING, RIG, PDF, PAGE, b"name = 1", b"{}", b""])
def test_a_file_of_the_same_kind_or_an_empty_one_is_replaced(tmp_path, same):
    path = tmp_path / "result"
    path.write_bytes(same)
    with written_beside(path) as beside:
        beside.write_bytes((same or RIG) + b"more")
    assert path.read_bytes().endswith(b"more")


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_picture_of_ours_is_the_same_picture_and_is_replaced(tmp_path, suffix):
    path = tmp_path / f"shot{suffix}"
    for _ in range(2):
        with written_beside(path) as beside:
            beside.write_bytes(picture(suffix))
    plain = decode_file(picture(suffix))
    assert np.array_equal(decode_file(path.read_bytes()), plain)
    # Another reader, which takes a wrong sum for damage.
    Image.open(path).verify()


def test_what_a_command_reads_is_not_written_over(tmp_path):
    path = tmp_path / "rig.mcap"
    path.write_bytes(RIG)
    (tmp_path / "link").symlink_to(path)
    with only_read([path]), pytest.raises(QuadrigError, match="is what this command reads"):
        refuse_no_place(tmp_path / "link")
    refuse_no_place(path)


def test_a_dash_is_no_file():
    with pytest.raises(QuadrigError, match="standard output"):
        write_text("-", "text")


def test_what_is_no_picture_is_not_read_to_be_signed(tmp_path, monkeypatch):
    """A recording may be larger than memory."""
    monkeypatch.setattr(Path, "read_bytes", lambda path: pytest.fail(f"{path} was read whole"))
    with written_beside(tmp_path / "room.mcap") as beside:
        beside.write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    assert (tmp_path / "room.mcap").stat().st_size == 108
