"""rig setup from end to end, on rendered videos of somebody who holds a tag here and there before three cameras."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.io.commands.setup import chosen_sources
from quadrig.io.config.rig_toml import parse_config
from quadrig.io.drawing.rig_figures import shared_counts
from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.capture.source_spec import parse_source
from quadrig.io.live.kept_views import encode_views, read_kept_views
from quadrig.io.live.plan import SetupPlan
from quadrig.io.live.recorder import LiveRecorder
from quadrig.io.live.search import LiveSearch
from quadrig.io.live.session import run_setup
from quadrig.io.live.solver import thinned
from quadrig.io.live.state import SetupState
from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.io.rig_file.rig_mcap import read_rig
from quadrig.io.viewer.process import Viewer
from quadrig.io.viewer.setup.banner import banner
from quadrig.io.viewer.setup.screen import RerunScreen
from quadrig.single.detect.image_search import detect_views
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics
from quadrig.single.marking import CharucoMarking, TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.capture import Capture
from quadrig.single.render.picture import RayGrid, Sheet, ray_grid, render_image
from quadrig.single.rotation import rotation_from_vector
from quadrig.single.view import View

WIDTH, HEIGHT, RATE = 640, 360, 30
HOLDS, HELD = 9, 4
TAG = Rectangle("sheet", 0.24, 0.24, TagMarking("apriltag_36h11", 5), moving=True)
CONFIG = """reference = "cam0"
[[rectangle]]
name = "sheet"
width = 0.24
height = 0.24
moving = true
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 5 }
"""
LENSES = [Intrinsics.centred(WIDTH, HEIGHT, focal) for focal in (480.0, 520.0, 555.0)]
# On an arc of 1.5 m about a place in front of the first.
CAMERAS = [
    Pose(
        rotation_from_vector(np.array([0, -angle, 0])),
        np.array([1.5 * np.sin(angle), 0.1 * k, 1.5 - 1.5 * np.cos(angle)]),
    )
    for k, angle in enumerate((0.0, 0.45, 0.9))
]


@lru_cache
def grid(camera: int) -> RayGrid:
    """The rays of a camera: most of the work of a picture."""
    return ray_grid(LENSES[camera])


def backdrop_with_shapes() -> np.ndarray:
    """A wall with dark and light boxes: edges as every room has them, (H, W) float."""
    wall = np.full((HEIGHT, WIDTH), 0.4, np.float32)
    for x, y, light in np.random.default_rng(1).uniform(0, 1, (14, 3)):
        left, top = int(x * WIDTH), int(y * HEIGHT)
        wall[top : top + 50, left : left + 70] = 0.1 + 0.5 * light
    return wall


BACKDROP = backdrop_with_shapes()
USUAL = Capture(blur=0.6, noise=1.5)


def held_poses() -> list[Pose]:
    rng = np.random.default_rng(3)
    middle = np.array([0.0, 0.05, 1.5])
    facing = rotation_from_vector(np.array([0, -0.45, 0]))
    return [
        Pose(
            facing @ rotation_from_vector(rng.uniform(-0.6, 0.6, 3)), middle + rng.uniform(-0.2, 0.2, 3) * [1, 0.6, 1]
        )
        for _ in range(HOLDS)
    ]


def picture(camera: int, pose: Pose, rectangle: Rectangle = TAG) -> np.ndarray:
    sheet = Sheet(rectangle, pose)
    return render_image(grid(camera), CAMERAS[camera].inverse(), [sheet], samples=2, capture=USUAL, colour=False)


@pytest.fixture(scope="module")
def videos(tmp_path_factory) -> Path:
    """A folder with rig.toml and cam0.avi to cam2.avi."""
    folder = tmp_path_factory.mktemp("videos")
    (folder / "rig.toml").write_text(CONFIG)
    for camera in range(3):
        writer = cv2.VideoWriter(
            str(folder / f"cam{camera}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), RATE, (WIDTH, HEIGHT)
        )
        for pose in held_poses():
            colour = cv2.cvtColor(picture(camera, pose), cv2.COLOR_GRAY2BGR)
            for _ in range(HELD):
                writer.write(colour)
        writer.release()
    return folder


def arguments(videos: Path, output: Path, *more: str) -> list[str]:
    sources = [str(videos / f"cam{k}.avi") for k in range(3)]
    return ["setup", *sources, "--config", str(videos / "rig.toml"), "-o", str(output), *more]


def test_videos_become_a_rig_a_recording_and_a_picture_in_rerun(videos, tmp_path, capsys):
    output = tmp_path / "rig.mcap"
    assert run(arguments(videos, output, "--fast", "--json", "--save", str(tmp_path / "live.rrd"))) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["cameras"] == ["cam0", "cam1", "cam2"]
    assert result["framesets"] == HOLDS * HELD
    # A sheet held still is kept once.
    assert result["kept"] <= HOLDS + 2
    rig = read_rig(output)
    for camera, lens in zip(rig.cameras, LENSES, strict=True):
        # Five sigmas, and half a pixel for what rendering with 2 x 2 samples bends.
        assert abs(camera.intrinsics.focal - lens.focal) < 5 * rig.focal_sigma(camera.name) + 0.5
    recording = open_recording([Path(result["recording"])])
    assert {camera.name: camera.frames for camera in recording.cameras} == dict.fromkeys(
        ["cam0", "cam1", "cam2"], HOLDS * HELD
    )
    assert "mm" in Path(result["report"]).read_text(encoding="utf-8")
    assert (tmp_path / "live.rrd").stat().st_size > 10_000


def test_it_stops_at_the_accuracy_asked_for_and_goes_on_from_there(videos, tmp_path, capsys):
    output = tmp_path / "rig.mcap"
    assert run(arguments(videos, output, "--no-viewer", "--json", "--fast", "--until", "50mm")) == 0
    first = json.loads(capsys.readouterr().out)
    assert first["ending"] == "reached 50 mm"
    assert first["framesets"] < HOLDS * HELD
    assert run(arguments(videos, output, "--no-viewer", "--json", "--fast")) == 1
    assert "--resume" in capsys.readouterr().err
    assert run(arguments(videos, output, "--no-viewer", "--json", "--fast", "--resume")) == 0
    second = json.loads(capsys.readouterr().out)
    assert second["kept"] > first["kept"]
    assert second["recording"].endswith("rig-recording-2.mcap")
    assert second["working_accuracy_mm"] < first["working_accuracy_mm"]


def started(videos: Path, output: Path, *more: str) -> subprocess.Popen:
    """A session that waits for a stream that never comes, and so goes on after the videos' end."""
    command = [sys.executable, "-m", "quadrig.io", *arguments(videos, output, *more)]
    return subprocess.Popen(
        [*command, f"late=watch:{output.parent}"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for_kept(recording: Path, framesets: int) -> None:
    until = time.monotonic() + 40
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
            out, err = process.communicate(timeout=30)
        else:
            out, err = process.communicate("\n", timeout=30)
    finally:
        process.kill()
    assert process.returncode == 0, err
    assert "Traceback" not in err
    assert ("Enter was pressed" if how == "Enter" else "interrupted") in out
    # The camera that never came is named; the others are a rig.
    assert "late" in out
    assert {camera.name for camera in read_rig(tmp_path / "rig.mcap").cameras} == {"cam0", "cam1", "cam2"}
    assert open_recording([tmp_path / "rig-recording.mcap"]).indexed


def test_killed_and_resumed(videos, tmp_path, capsys):
    process = started(videos, tmp_path / "rig.mcap", "--no-viewer", "--fast")
    try:
        wait_for_kept(tmp_path / "rig-recording.mcap", 4)
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
    before = {view.frameset for view in read_kept_views(tmp_path / "rig-recording.mcap")[0]}
    assert all(camera.frames for camera in open_recording([tmp_path / "rig-recording.mcap"]).cameras)
    assert run(arguments(videos, tmp_path / "rig.mcap", "--no-viewer", "--json", "--fast", "--resume")) == 0
    assert json.loads(capsys.readouterr().out)["kept"] >= len(before)


def test_search_finds_what_a_full_search_finds():
    board = Rectangle("board", 0.40, 0.30, CharucoMarking(4, 3, 0.1, 0.075, "aruco_4x4_50"), moving=True)
    lens = Intrinsics.centred(960, 540, 750.0)
    search = LiveSearch([TAG, board])
    for step in range(6):
        shift = np.array([0.01 * step, 0, 0])
        sheets = [
            Sheet(TAG, Pose(rotation_from_vector(np.array([0.3, 0.2, 0.1])), np.array([-0.4, 0.1, 1.6]) + shift)),
            Sheet(board, Pose(rotation_from_vector(np.array([-0.3, 0.3, 0])), np.array([0.2, 0, 1.4]) - shift)),
        ]
        grey = render_image(
            lens, Pose.identity(), sheets, samples=2, capture=Capture(blur=0.6, noise=1.0), colour=False
        )
        found = search.search(Frame("cam0", step, 0.0, picture=grey), step)
        assert {view.rectangle for view in found.views} == {"sheet", "board"}
        exact = {view.rectangle: view for view in search.refine(found, {"sheet", "board"})}
        for view in detect_views(grey, [TAG, board]):
            np.testing.assert_array_equal(exact[view.rectangle].points, view.points)
            # The fit begins at outlines found in a window instead of the picture: a twentieth of a pixel at most.
            np.testing.assert_allclose(exact[view.rectangle].pixels, view.pixels, atol=0.05)


def said_of(tmp_path, pictures: Sequence[Sequence[np.ndarray]], config: str = CONFIG) -> list[str]:
    """The faults that a session names, at last that of its result; pictures (camera, moment), ten a second."""
    sources = {}
    for camera, moments in enumerate(pictures):
        folder = tmp_path / f"cam{camera}"
        folder.mkdir()
        for moment, grey in enumerate(moments):
            cv2.imwrite(str(folder / f"{moment:03}.png"), grey)
        sources[folder.name] = parse_source(str(folder))
    screen = Heard()
    result = run_setup(SetupPlan(parse_config(config), sources, tmp_path / "r.mcap", pace="consumed"), [screen], str)
    return [*screen.sentences, *([result.fault.sentence] if result.fault else [])]


class Heard:
    """A screen that keeps what was said."""

    def __init__(self) -> None:
        self.sentences: list[str] = []

    def show(self, state: SetupState) -> None:
        if state.fault:
            self.sentences.append(state.sentence)

    def close(self) -> None:
        pass


def shown(camera: int, pose: Pose, rectangle: Rectangle = TAG, motion=None, **light) -> np.ndarray:
    """A picture of a sheet before a backdrop with shapes in it."""
    sheets = [Sheet(rectangle, pose, motion=motion)]
    camera_from_world, capture = CAMERAS[camera].inverse(), replace(USUAL, **light)
    return render_image(
        grid(camera), camera_from_world, sheets, samples=2, colour=False, background=BACKDROP, capture=capture
    )


FACING = Pose(rotation_from_vector(np.array([0.2, -0.2, 0.0])), np.array([0.0, 0.05, 1.5]))


def moved(metres: float, pose: Pose = FACING) -> Pose:
    return Pose(pose.rotation, pose.translation + np.array([metres, 0, 0]))


def heard(sentences: Sequence[str], words: str) -> bool:
    return any(words in sentence for sentence in sentences)


def test_nothing_is_blamed_for_a_sheet_that_is_shown_well(tmp_path):
    pictures = [grey for pose in held_poses()[:5] for grey in [shown(0, pose)] * 2]
    assert said_of(tmp_path, [pictures]) == []


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"blur": 3.0}, "cam0: the picture is out of focus"),
        ({"exposure": 2.6}, "cam0: the sheet is over-exposed"),
        ({"exposure": 40.0}, "cam0: the picture is over-exposed"),
        ({"exposure": 0.03}, "cam0: the picture is dark"),
    ],
)
def test_blur_and_exposure_are_said_in_a_session(tmp_path, options, words):
    assert heard(said_of(tmp_path, [[shown(0, FACING, **options)] * 18]), words)


