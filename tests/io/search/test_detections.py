"""Detections: found by worker processes, kept in an MCAP, not lost by a kill or by Ctrl-C."""

import contextlib
import importlib
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.io.recording.framesets import build_framesets
from quadrig.io.recording.mcap_reader import index_mcap
from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.io.search.detections import find_detections, find_views
from quadrig.io.search.effort import Effort
from quadrig.io.workers import run_tasks
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Rectangle

COUNT = 20
TAG = Rectangle("tag", 0.1, 0.1, TagMarking("aruco_4x4_50", 7))


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Two cameras that see one tag wander, but not in every image."""
    folder = tmp_path_factory.mktemp("pictures")
    mark = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), 7, 60)
    for camera in range(2):
        (folder / f"cam{camera}").mkdir()
        for k in range(COUNT):
            image = np.full((240, 320), 230, np.uint8)
            if (k + camera) % 5:
                image[40 + k : 100 + k, 60 + 5 * k : 120 + 5 * k] = mark
            cv2.imwrite(str(folder / f"cam{camera}" / f"{k:03}.png"), image)
    (folder / "cam1" / "007.png").write_bytes(b"broken")
    return folder


def same(first, second) -> bool:
    return len(first) == len(second) and all(
        (a.rectangle, a.camera, a.frameset, a.sigma) == (b.rectangle, b.camera, b.frameset, b.sigma)
        and np.array_equal(a.points, b.points)
        and np.array_equal(a.pixels, b.pixels)
        and len(a.alternatives) == len(b.alternatives)
        and all(np.array_equal(x, y) for x, y in zip(a.alternatives, b.alternatives, strict=True))
        for a, b in zip(first, second, strict=True)
    )


def test_views_where_the_tag_was(recording):
    opened = open_recording([recording])
    framesets = build_framesets(opened)
    found = find_detections(opened, framesets, [TAG], Effort(workers=1))
    seen = {(view.camera, view.frameset): view for view in found.views}
    expected = {(f"cam{c}", k) for c in range(2) for k in range(COUNT) if (k + c) % 5 and (c, k) != (1, 7)}
    assert set(seen) == expected
    assert found.unreadable == {"cam1": 1}
    for (_, k), view in seen.items():
        # The tag's pixels run from 60 + 5k to 119 + 5k: its edges lie half a pixel outside their centres.
        corners = np.array([[119.5, 99.5], [59.5, 99.5], [59.5, 39.5], [119.5, 39.5]]) + np.array([5 * k, k])
        assert np.abs(view.pixels[:4] - corners).max() < 0.5
    assert [(v.frameset, v.camera) for v in found.views] == sorted((v.frameset, v.camera) for v in found.views)


def test_workers_and_the_kept_file_change_nothing(recording, tmp_path):
    opened = open_recording([recording])
    framesets = build_framesets(opened)
    alone = find_views(opened, framesets, [TAG], Effort(workers=1))
    cache = tmp_path / "rig.detections.mcap"
    first = find_detections(opened, framesets, [TAG], Effort(workers=2, cache=cache))
    second = find_detections(opened, framesets, [TAG], Effort(workers=2, cache=cache))
    assert same(alone, first.views)
    assert same(alone, second.views)
    assert (first.searched, first.reused, second.searched, second.reused) == (2 * COUNT, 0, 0, 2 * COUNT)
    assert second.unreadable == {"cam1": 1}
    assert [path.name for path in tmp_path.iterdir()] == [cache.name]


def test_kept_file_is_foxglove_annotations(recording, tmp_path):
    from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
    from mcap.reader import make_reader

    opened = open_recording([recording])
    cache = tmp_path / "rig.detections.mcap"
    views = find_views(opened, build_framesets(opened), [TAG], Effort(workers=1, cache=cache))
    with cache.open("rb") as stream:
        messages = list(make_reader(stream).iter_messages(["/cam0/annotations", "/cam1/annotations"]))
    assert len(messages) == len(views)
    for schema, channel, message in messages:
        assert schema is not None
        assert schema.name == "foxglove.ImageAnnotations"
        drawn = ImageAnnotations.FromString(message.data)
        camera, frameset = channel.topic.split("/")[1], message.log_time // 10**9
        view = next(view for view in views if (view.camera, view.frameset) == (camera, frameset))
        assert np.allclose([(point.x, point.y) for point in drawn.points[0].points], view.pixels)


def test_only_what_has_changed_is_searched_again(recording, tmp_path):
    opened = open_recording([recording])
    framesets = build_framesets(opened)
    cache = tmp_path / "rig.detections.mcap"
    find_views(opened, framesets, [TAG], Effort(workers=1, cache=cache))
    moving = Rectangle("tag", 0.1, 0.1, TagMarking("aruco_4x4_50", 7), moving=True)
    assert find_detections(opened, framesets, [moving], Effort(workers=1, cache=cache)).searched == 0
    wider = Rectangle("tag", 0.2, 0.2, TagMarking("aruco_4x4_50", 7))
    again = find_detections(opened, framesets, [wider], Effort(workers=1, cache=cache))
    assert again.searched == 2 * COUNT
    assert again.views[0].points.max() == pytest.approx(0.1)


def test_half_kept_is_half_searched(recording, tmp_path):
    """As a killed process leaves it: a file cut off in the middle, under the name of work in progress."""
    opened = open_recording([recording])
    framesets = build_framesets(opened)
    cache = tmp_path / "rig.detections.mcap"
    whole = find_views(opened, framesets, [TAG], Effort(workers=1, cache=cache))
    last_chunk = max(topic.chunks.max() for topic in index_mcap(cache).topics)
    data = cache.read_bytes()
    cache.unlink()
    (tmp_path / f".{cache.name}.part").write_bytes(data[: last_chunk + 100])
    found = find_detections(opened, framesets, [TAG], Effort(workers=1, cache=cache))
    assert 0 < found.searched < 2 * COUNT
    # Where a batch begins, images are searched whole, not near where the image before had the tag.
    assert [(a.camera, a.frameset) for a in found.views] == [(b.camera, b.frameset) for b in whole]
    assert max(np.abs(a.pixels - b.pixels).max() for a, b in zip(found.views, whole, strict=True)) < 0.02
    assert [path.name for path in tmp_path.iterdir()] == [cache.name]


TASKS = """
import os, signal
from pathlib import Path


