"""`rig init` says of each sheet what it was told, and of what it was not told that it is to be measured."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.io.commands.init import init
from quadrig.io.config.rig_toml import read_config
from quadrig.io.recording.recorded_cameras import Recording
from quadrig.io.search.in_sight import recording_in_sight
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.in_sight import Sighting
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.capture import Capture
from quadrig.single.render.picture import Sheet, ray_grid, render_image

GRID = ray_grid(Intrinsics.centred(640, 480, 622.0))
BOARD = CharucoMarking(4, 5, 0.1, 0.06, "aruco_4x4_50")


def tag(number: int, x: float) -> Sheet:
    pose = Pose.from_vectors(np.array([0.3, -0.25, 0.1]), np.array([x, 0.0, 1.0]))
    return Sheet(Rectangle("tag", 0.2, 0.2, TagMarking("apriltag_36h11", number)), pose)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Two cameras: one sees two tags, and once a third; the other one sees a board."""
    folder = tmp_path_factory.mktemp("room")
    pose = Pose.from_vectors(np.array([0.3, -0.25, 0.1]), np.array([0.0, 0.0, 1.0]))
    board = Sheet(Rectangle("board", *BOARD.size, BOARD), pose)
    two = (tag(4, -0.28), tag(5, 0.0))
    for camera, pictures in {"left": [two, (*two, tag(9, 0.28))], "right": [(board,), (board,)]}.items():
        (folder / camera).mkdir()
        for k, sheets in enumerate(pictures):
            image = render_image(
                GRID, Pose.identity(), sheets, capture=Capture(blur=0.6), rng=np.random.default_rng(k)
            )
            cv2.imwrite(str(folder / camera / f"{k}.png"), image)
    return [str(folder / "left"), str(folder / "right")]


_LOOKED_AT: dict[int, tuple[tuple[Sighting, ...], int]] = {}


def look(recording: Recording) -> tuple[tuple[Sighting, ...], int]:
    """What is in sight, looked for once by number of cameras: it takes seconds."""
    cameras = len(recording.cameras)
    return _LOOKED_AT.get(cameras) or _LOOKED_AT.setdefault(cameras, recording_in_sight(recording, workers=1))


@pytest.fixture(autouse=True)
def look_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("quadrig.io.search.in_sight.recording_in_sight", look)


def written(room: list[str], folder: Path, *size: str) -> str:
    output = folder / "rig.toml"
    init(room, list(size), output=output)
    return output.read_text()


def test_sizes_are_said_per_kind_or_per_sheet(room: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    text = written(room, tmp_path, "tag=20cm", "charuco=100mm", "tag5=35cm")
    found = {one.name: one for one in read_config(tmp_path / "rig.toml").rectangles}
    # Tag 9 is in one picture only.
    assert {name: one.width for name, one in found.items()} == {"board": 0.4, "tag4": 0.2, "tag5": 0.35}
    marking = found["board"].marking
    assert isinstance(marking, CharucoMarking)
    assert marking.marker == pytest.approx(BOARD.marker, abs=0.002)
    said = capsys.readouterr().err
    assert "# board: its marker" in text
    assert "estimated from the pictures: measure" in said
    assert "tag 9" in said
    assert "was taken for" not in said + text


def test_what_several_sheets_were_given_is_to_be_measured(
    room: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    text = written(room[:1], tmp_path, "80mm")
    assert "# 80 mm was taken for 2 tags: measure each." in text
    assert "80 mm was taken for 2 tags" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("size", "said"),
    [
        (["80mm"], "1 charuco and 2 tags.*--size charuco=LENGTH --size tag=LENGTH"),
        (["tag=80mm"], "4x4.*--size charuco=LENGTH"),
        (["tag=80mm", "charuco=4cm", "tag7=3cm"], "tag7"),
    ],
)
def test_no_size_is_taken_for_what_it_was_not_said_of(room: list[str], tmp_path: Path, size: list[str], said: str):
    with pytest.raises(QuadrigError, match=said):
        written(room, tmp_path, *size)
    assert not list(tmp_path.iterdir())


def test_a_size_is_given_once(tmp_path: Path):
    with pytest.raises(QuadrigError, match="given already"):
        written(["nowhere"], tmp_path, "tag=80mm", "tag=81mm")
