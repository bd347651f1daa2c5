"""Every example runs; what it prints is judged where the example has a truth of its own."""

import re
import subprocess
import sys
from pathlib import Path

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(name: str) -> str:
    done = subprocess.run([sys.executable, str(EXAMPLES / name)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def assert_within_sigmas(line: str) -> None:
    found, sigma, truth = map(float, re.findall(r"-?\d+\.?\d*", line.partition(":")[2] or line))
    assert abs(found - truth) < 4 * sigma + 0.1, line


def assert_off_within_sigmas(line: str) -> None:
    off, sigma = map(float, re.findall(r"off by ([\d.]+) mm, sigma ([\d.]+) mm", line)[0])
    # Three numbers each, and the sigma of their length: beyond 2.5 of these one in a thousand.
    assert 0 < off < 2.5 * sigma, line


def test_one_picture() -> None:
    lines = run("02_one_picture.py").splitlines()
    assert lines
    for line in lines:
        assert_within_sigmas(line)


def test_own_marking() -> None:
    lines = run("07_own_marking.py").splitlines()
    assert len(lines) == 2
    for line in lines:
        assert_within_sigmas(line)


def test_rig_from_views() -> None:
    lines = run("03_rig_from_views.py").splitlines()
    assert len(lines) == 3
    for line in lines:
        assert_within_sigmas(line)


def test_from_memory() -> None:
    lines = run("08_from_memory.py").splitlines()
    assert [line.split(":")[0] for line in lines] == ["arrays", "own detector", "driver"]
    for line in lines:
        assert_within_sigmas(line)


def test_box_of_tags() -> None:
    seen, *lines = run("09_box_of_tags.py").splitlines()
    assert "Views" in seen
    assert [line.split(":")[0] for line in lines] == ["cam1", "cam2", "face1", "face2", "face3", "face4", "face5"]
    for line in lines:
        assert_off_within_sigmas(line)


def test_cameras_without_overlap() -> None:
    lines = run("10_no_overlap.py").splitlines()
    assert [line.partition(":")[0][-4:] for line in lines] == ["cam1", "cam2", "cam3", "cam1"]
    for line in lines:
        turned, moved, turn_sigma, move_sigma = map(float, re.findall(r"\d+\.\d+", line))
        # Three numbers each, and the sigma of their length: beyond 2.5 of these one in a thousand.
        assert 0 < turned < 2.5 * turn_sigma, line
        assert 0 < moved < 2.5 * move_sigma, line


def test_has_it_moved(shared_data: Path) -> None:
    example = [sys.executable, str(EXAMPLES / "05_has_it_moved.py"), str(shared_data / "floor")]
    done = subprocess.run(example, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 3, done.stderr
    moved = [line.split(":")[0] for line in done.stdout.splitlines() if "moved by" in line]
    assert moved[0] == "camera_00"


def test_committed_configs_are_read() -> None:
    from quadrig.io.config.rig_toml import read_config

    configs = list(EXAMPLES.glob("*.toml"))
    assert configs
    assert all(read_config(path).rectangles for path in configs)
