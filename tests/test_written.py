"""What is written works: every block of command lines of README and the pages, and every example of every --help.

Each is run in a folder of its own where the files are that it names: pictures and recordings of the demo's room, of a
court, and what commands before it leave. Python of the pages is run too.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from contextlib import chdir
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TextIO

import cv2
import numpy as np
import pytest

from quadrig.io import open_recording, write_config
from quadrig.io.commands.main import COMMANDS, run
from quadrig.io.demo.rendered_recording import demo_config, write_demo_recording
from quadrig.io.demo.scene import SceneCamera, demo_scene, looking
from quadrig.single import (
    Capture,
    Intrinsics,
    PlainMarking,
    Rectangle,
    Sheet,
    TagMarking,
    ray_grid,
    render_image,
)

ROOT = Path(__file__).resolve().parents[1]
# Framesets, and the share of the demo's pixels along a side.
_FRAMESETS, _SHARE = 6, 0.6
_CAMERAS = ("cam0", "cam1", "cam2", "cam3")

# Cameras of this machine, of the network and of a cluster are nowhere that tests run: files take their place. Only a
# cluster has none: tests/io/batch/test_fleet.py runs that line over a real one.
_INSTEAD = {
    "left=0": "left=cam0.mp4",
    "right=1": "right=cam1.mp4",
    "cam0=0": "cam0=cam0.mp4",
    "cam1=1": "cam1=cam1.mp4",
    "http://127.0.0.1:8080/video": "cam0.mp4",
    "tcp://scheduler:8786": "",
    "--dask": "",
    "--screenshot": "--save",
    "rig.png": "screenshot.rrd",
}
# No window is opened, and nothing is waited for in real time.
_ADDED = {"setup": ["--no-viewer", "--fast"], "pick": ["--no-browser"]}
# What another test runs already, as it is written here.
_ELSEWHERE = {"demo": "tests/io/commands/test_demo.py"}


@dataclass(frozen=True)
class Block:
    """Command lines that are typed one after another; place: where they are written."""

    place: str
    lines: tuple[str, ...]

    @property
    def sourced(self) -> bool:
        """Whether it takes the cameras from rig.toml."""
        return any(re.match(r"rig (setup|record) --", line) for line in self.lines)

    @property
    def court(self) -> bool:
        """Whether it is about the court, whose corners are pointed at, and not about the demo's room."""
        return any(word in line for line in self.lines for word in ("left.jpg", "left*.jpg"))


def blocks_of(path: Path) -> list[Block]:
    """The sh and console blocks of a page."""
    found = re.findall(r"^ *```(?:sh|console)\n(.*?)^ *```", path.read_text(), re.S | re.M)
    return [Block(f"{path.name} {number}", _lines(text)) for number, text in enumerate(found, start=1)]


def _lines(text: str) -> tuple[str, ...]:
    """Command lines: a backslash goes on with the next one, what follows # is for people."""
    lines = [line.strip() for line in text.replace("\\\n", " ").splitlines()]
    return tuple(line for line in lines if line and not line.startswith("#"))


def arguments(line: str) -> list[str]:
    """The words behind `rig`, as they are tried here."""
    words = [_INSTEAD.get(word, word) for word in shlex.split(line, comments=True)[1:]]
    words = [word for word in words if word] + _ADDED.get(words[0], [])
    if "--tag" in words:
        # Another desk, with a tag on it.
        words = [word.replace("desk.jpg", "tag.jpg") for word in words]
    if words[0] == "inspect" and "--save" not in words:
        words += ["--save", "look.rrd"]
    if words[0] == "init":
        # Files have their own names.
        words = ["look.mcap" if word == "room.mcap" else word for word in words]
        words = [re.sub(r"^\w+=(?=.*\.mp4$)", "", word) for word in words]
    return words


def can_be_typed(line: str) -> bool:
    """Whether what another command names is there: an extra of pip's, a file of the repository."""
    words = shlex.split(line)
    if words[:2] == ["pip", "install"]:
        extras = re.findall(r"^(\w+) = \[", (ROOT / "pyproject.toml").read_text(), re.M)
        named = [extra for word in words[2:] for part in re.findall(r"\[(.*?)\]", word) for extra in part.split(",")]
        return set(named) <= set(extras)
    if words[0] in ("python", "pytest", "rerun", "mkdocs"):
        return all((ROOT / word).exists() for word in words[1:] if "/" in word and not word.startswith("rig-demo/"))
    return False


def make_room(folder: Path, court: ModuleType) -> None:
    """Everything that the lines name, in two folders: room and court."""
    room, pitch = folder / "room", folder / "court"
    for place in (room, pitch):
        place.mkdir()
    _make_room(room)
    _make_court(pitch, court)


