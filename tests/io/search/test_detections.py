"""Detections: found by worker processes, kept in an MCAP, not lost by a kill or by Ctrl-C."""

import contextlib
import importlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.io.config.rig_toml import parse_config
from quadrig.io.recording.convert import record
from quadrig.io.recording.framesets import build_framesets
from quadrig.io.recording.messages.mcap_reader import index_mcap
from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.io.search import detection_file, detections
from quadrig.io.search.detections import find_detections, find_views
from quadrig.io.search.effort import Effort
from quadrig.io.search.whole_recording import search_recording
from quadrig.io.workers import run_tasks
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

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
    assert found.left_out == {"cam1": {"cannot be read": [7]}}
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
    assert second.left_out == {"cam1": {"cannot be read": [7]}}
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
    # To the last bit: a batch is searched whole, wherever the file was cut off.
    assert same(found.views, whole)
    assert [path.name for path in tmp_path.iterdir()] == [cache.name]


def kept_file(folder: Path, place: Path) -> tuple[Any, Any, list[View], Path]:
    """The recording, its framesets, its Views, and the file that keeps them."""
    opened = open_recording([folder])
    framesets = build_framesets(opened)
    cache = place / "rig.detections.mcap"
    return opened, framesets, find_views(opened, framesets, [TAG], Effort(workers=1, cache=cache)), cache


@pytest.mark.parametrize("seed", [*range(6), "a name"])
def test_a_flipped_bit_is_noticed_set_aside_and_searched_again(recording, tmp_path, seed):
    opened, framesets, whole, cache = kept_file(recording, tmp_path)
    data = bytearray(cache.read_bytes())
    # The topic's name stands in the summary as it is.
    place = data.index(b"/quadrig") if seed == "a name" else np.random.default_rng(seed).integers(len(data))
    data[place] ^= 4
    cache.write_bytes(data)
    found = find_detections(opened, framesets, [TAG], Effort(workers=1, cache=cache))
    assert same(found.views, whole)
    assert bool(found.remarks) == bool(list(tmp_path.glob("*.damaged-*")))
    if found.searched:
        assert "was damaged" in found.remarks[0]
    again = find_detections(opened, framesets, [TAG], Effort(workers=1, cache=cache))
    assert same(again.views, whole)
    # One that is whole again, or whose damage was where no detection is.
    assert again.searched == 0


@pytest.mark.parametrize("content", [b"", b"not an MCAP", b"\x89MCAP0\r\n"])
def test_what_is_no_kept_file_is_said_and_set_aside(recording, tmp_path, content):
    opened, framesets, whole, cache = kept_file(recording, tmp_path)
    cache.write_bytes(content)
    found = find_detections(opened, framesets, [TAG], Effort(workers=1, cache=cache))
    assert same(found.views, whole)
    (aside,) = tmp_path.glob("*.damaged-*")
    assert aside.read_bytes() == content
    assert aside.name in found.remarks[0]


def test_a_recording_is_not_taken_for_a_cache(recording, tmp_path):
    """--cache room.mcap, where a recording of that name is: it stays as it is."""
    room = tmp_path / "room.mcap"
    record(open_recording([recording]).cameras, room, progress=False)
    data = room.read_bytes()
    opened = open_recording([recording])
    with pytest.raises(QuadrigError, match="is a recording or a rig, not kept detections"):
        find_detections(opened, build_framesets(opened), [TAG], Effort(workers=1, cache=room))
    assert room.read_bytes() == data


def test_exchanged_topics_are_searched_again(recording, tmp_path):
    """Two cameras whose topics end alike are told apart by the whole topic."""
    room = tmp_path / "room.mcap"
    record(open_recording([recording]).cameras, room, progress=False)
    cache = tmp_path / "rig.detections.mcap"
    topics = [f"/cam{k}/image_raw/compressed" for k in range(2)]

    def found(left, right, keep):
        opened = open_recording([room], {"left": topics[left], "right": topics[right]})
        return find_detections(opened, build_framesets(opened), [TAG], Effort(workers=1, cache=keep))

    found(0, 1, cache)
    exchanged, clean = found(1, 0, cache), found(1, 0, None)
    assert exchanged.reused == 0
    assert same(exchanged.views, clean.views)
    assert found(1, 0, cache).searched == 0


def test_pictures_that_were_replaced_are_searched_again(recording, tmp_path):
    folder, cache = tmp_path / "cam", tmp_path / "rig.detections.mcap"
    folder.mkdir()
    for k in range(4):
        (folder / f"{k}.png").write_bytes((recording / "cam0" / f"{k + 1:03}.png").read_bytes())
    effort = Effort(workers=1, cache=cache)

    def found():
        opened = open_recording([folder])
        return find_detections(opened, build_framesets(opened), [TAG], effort)

    assert (found().searched, found().searched) == (4, 0)
    (folder / "2.png").write_bytes((recording / "cam0" / "011.png").read_bytes())
    assert found().searched == 4


def test_another_detector_searches_again(recording, tmp_path, monkeypatch):
    opened, framesets, whole, cache = kept_file(recording, tmp_path)
    monkeypatch.setattr(detection_file, "detector_version", lambda: "another")
    again = find_detections(opened, framesets, [TAG], Effort(workers=1, cache=cache))
    assert (again.searched, again.reused) == (2 * COUNT, 0)
    assert same(again.views, whole)


