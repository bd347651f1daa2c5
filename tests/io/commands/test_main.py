"""`rig` as a person calls it: good and bad input, exit codes, one line for what failed."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import chdir, nullcontext
from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.io import calibrate_recording, read_config, read_rig
from quadrig.io.commands import main as commands
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.capture import Capture
from quadrig.single.render.picture import Sheet, ray_grid, render_image

RIG = Path(sys.executable).with_name("rig")
DESK = Rectangle("desk", 0.20, 0.20, TagMarking("apriltag_36h11", 1))
SHELF = Rectangle("shelf", 0.20, 0.20, TagMarking("apriltag_36h11", 2))
ROOM = """
[[rectangle]]
name = "desk"
width = 0.2
height = 0.2
moving = true
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 1 }

[[rectangle]]
name = "shelf"
width = 0.2
height = 0.2
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 2 }
"""


def rig_process(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """The installed command, in a process of its own."""
    return subprocess.run(
        [str(RIG), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, **environment},
    )


@pytest.fixture
def rig(capfd) -> Callable[..., subprocess.CompletedProcess[str]]:
    """rig(word, ..., cwd=None): the same command in this process, which has imported everything already."""

    def called(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        words = [str(word) for word in arguments]
        capfd.readouterr()
        with chdir(cwd) if cwd else nullcontext():
            code = commands.run(words)
        return subprocess.CompletedProcess(words, code, *capfd.readouterr())

    return called


def assert_one_sentence(done: subprocess.CompletedProcess[str], *words: str) -> None:
    assert done.returncode == 1, done.stderr
    lines = [line for line in done.stderr.splitlines() if not line.startswith("note:")]
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("rig: ")
    for word in words:
        assert word in lines[0]


@pytest.fixture(scope="module")
def pictures(tmp_path_factory) -> Path:
    """Folders of pictures: left and right see the desk from two sides, hall sees the shelf alone."""
    folder = tmp_path_factory.mktemp("pictures")
    lens = Intrinsics.centred(640, 480, 600.0)
    grid = ray_grid(lens)
    rng = np.random.default_rng(5)
    right_from_left = Pose.from_vectors(np.array([0.0, 0.3, 0.0]), np.array([-0.3, 0.0, 0.05]))
    for frameset in range(6):
        left_from_desk = Pose.from_vectors(rng.uniform(-0.7, 0.7, 3), np.array([*rng.uniform(-0.1, 0.1, 2), 0.9]))
        hall_from_shelf = Pose.from_vectors(rng.uniform(-0.5, 0.5, 3), np.array([0.0, 0.0, 0.8]))
        for name, camera_from_world, sheet in (
            ("left", Pose.identity(), Sheet(DESK, left_from_desk)),
            ("right", right_from_left, Sheet(DESK, left_from_desk)),
            ("hall", Pose.identity(), Sheet(SHELF, hall_from_shelf)),
        ):
            image = render_image(grid, camera_from_world, [sheet], capture=Capture(blur=0.6, noise=1.5), rng=rng)
            (folder / name).mkdir(exist_ok=True)
            cv2.imwrite(str(folder / name / f"{frameset:03}.png"), image)
    (folder / "rig.toml").write_text(ROOM)
    return folder


def test_help_lists_every_command_quickly_and_imports_none() -> None:
    heavy = "[m for m in ('cv2', 'scipy', 'rerun', 'networkx') if m in sys.modules]"
    code = f"import sys; from quadrig.io.commands.main import run; run(['--help']); print('heavy:', {heavy})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "heavy: []" in done.stdout
    for name in commands.COMMANDS:
        assert f"  {name} " in done.stdout


@pytest.mark.parametrize("name", commands.COMMANDS)
def test_every_command_has_help_with_an_example(rig, name: str) -> None:
    done = rig(name, "--help")
    assert done.returncode == 0, done.stderr
    assert "xample" in done.stdout
    assert f"rig {name}" in done.stdout
    # One kind of placeholder: capitals, no types in angle brackets, no braces around what is needed.
    assert re.search(r"<(path|str|int|float|list)", done.stdout) is None
    assert "{" not in done.stdout.splitlines()[0]


def test_help_of_a_command_is_its_help(rig) -> None:
    assert rig("help", "report").stdout == rig("report", "--help").stdout
    assert rig("help").stdout == rig("--help").stdout
    assert rig("help", "nonsense").returncode == 2


@pytest.mark.parametrize(
    ("line", "completed"),
    [
        ("rig ca", ["calibrate"]),
        ("rig help re", ["record", "report"]),
        ("rig report --ver", ["--verbose"]),
        ("rig --in", ["--install-completion"]),
    ],
)
def test_a_shell_completes_commands_and_their_options(line: str, completed: list[str]) -> None:
    words = str(len(line.split()) - 1)
    done = rig_process(_RIG_COMPLETE="complete_bash", COMP_WORDS=line, COMP_CWORD=words)
    assert done.stdout.split() == completed


def test_the_completion_of_a_shell_can_be_installed(tmp_path: Path) -> None:
    # It is the shell that calls it whose completion is shown: one that goes on after it.
    done = subprocess.run(["bash", "-c", f"'{RIG}' --show-completion; true"], capture_output=True, text=True)
    assert "complete -o default -F _rig_completion rig" in done.stdout
    assert "--install-completion" in rig_process("--help").stdout
    assert not list(tmp_path.iterdir())


def test_init_describes_what_is_in_sight_so_that_it_can_be_calibrated(rig, pictures: Path, tmp_path: Path) -> None:
    folders = [pictures / "left", pictures / "right"]
    done = rig("init", *folders, "--size", "20cm", "--moving", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (found,) = read_config(tmp_path / "rig.toml").rectangles
    assert (found.width, found.moving, found.marking) == (DESK.width, True, DESK.marking)
    assert rig("calibrate", *folders, "-q", cwd=tmp_path).returncode == 0
    assert_one_sentence(rig("init", *folders, "--size", "20cm", cwd=tmp_path), "there already", "--again")
    assert_one_sentence(rig("init", folders[0], "--print", cwd=tmp_path), "--size")
    assert_one_sentence(rig("init", "--print"), "SOURCE")


def test_a_dry_run_says_what_would_be_searched_and_writes_nothing(rig, pictures: Path, tmp_path: Path) -> None:
    arguments = ["calibrate", pictures / "left", pictures / "right", "-c", pictures / "rig.toml", "--dry-run"]
    done = rig(*arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "left: 6 images of 640x480, 6 to search" in done.stdout
    assert "12 images to search for desk, shelf" in done.stdout
    assert list(tmp_path.iterdir()) == []
    rig(*arguments[:-1], "-q", cwd=tmp_path)
    before = sorted((path.name, path.stat().st_mtime_ns) for path in tmp_path.iterdir())
    again = json.loads(rig(*arguments, "--json", cwd=tmp_path).stdout)
    assert (again["searched_before"], again["cameras"]["left"]["to_search"], again["search_seconds"]) == (12, 0, 0)
    assert sorted((path.name, path.stat().st_mtime_ns) for path in tmp_path.iterdir()) == before
    assert_one_sentence(rig(*arguments, "-o", tmp_path / "nowhere" / "rig.mcap", cwd=tmp_path), "nowhere")


def test_quiet_says_results_alone_and_verbose_how_they_came(rig, pictures: Path, tmp_path: Path) -> None:
    folders = [pictures / name for name in ("left", "right")]
    arguments = ["calibrate", *folders, "-c", pictures / "rig.toml", "-o", tmp_path / "rig.mcap", "--no-cache"]
    quiet, verbose = rig(*arguments, "-q"), rig(*arguments, "-v")
    assert (quiet.returncode, quiet.stderr) == (0, "")
    assert quiet.stdout == verbose.stdout
    assert "12 images" in verbose.stderr
    assert "solving" in verbose.stderr
    assert_one_sentence(rig(*arguments, "-q", "-v"), "-q and -v")
    assert_one_sentence(rig("report", "absent.mcap", "-q"), "absent.mcap")


@pytest.mark.parametrize(
    ("given", "then"),
    [
        ({"CLICOLOR": "0"}, {"NO_COLOR": "1"}),
        ({"CLICOLOR": "1"}, {}),
        ({"CLICOLOR_FORCE": "1"}, {"FORCE_COLOR": "1"}),
        ({"CLICOLOR_FORCE": "0"}, {}),
        ({"CLICOLOR_FORCE": "1", "NO_COLOR": "1"}, {}),
    ],
)
def test_colours_follow_the_habits_of_other_programs(given, then, monkeypatch) -> None:
    monkeypatch.setattr(os, "environ", dict(given))
    assert commands.run(["--version"]) == 0
    assert os.environ == {**given, **then}


@pytest.mark.parametrize("arguments", [["nonsense"], ["calibrate"], ["calibrate", "a", "--nonsense"], ["demo", "3"]])
def test_wrong_usage_exits_with_two(rig, arguments: list[str]) -> None:
    done = rig(*arguments)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def test_two_cameras_that_share_a_rectangle_become_a_rig(rig, pictures: Path, tmp_path: Path) -> None:
    arguments = ["calibrate", pictures / "left", pictures / "right", "-c", pictures / "rig.toml"]
    done = rig(*arguments, "-o", tmp_path / "rig.mcap", "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert set(result["cameras"]) == {"left", "right"}
    position = np.array(result["cameras"]["right"]["rig_from_camera"])[:3, 3]
    true = Pose.from_vectors(np.array([0.0, 0.3, 0.0]), np.array([-0.3, 0.0, 0.05])).inverse().translation
    # Six views of one tag give the baseline to millimetres; its own sigma is the yardstick.
    assert np.linalg.norm(position - true) < 4 * result["cameras"]["right"]["sigma"]["position_m"]
    assert (tmp_path / "rig.mcap").stat().st_size > 1000


def test_python_gives_the_rig_that_the_command_writes(pictures: Path, tmp_path: Path) -> None:
    folders = [pictures / "left", pictures / "right"]
    assert (
        rig_process("calibrate", *folders, "-c", pictures / "rig.toml", "-o", tmp_path / "rig.mcap").returncode == 0
    )
    written, made = read_rig(tmp_path / "rig.mcap"), calibrate_recording(folders, read_config(pictures / "rig.toml"))
    for one, other in zip(written.cameras, made.cameras, strict=True):
        assert one.name == other.name
        # The same pictures and the same solver: nothing but the last digits of another process' sums.
        np.testing.assert_allclose(
            one.rig_from_camera.matrix(), other.rig_from_camera.matrix(), rtol=1e-9, atol=1e-12
        )


def test_a_second_run_does_not_search_again(rig, pictures: Path, tmp_path: Path) -> None:
    arguments = ["calibrate", pictures / "left", pictures / "right", "-c", pictures / "rig.toml", "--json"]
    runs = [
        rig(*arguments, "-o", tmp_path / f"{name}.mcap", *more) for name, *more in (("a", "--no-cache"), "b", "b")
    ]
    assert ["12 images were searched before" in done.stderr for done in runs] == [False, False, True]
    assert len({done.stdout for done in runs}) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap", "b.detections.mcap", "b.mcap"]


def test_the_table_leads_with_the_working_accuracy(rig, pictures: Path, tmp_path: Path) -> None:
    arguments = ["calibrate", pictures / "left", pictures / "right", "-c", pictures / "rig.toml"]
    done = rig(*arguments, "-o", tmp_path / "rig.mcap")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Good for ")
    assert "mm" in done.stdout.splitlines()[0]
    assert "rig frame" in done.stdout


def test_a_camera_that_shares_nothing_is_named_and_not_placed(rig, pictures: Path, tmp_path: Path) -> None:
    result = tmp_path / "rig.mcap"
    folders = [pictures / name for name in ("left", "right", "hall")]
    done = rig("calibrate", *folders, "-c", pictures / "rig.toml", "-o", result, "--all-cameras")
    assert_one_sentence(done, "hall", "shelf", "left", "right")
    assert not result.exists()
    done = rig("calibrate", *folders, "-c", pictures / "rig.toml", "-o", result)
    assert done.returncode == 0, done.stderr
    assert "what is weak" in done.stdout
    assert "hall shares no rectangle" in done.stdout
    account = next(line for line in done.stderr.splitlines() if line.startswith("not placed: "))
    assert all(name in account for name in ("hall", "shelf", "left", "right"))
    assert result.exists()


def test_cameras_that_share_nothing_have_their_lenses(rig, pictures: Path, tmp_path: Path) -> None:
    folders = [pictures / name for name in ("left", "hall")]
    done = rig("calibrate", *folders, "-c", pictures / "rig.toml", "-o", tmp_path / "rig.mcap", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert {*found["cameras"], *found["lens_only"]} == {"hall", "left"}
    assert len(found["cameras"]) == len(found["lens_only"]) == len(found["missing"]) == 1
    rig("report", tmp_path / "rig.mcap", "-o", tmp_path / "rig.html")
    assert "<h2>Lens only</h2>" in (tmp_path / "rig.html").read_text()


def test_a_rig_that_is_refused_leaves_what_was_found(rig, pictures: Path, tmp_path: Path) -> None:
    folders = [pictures / name for name in ("left", "hall")]
    done = rig("calibrate", *folders, "-c", pictures / "rig.toml", "-o", tmp_path / "rig.mcap", "--all-cameras")
    assert_one_sentence(done, "hall", "left")
    # No rig, but the next attempt, with another rig.toml or one camera more, need not search these images again.
    assert [path.name for path in tmp_path.iterdir()] == ["rig.detections.mcap"]


def test_pictures_of_nothing_leave_nothing_behind(rig, pictures: Path, tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(ROOM.replace("id = 1", "id = 11").replace("id = 2", "id = 12"))
    done = rig("calibrate", pictures / "left", pictures / "right", cwd=tmp_path)
    assert_one_sentence(done)
    assert [path.name for path in tmp_path.iterdir()] == ["rig.toml"]


def test_bad_recordings_are_reported_in_one_sentence(rig, pictures: Path, tmp_path: Path) -> None:
    from mcap.writer import Writer

    room = pictures / "rig.toml"
    (tmp_path / "text.mcap").write_text("this is no recording")
    (tmp_path / "empty.mcap").touch()
    with (tmp_path / "silent.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/odometry", "json", 0)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    before = sorted(tmp_path.iterdir())
    for name, word in (("text", "MCAP"), ("empty", "MCAP"), ("silent", "no images"), ("absent", "no such file")):
        path = tmp_path / f"{name}.mcap"
        done = rig("calibrate", path, "-c", room, "-o", tmp_path / "rig.mcap")
        assert_one_sentence(done, path.name, word)
    # By itself, with nothing that listens to what libraries say, it is no other.
    assert rig_process(*done.args).stderr == done.stderr
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("right", "wrong", "words"),
    [
        ("moving = true", "movign = true", ["line 6", "movign", "moving"]),
        ("width = 0.2", "width = -0.2", ["line 4", "width", "desk"]),
        ("id = 2", "id = 587000", ["line 13", "shelf"]),
    ],
)
def test_bad_configs_are_reported_in_one_sentence(
    rig, pictures: Path, tmp_path: Path, right: str, wrong: str, words: list[str]
) -> None:
    (tmp_path / "rig.toml").write_text(ROOM.replace(right, wrong, 1))
    done = rig("calibrate", pictures / "left", pictures / "right", cwd=tmp_path)
    assert_one_sentence(done, "rig.toml", *words)
    assert [path.name for path in tmp_path.iterdir()] == ["rig.toml"]


def test_a_place_that_cannot_be_written_is_named(rig, pictures: Path, tmp_path: Path) -> None:
    result = tmp_path / "nowhere" / "rig.mcap"
    done = rig("calibrate", pictures / "left", pictures / "right", "-c", pictures / "rig.toml", "-o", result)
    assert_one_sentence(done, "nowhere")


def test_each_recording_becomes_a_rig_of_its_own(rig, pictures: Path, tmp_path: Path) -> None:
    for name in ("monday", "tuesday"):
        arguments = [f"--camera={side}={pictures / side}" for side in ("left", "right")]
        assert rig("record", *arguments, "-o", tmp_path / f"{name}.mcap").returncode == 0
    arguments = ["calibrate", tmp_path, "--each", "-c", pictures / "rig.toml", "-o", tmp_path / "rigs"]
    done = rig(*arguments)
    assert done.returncode == 0, done.stderr
    written = sorted(path.name for path in (tmp_path / "rigs").iterdir())
    assert written == [f"{day}.rig{kind}" for day in ("monday", "tuesday") for kind in (".detections.mcap", ".mcap")]
    assert rig(*arguments).stdout.count("kept") == 2
    assert_one_sentence(rig(*arguments[:-1], tmp_path / "one.mcap"), "--each", "folder")
    assert_one_sentence(rig(*arguments, "--cache", tmp_path / "one.mcap"), "--each", "--cache")


def test_only_needs_the_rig_from_before(rig, pictures: Path) -> None:
    done = rig("calibrate", pictures / "left", "-c", pictures / "rig.toml", "--only", "left")
    assert_one_sentence(done, "--only", "--from")


def test_what_nobody_expected_is_one_line_and_the_traceback_on_demand(monkeypatch, capsys) -> None:
    def fails(_name: str) -> None:
        raise KeyError("something\nlong")

    monkeypatch.setattr(commands, "command_function", fails)
    assert commands.run(["demo"]) == 1
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert "RIG_TRACEBACK=1" in said
    monkeypatch.setenv("RIG_TRACEBACK", "1")
    with pytest.raises(KeyError):
        commands.run(["demo"])


def test_interrupted_says_so(monkeypatch, capsys) -> None:
    def interrupted(_name: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(commands, "command_function", interrupted)
    assert commands.run(["demo"]) == 130
    assert "interrupted" in capsys.readouterr().err


@pytest.mark.skipif(os.name == "nt", reason="signals are POSIX's")
def test_ctrl_c_ends_a_command_without_a_traceback(tmp_path: Path) -> None:
    running = subprocess.Popen(
        [str(RIG), "demo", "-o", str(tmp_path / "demo")], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    # The folder appears when the command itself is at work.
    until = time.monotonic() + 60
    while not (tmp_path / "demo").exists() and time.monotonic() < until:
        time.sleep(0.05)
    time.sleep(1.0)
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=60)
    assert running.returncode == 130
    assert "Traceback" not in said
    assert "interrupted" in said
    assert not list((tmp_path / "demo").iterdir())