def _make_room(room: Path) -> None:
    scene = demo_scene(_FRAMESETS)
    # `rig init` makes out the board where it is large, and knows it from two pictures.
    seen = replace(scene, cameras=scene.cameras[::2], board_poses=scene.board_poses[:2])
    write_demo_recording(room / "look.mcap", seen, workers=1, progress=False)
    scene = replace(scene, cameras=tuple(map(_smaller, scene.cameras)))
    write_demo_recording(room / "room.mcap", scene, workers=1, progress=False)
    write_config(replace(demo_config(scene), reference=None), room / "rig.toml")
    _make_files(room)
    for folder, names in (("boards", _CAMERAS[:2]), ("recordings", ())):
        (room / folder).mkdir()
        for name in names:
            (room / folder / f"{name}.mp4").symlink_to(room / f"{name}.mp4")
    for name in ("tuesday", "tonight", "scene", "site", "new", "recordings/monday"):
        (room / f"{name}.mcap").symlink_to(room / "room.mcap")
    _rig(room, "calibrate", "room.mcap", "-o", "rig.mcap")
    (room / "rig-demo").mkdir()
    for name, made in (("recording.mcap", "room.mcap"), ("rig.toml", "rig.toml"), ("rig.mcap", "rig.mcap")):
        (room / "rig-demo" / name).symlink_to(room / made)
    for name in ("monday", "friday"):
        shutil.copy(room / "rig.mcap", room / f"{name}.mcap")
    shutil.copy(room / "rig.detections.mcap", room / "rig2.detections.mcap")
    _rig(room, "calibrate", "cam0.mp4", "-o", "lens.rig.mcap")
    shutil.copy(room / "lens.rig.mcap", room / "laboratory.rig.mcap")
    (room / "times.csv").write_text(
        "camera,frame_index,time\n" + "".join(f"{c},{k},{k / 5}\n" for c in _CAMERAS for k in range(_FRAMESETS))
    )
    _rig(room, "export", "rig.mcap", "--format", "kalibr", "--undistorted", "-o", "camchain.yaml")
    _rig(room, "export", "rig.mcap", "--format", "ros", "-o", "ros")
    _rig(room, "export", "rig.mcap", "-o", "rig.urdf")
    for name, other in (("left", "cam0"), ("right", "cam1")):
        shutil.copy(room / f"ros/{other}.yaml", room / f"{name}.yaml")
    _make_desk(room)


def _smaller(camera: SceneCamera) -> SceneCamera:
    """The same camera with fewer pixels: what is written shall run, and how well is not asked here."""
    lens = camera.intrinsics
    width, height = round(_SHARE * lens.width), round(_SHARE * lens.height)
    middle = _SHARE * (lens.principal_point + 0.5) - 0.5
    return replace(
        camera, intrinsics=Intrinsics(width, height, _SHARE * lens.focal, middle, np.array(lens.distortion))
    )


def _make_files(room: Path) -> None:
    """Each camera's pictures as a folder and as a video."""
    for camera in open_recording([room / "room.mcap"]).cameras:
        (room / camera.name).mkdir()
        pictures = [picture for picture in camera.source.images(gray=False) if picture is not None]
        size = (camera.width, camera.height)
        writer = cv2.VideoWriter(str(room / f"{camera.name}.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 5, size)
        for number, picture in enumerate(pictures):
            cv2.imwrite(str(room / camera.name / f"{number:04d}.jpg"), picture)
            writer.write(picture)
        writer.release()


def _make_desk(room: Path) -> None:
    """Photographs of an A4 sheet, and of a tag, at an angle."""
    grid = ray_grid(Intrinsics.centred(1280, 960, 1000.0))
    camera_from_world = looking(np.array([0.05, -0.45, 0.5]), np.array([-0.05, 0.45, -0.5])).inverse()
    lying = looking(np.zeros(3), np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]))
    sheet = Sheet(Rectangle("sheet", 0.297, 0.210, PlainMarking()), lying)
    tag = Sheet(Rectangle("tag", 0.16, 0.16, TagMarking("apriltag_36h11", 7)), lying)
    capture = Capture(blur=0.7, noise=1.0)
    for names, shown in ((("photo.jpg", "desk.jpg", "shot.png"), sheet), (("tag.jpg",), tag)):
        picture = render_image(grid, camera_from_world, [shown], background=0.25, capture=capture)
        for name in names:
            cv2.imwrite(str(room / name), picture if name != "shot.png" else cv2.resize(picture, (768, 432)))


def _make_court(pitch: Path, court: ModuleType) -> None:
    (pitch / "rig.toml").write_text(court.CONFIG)
    tables = []
    for camera in court.CAMERAS:
        cv2.imwrite(str(pitch / f"{camera}.jpg"), court.picture(camera))
        for rectangle in (court.COURT, court.SERVICE):
            names = ("bottom_right", "bottom_left", "top_left", "top_right")
            corners = zip(names, court.corners(camera, rectangle).round(2).tolist(), strict=True)
            head = f'[[corners]]\ncamera = "{camera}"\nrectangle = "{rectangle.name}"\n'
            tables.append(head + "".join(f"{name} = {corner}\n" for name, corner in corners))
    (pitch / "corners.toml").write_text("\n".join(tables))