@pytest.mark.parametrize(
    ("per_exposure", "words"), [(0.04, "the sheet moves too fast"), (0.08, "what moves is smeared")]
)
def test_motion_is_said_in_a_session(tmp_path, per_exposure, words):
    motion = np.array([0, 0, 0, per_exposure, 0, 0])
    pictures = [shown(0, moved(0.1 * (-1) ** k), motion=motion) for k in range(2)]
    assert heard(said_of(tmp_path, [pictures * 12]), words)


def test_a_sheet_held_still_is_said_in_a_session(tmp_path):
    pictures = [shown(0, FACING), shown(0, moved(0.002))]
    assert heard(said_of(tmp_path, [pictures * 24]), "seen like this already; move it")


def test_a_sheet_that_rig_toml_does_not_name_is_said_in_a_session(tmp_path):
    other = Rectangle("other", 0.24, 0.24, TagMarking("apriltag_36h11", 9))
    said = said_of(tmp_path, [[shown(0, FACING, other)] * 18])
    assert heard(said, "cam0 sees tag 9 of apriltag_36h11, which rig.toml does not name")


def test_a_sheet_printed_at_the_wrong_scale_is_said_in_a_session(tmp_path):
    second = CONFIG.split("[[rectangle]]")[1].replace('"sheet"', '"small"').replace("id = 5", "id = 6")
    config = f"{CONFIG}[[rectangle]]{second}"
    # Printed at 96 %: "fit to page".
    small = Rectangle("small", 0.2304, 0.2304, TagMarking("apriltag_36h11", 6))
    poses = held_poses()
    pictures = []
    for camera in range(3):
        pictures.append([])
        for pose, other in zip(poses[:6], poses[3:], strict=True):
            sheets = [Sheet(TAG, moved(-0.17, pose)), Sheet(small, moved(0.17, other))]
            frame = CAMERAS[camera].inverse()
            pictures[-1] += [render_image(grid(camera), frame, sheets, samples=2, capture=USUAL, colour=False)] * 2
    said = said_of(tmp_path, pictures, config)
    assert heard(said, "small is ")
    assert heard(said, "% smaller than its size in rig.toml says")