def killed_once(task):
    number, flag = task
    if number == 3 and not Path(flag).exists():
        Path(flag).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number

def killed_always(number):
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_killed_worker_loses_nothing(tmp_path, monkeypatch):
    (tmp_path / "tasks_of_this_test.py").write_text(TASKS)
    monkeypatch.syspath_prepend(str(tmp_path))
    given = importlib.import_module("tasks_of_this_test")
    tasks = [(number, str(tmp_path / "killed")) for number in range(10)]
    assert dict(run_tasks(given.killed_once, tasks, workers=2)) == {number: number * number for number in range(10)}
    assert (tmp_path / "killed").exists()
    with pytest.raises(QuadrigError, match="worker process was ended 3 times"):
        list(run_tasks(given.killed_always, [1, 2], workers=2))


BOARD = """
[[rectangle]]
name = "board"
marking = { kind = "chessboard", columns = 10, rows = 8, square = 0.05 }
"""
# No `if __name__ == "__main__"`: a user's script has to work without it.
SCRIPT = """
import sys
from pathlib import Path
from quadrig.io.recording.framesets import build_framesets
from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.io.search.detections import find_views
from quadrig.io.search.effort import Effort
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.rectangle import Rectangle

opened = open_recording([Path(sys.argv[1])])
board = Rectangle("board", 0.5, 0.4, ChessboardMarking(10, 8, 0.05))
found = find_views(opened, build_framesets(opened), [board], Effort(workers=2, cache=Path(sys.argv[2])))
print(len(found))
"""


def living(group: int) -> list[str]:
    """Commands of the processes of a group that have not ended."""
    states = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            states.append(stat.read_text().rpartition(")")[2].split())
    return [fields[0] for fields in states if int(fields[2]) == group and fields[0] != "Z"]


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("way", ["script", "command"])
def test_ctrl_c_keeps_what_was_found_and_says_how_to_go_on(tmp_path, way):
    folder, cache, script = tmp_path / "cam0", tmp_path / "kept" / "rig.detections.mcap", tmp_path / "script.py"
    folder.mkdir()
    cache.parent.mkdir()
    script.write_text(SCRIPT)
    (tmp_path / "rig.toml").write_text(BOARD)
    # Noise costs a chessboard's search the most: three thousand times are minutes of work on any machine.
    noise = np.random.default_rng(1).integers(0, 255, (480, 640), dtype=np.uint8)
    cv2.imwrite(str(folder / "0000.pgm"), noise)
    for k in range(1, 3000):
        os.link(folder / "0000.pgm", folder / f"{k:04}.pgm")
    command = [sys.executable, str(script), str(folder), str(cache)]
    if way == "command":
        # What was found is kept beside the rig without being asked for.
        rig, described = Path(sys.executable).with_name("rig"), tmp_path / "rig.toml"
        command = [str(rig), "calibrate", str(folder), "-c", str(described), "-o", str(cache.parent / "rig.mcap")]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    part = cache.with_name(f".{cache.name}.part")
    while process.poll() is None and not (part.exists() and any(map(len, index_mcap(part).topics))):
        time.sleep(0.02)
    # The first detections are kept, the others are minutes away. As a terminal does: to the whole group.
    os.killpg(process.pid, signal.SIGINT)
    began = time.monotonic()
    _, said = process.communicate(timeout=20)
    assert time.monotonic() - began < 10
    assert process.returncode != 0
    searched = re.search(r"stopped: (\d+) of 3000 images were searched, kept in", said)
    assert searched is not None, said
    assert 0 < int(searched[1]) < 3000
    assert "the same command goes on from there" in said
    assert [path.name for path in cache.parent.iterdir()] == [cache.name]
    time.sleep(0.2)
    assert living(process.pid) == []
    assert index_mcap(cache).note == ""