@pytest.mark.parametrize("odd", [0, 2])
def test_a_picture_of_another_size_in_a_recording_is_counted_and_named(recording, tmp_path, odd):
    from quadrig.io.recording.convert import image_writer

    room = tmp_path / "room.mcap"
    with room.open("wb") as stream:
        write, finish = image_writer(stream, "foxglove")
        for k in range(4):
            image = cv2.imread(str(recording / "cam0" / f"{k + 1:03}.png"))
            assert image is not None
            image = image[:120] if k == odd else image
            write("cam0", (k + 1) * 10**9, "png", cv2.imencode(".png", image)[1].tobytes())
        finish()
    config = parse_config('[[rectangle]]\nname = "tag"\nwidth = 0.1\nheight = 0.1\n'
                          'marking = { kind = "tag", dictionary = "aruco_4x4_50", id = 7 }\n')  # fmt: skip
    searched = search_recording([room], config, Effort(workers=1, progress=False))
    assert [view.frameset for view in searched.views] == [k for k in range(4) if k != odd]
    assert f"camera 'cam0': 1 image is left out: 320x120, not 320x240 (the first: number {odd})" in searched.notes


@pytest.mark.parametrize("what", ["replaced", "deleted"])
def test_pictures_that_change_while_they_are_searched_make_no_result(tmp_path, monkeypatch, recording, what):
    folder, cache = tmp_path / "cam0", tmp_path / "kept.mcap"
    shutil.copytree(recording / "cam0", folder)
    search = detections.search_images

    def changes(*arguments: Any) -> list[Any]:
        found = search(*arguments)
        if what == "replaced":
            shutil.copy(recording / "cam1" / "001.png", folder / "003.png")
        else:
            (folder / "003.png").unlink()
        return found

    monkeypatch.setattr(detections, "search_images", changes)
    opened = open_recording([folder], rate=10.0)
    with pytest.raises(
        QuadrigError, match=r"changed while they were searched|003.png was there when the search began"
    ):
        find_detections(opened, build_framesets(opened), [TAG], Effort(workers=1, cache=cache, progress=False))
    # A picture that comes back is found as it was; of one that is another now nothing is kept.
    assert cache.exists() == (what == "deleted")


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
    with pytest.raises(QuadrigError, match="worker process was ended 5 times"):
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
@pytest.mark.parametrize("way", ["script, Ctrl-C", "command, SIGTERM", "command, SIGKILL"])
def test_what_was_found_is_kept_however_the_search_ends_and_no_worker_stays(tmp_path, way):
    folder, cache, script = tmp_path / "cam0", tmp_path / "kept" / "rig.detections.mcap", tmp_path / "script.py"
    folder.mkdir()
    cache.parent.mkdir()
    script.write_text(SCRIPT)
    (tmp_path / "rig.toml").write_text(BOARD)
    # Noise costs a chessboard's search the most: three thousand times are minutes of work on any machine.
    noise = np.random.default_rng(1).integers(0, 255, (240, 320), dtype=np.uint8)
    cv2.imwrite(str(folder / "0000.pgm"), noise)
    for k in range(1, 3000):
        os.link(folder / "0000.pgm", folder / f"{k:04}.pgm")
    command = [sys.executable, str(script), str(folder), str(cache)]
    if way.startswith("command"):
        # What was found is kept beside the rig without being asked for.
        rig, described = Path(sys.executable).with_name("rig"), tmp_path / "rig.toml"
        command = [str(rig), "calibrate", str(folder), "-c", str(described), "-o", str(cache.parent / "rig.mcap")]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    part = cache.with_name(f".{cache.name}.part")
    while process.poll() is None and not (part.exists() and any(map(len, index_mcap(part).topics))):
        time.sleep(0.02)
    # The first detections are kept, the others are minutes away.
    if way.endswith("Ctrl-C"):
        # As a terminal does: to the whole group.
        os.killpg(process.pid, signal.SIGINT)
    else:
        process.send_signal(signal.SIGTERM if way.endswith("SIGTERM") else signal.SIGKILL)
    began = time.monotonic()
    _, said = process.communicate(timeout=120)
    assert time.monotonic() - began < 60
    assert process.returncode != 0
    # A worker that is searching is given a third of a second; on a busy machine it ends later.
    until = time.monotonic() + 5
    while living(process.pid) and time.monotonic() < until:
        time.sleep(0.02)
    assert living(process.pid) == []
    if way.endswith("SIGKILL"):
        # The next run leaves nothing of this one lying about.
        for picture in folder.iterdir():
            picture.unlink()
        cv2.imwrite(str(folder / "0.png"), np.full((48, 64), 128, np.uint8))
        assert run(["calibrate", str(folder), *command[3:], "--rate", "1"]) == 1
    else:
        searched = re.search(r"stopped: (\d+) of 3000 images were searched, kept in", said)
        assert searched is not None, said
        assert 0 < int(searched[1]) < 3000
        assert "the same command goes on from there" in said
        assert index_mcap(cache).note == ""
    assert [path.name for path in cache.parent.iterdir()] == ([] if way.endswith("SIGKILL") else [cache.name])