def _rig(place: Path, *words: str) -> None:
    with chdir(place):
        assert run(words) == 0, words


def examples() -> list[Block]:
    """The examples of every --help, each command's as one block."""
    sys.path.insert(0, str(ROOT / "pages"))
    try:
        maker = import_module("commands")
    finally:
        sys.path.remove(str(ROOT / "pages"))
    return [
        Block(f"rig {name} --help {number}", (line,))
        for name in COMMANDS
        for number, line in enumerate(_lines("\n".join(maker.examples(name))), start=1)
    ]


def _without_what_others_run(blocks: list[Block]) -> list[Block]:
    """A block whose lines all stand in another one, in their order, is run there."""
    texts = ["\n".join(block.lines) + "\n" for block in blocks]
    return [
        b
        for k, b in enumerate(blocks)
        if not any(texts[k] in o for n, o in enumerate(texts) if (len(o), -n) > (len(texts[k]), -k))
    ]


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCKS = _without_what_others_run([block for page in PAGES for block in blocks_of(page)] + examples())
# The same lines on two pages are run once.
SNIPPETS = dict.fromkeys(
    text for page in PAGES for text in re.findall(r"^```python\n(.*?)^```", page.read_text(), re.S | re.M)
)


@pytest.fixture(scope="module")
def made(tmp_path_factory, load_script) -> Path:
    """The room and the court, made once for all of pytest's workers, where files can be waited for."""
    base = tmp_path_factory.getbasetemp()
    shared = os.name == "posix" and "PYTEST_XDIST_WORKER" in os.environ
    folder = (base.parent if shared else base) / "written"
    folder.mkdir(exist_ok=True)
    with (folder / "made").open("a+") as made:
        _wait_for(made)
        made.seek(0)
        if not made.read():
            make_room(folder, load_script("tests/io/court_room.py"))
            made.write("yes")
    return folder


def _wait_for(file: TextIO) -> None:
    """Until no other worker holds the file; it is let go where it is closed."""
    if os.name == "posix":
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX)


@pytest.fixture
def place(made: Path, tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """A folder with all files of the block's room; those of the room itself cannot be spoiled."""
    block = getattr(request, "param", None)
    _link(made / ("court" if block is not None and block.court else "room"), tmp_path)
    if block is not None and block.sourced:
        cameras = "".join(f'\n[[camera]]\nname = "{name}"\nsource = "{name}.mp4"\n' for name in _CAMERAS)
        (tmp_path / "rig.toml").write_text((tmp_path / "rig.toml").read_text() + cameras)
    return tmp_path


def _link(source: Path, target: Path) -> None:
    for path in source.iterdir():
        if path.is_dir():
            (target / path.name).mkdir()
            _link(path, target / path.name)
        elif path.suffix in (".jpg", ".png", ".mp4") or path.resolve().name in ("room.mcap", "look.mcap"):
            # Recordings keep their place, to which what was found in them belongs.
            (target / path.name).symlink_to(path.resolve())
        else:
            shutil.copy(path, target / path.name)


@pytest.mark.parametrize(
    ("block", "place"), [(b, b) for b in BLOCKS], ids=[b.place for b in BLOCKS], indirect=["place"]
)
def test_a_block_runs_as_it_is_written(block: Block, place: Path, monkeypatch, capfd) -> None:
    monkeypatch.chdir(place)
    for line in block.lines:
        if not line.startswith("rig "):
            assert can_be_typed(line), line
            continue
        words = arguments(line)
        if words[0] in _ELSEWHERE:
            assert (ROOT / _ELSEWHERE[words[0]]).is_file()
            continue
        if words[0] == "pick":
            assert "Corners by hand" in shown_by_pick(words)
            continue
        if words[0] in ("record", "init"):
            # What they write was not there yet when this was typed.
            (place / (words[words.index("-o") + 1] if "-o" in words else "rig.toml")).unlink(missing_ok=True)
        code = run(words)
        assert code == 0, (line, capfd.readouterr().err)


def shown_by_pick(words: list[str]) -> str:
    """The page of `rig pick`, which is then ended as a person ends it."""
    from urllib.request import urlopen

    command = [sys.executable, "-m", "quadrig.io", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        try:
            return urlopen(process.stdout.readline().strip(), timeout=20).read().decode()
        finally:
            process.send_signal(signal.SIGINT)


@pytest.mark.parametrize("text", SNIPPETS, ids=[text.splitlines()[0] for text in SNIPPETS])
def test_a_snippet_runs_as_it_is_written(text: str, place: Path, monkeypatch) -> None:
    monkeypatch.chdir(place)
    exec(compile(text, "snippet", "exec"), {"__name__": "snippet"})