def test_kept_views_come_back_to_the_last_bit(tmp_path):
    rng = np.random.default_rng(0)
    view = View(
        "sheet", TAG.corners, rng.uniform(0, 600, (4, 2)), "cam1", 7, (TAG.corners[::-1],), 0.123, 1.7e9 + 1 / 3
    )
    recorder = LiveRecorder(tmp_path / "r.mcap")
    recorder.note(5, encode_views(7, [view], {"cam1": (640, 360)}))
    recorder.close()
    views, sizes = read_kept_views(tmp_path / "r.mcap")
    assert sizes == {"cam1": (640, 360)}
    assert len(views) == 1
    assert (views[0].camera, views[0].rectangle, views[0].frameset, views[0].sigma) == ("cam1", "sheet", 7, 0.123)
    assert views[0].time == view.time
    np.testing.assert_array_equal(views[0].pixels, view.pixels)
    np.testing.assert_array_equal(views[0].alternatives[0], view.alternatives[0])


BOARD = Rectangle("board", 0.40, 0.30, CharucoMarking(4, 3, 0.1, 0.075, "aruco_4x4_50"), moving=True)
BOARD_CONFIG = """reference = "cam0"
[[rectangle]]
name = "board"
moving = true
marking = { kind = "charuco", columns = 4, rows = 3, square = 0.1, marker = 0.075, dictionary = "aruco_4x4_50" }
"""
LATE = 0.040


