"""Files appear whole or not at all, where a person meant them to be, and never over what is no file."""

import os
import stat
from pathlib import Path

import pytest

from quadrig.io.whole_file import refuse_no_place, write_text, written_beside
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
