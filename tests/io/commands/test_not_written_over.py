"""What a command reads, and what quadrig did not make, stays as it is whatever is asked for."""

from pathlib import Path

import cv2
import pytest

from quadrig.io.commands.main import run
from quadrig.io.rig_file.rig_mcap import write_rig

ROOM = """
[[rectangle]]
name = "desk"
width = 0.2
height = 0.2
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 1 }
"""


@pytest.mark.parametrize(
    ("command", "precious", "said"),
    [
        ("calibrate room.mcap --cache rig.toml -o x.mcap", "rig.toml", "rig.toml is what this command reads"),
        ("calibrate room.mcap --cache other.toml -o x.mcap", "other.toml", "other.toml is a text, not kept detect"),
        ("calibrate room.mcap -o room.mcap", "room.mcap", "room.mcap is what this command reads"),
        ("calibrate room.mcap -o link.mcap", "room.mcap", "link.mcap is what this command reads"),
        ("calibrate room.mcap -o x.mcap --cache ./x.mcap", "room.mcap", "x.mcap would be written twice"),
        ("calibrate room.mcap --from old.mcap --only a -o old.mcap", "old.mcap", "old.mcap is what this command"),
        ("inspect old.mcap room.mcap --save room.mcap", "room.mcap", "room.mcap is what this command reads"),
        ("inspect old.mcap --save room.mcap", "room.mcap", "room.mcap is a recording and would be replaced"),
        ("record room.mcap -o room.mcap --again", "room.mcap", "room.mcap is what this command reads"),
        ("single photo.png --paper A4 --save photo.png", "photo.png", "photo.png is what this command reads"),
        ("target -o thesis.pdf", "thesis.pdf", "thesis.pdf is a PDF that quadrig did not write"),
    ],
)
def test_nothing_that_is_read_or_was_made_by_others_is_written_over(
    tmp_path, monkeypatch, capsys, pictures, example_rig, command, precious, said
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cam0").mkdir()
    for number in range(2):
        cv2.imwrite(f"cam0/{number}.png", pictures.picture(number))
    Path("photo.png").write_bytes(Path("cam0/0.png").read_bytes())
    Path("thesis.pdf").write_bytes(b"%PDF-1.7 mine")
    for name in ("rig.toml", "other.toml"):
        Path(name).write_text(ROOM)
    write_rig("old.mcap", example_rig)
    assert run(["record", "cam0", "--rate", "1", "-o", "room.mcap"]) == 0
    Path("link.mcap").symlink_to("room.mcap")
    before = Path(precious).read_bytes()
    assert run(command.split()) == 1
    assert said in capsys.readouterr().err
    assert Path(precious).read_bytes() == before
    assert not list(tmp_path.glob("*.damaged-*"))