def carried(time: float) -> Pose:
    """The board on its way at a tenth of a metre a second or so."""
    position = [0.25 * np.sin(0.66 * time), 0.05 + 0.12 * np.sin(0.9 * time + 1), 1.5 + 0.2 * np.sin(0.42 * time + 2)]
    rotation = [0.4 * np.sin(0.54 * time), -0.45 + 0.4 * np.sin(0.72 * time + 1), 0.3 * np.sin(0.36 * time)]
    return Pose.from_vectors(np.array(rotation), np.array(position))


def test_a_camera_that_takes_its_pictures_later_than_their_stamps_is_found(tmp_path):
    sources = {}
    for camera, late in enumerate((0.0, LATE, 0.0)):
        path = tmp_path / f"cam{camera}.avi"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20, (WIDTH, HEIGHT))
        for moment in range(100):
            grey = picture(camera, carried(moment / 20 + late), BOARD)
            writer.write(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
        writer.release()
        sources[path.stem] = parse_source(str(path))
    plan = SetupPlan(parse_config(BOARD_CONFIG), sources, tmp_path / "r.mcap", pace="consumed")
    rig = run_setup(plan, [], str).rig
    assert rig is not None
    offsets = np.array([camera.clock_offset for camera in rig.cameras])
    # The board moves by 5 um in half a ms: less than the calibration knows of where it is.
    assert offsets - offsets[0] == pytest.approx([0, LATE, 0], abs=0.5e-3)
    for camera, pose in zip(rig.cameras, CAMERAS, strict=True):
        # Without the offset the second camera would stand 27 mm off.
        apart = np.linalg.norm(camera.rig_from_camera.translation - pose.translation)
        assert apart <= 4 * rig.position_sigma(camera.name)
        assert apart < 0.005


def test_pictures_of_a_folder_say_nothing_of_when_they_were_taken(tmp_path):
    assert parse_source("0").timed
    assert not parse_source(str(tmp_path)).timed
    assert not parse_source(f"watch:{tmp_path}").timed
    assert np.isnan(Frame("cam0", 5, 0.0, timed=False).time)
    found = LiveSearch([TAG]).search(Frame("cam0", 5_500_000_000, 0.0, picture=picture(0, held_poses()[0])), 3)
    assert [(view.time, view.frameset) for view in found.views] == [(5.5, 3)]


def test_thinning_leaves_framesets_that_follow_on_one_another_together():
    corners = TAG.corners
    times = {10 * burst + k: burst + 0.1 * k for burst in range(60) for k in range(3)}
    views = [
        View("sheet", corners, corners[:, :2], camera, k, time=time) for k, time in times.items() for camera in "ab"
    ]
    kept = {view.frameset for view in thinned(views, 100)}
    assert 97 <= len(kept) <= 100
    assert len({frameset // 10 for frameset in kept}) == 33


def test_thinning_keeps_what_cameras_share():
    corners = TAG.corners
    alone = [View("sheet", corners, corners[:, :2], "a", k) for k in range(300)]
    shared = [View("sheet", corners, corners[:, :2], camera, 1000 + k) for k in range(40) for camera in "ab"]
    kept = {view.frameset for view in thinned([*alone, *shared], 100)}
    assert set(range(1000, 1040)) <= kept
    assert len(kept) <= 100


def test_the_graph_counts_moving_sheets_by_frameset_and_static_ones_at_all_times():
    corners = TAG.corners
    views = [View("sheet", corners, corners[:, :2], camera, k) for k, camera in enumerate("abab")]
    views += [View("sheet", corners, corners[:, :2], "b", 0), View("wall", corners, corners[:, :2], "c", 9)]
    views += [View("wall", corners, corners[:, :2], "a", 4)]
    wall = Rectangle("wall", 0.2, 0.2)
    assert shared_counts(views, {"sheet": TAG, "wall": wall}) == {("a", "b"): 1, ("a", "c"): 1}


@pytest.mark.parametrize("sentence", ["cam1: tilt the sheet more", "a sentence of many words " * 8, "", "x" * 150])
def test_the_large_sentence_fits_into_its_picture(sentence):
    drawn = cv2.imdecode(np.frombuffer(banner(sentence, "", (235, 235, 235)), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert drawn is not None
    rows, columns = np.nonzero(drawn > 100)
    assert bool(len(rows)) == bool(sentence)
    if sentence:
        assert rows.min() > 0
        assert rows.max() < drawn.shape[0] - 1
        assert columns.min() > 0
        assert columns.max() < drawn.shape[1] - 1


def test_sources_of_the_command_line_and_of_rig_toml(tmp_path):
    (tmp_path / "left.mp4").write_bytes(b"")
    config = parse_config(
        CONFIG.replace('"cam0"', '"r"')
        + '[[camera]]\nname = "l"\nsource = "left.mp4"\n[[camera]]\nname = "r"\nsource = 1\n'
    )
    assert {name: spec.kind for name, spec in chosen_sources([], config, tmp_path).items()} == {
        "l": "video",
        "r": "camera",
    }
    named = chosen_sources(["0", "right=/dev/video1", "http://127.0.0.1/x"], config, tmp_path)
    assert {name: spec.kind for name, spec in named.items()} == {"cam0": "camera", "right": "device", "cam2": "http"}
    with pytest.raises(QuadrigError, match="two sources are called"):
        chosen_sources(["a=0", "a=1"], config, tmp_path)
    with pytest.raises(QuadrigError, match="no cameras"):
        chosen_sources([], parse_config(CONFIG), tmp_path)


def test_a_viewer_that_is_closed_is_said_and_the_session_goes_on(capfd):
    viewer = Viewer(options=("--serve-grpc",))
    screen = RerunScreen(("cam0",), (TAG,), viewer)
    frame = Frame("cam0", 0, 0.0, picture=picture(0, held_poses()[0]))
    screen.show(SetupState("one", frameset=0, frames={"cam0": frame}))
    viewer.close()
    until = time.monotonic() + 10
    said = ""
    while "the viewer was closed" not in said and time.monotonic() < until:
        screen.show(SetupState("two", frameset=1, frames={"cam0": frame}))
        time.sleep(0.05)
        said += capfd.readouterr().err
    screen.close()
    assert said == "rig: the viewer was closed; the session goes on here\n"


@pytest.mark.parametrize("display", ["", ":987"])
def test_without_a_screen_the_session_is_told_on_the_terminal(videos, tmp_path, capsys, monkeypatch, display):
    for name in ("WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("DISPLAY", display)
    assert run(arguments(videos, tmp_path / "rig.mcap", "--fast")) == 0
    said = capsys.readouterr()
    assert len([line for line in said.err.splitlines() if "viewer" in line and "--no-viewer" in line]) == 1
    assert "good for" in said.out
