"""A source that comes back is the camera that went, or is left out and said: in size, scene, and time."""

import time
from functools import partial

import cv2
import numpy as np
import pytest

from quadrig.io.live.capture import same_camera, source
from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.capture.same_camera import SameCamera, SceneMemory
from quadrig.io.live.capture.source_spec import parse_source
from quadrig.io.live.record.record_sources import record_sources
from quadrig.io.recording.recorded_cameras import open_recording

WIDTH, HEIGHT = 320, 180


def room(seed: int, hand: int = 0, light: float = 1.0) -> np.ndarray:
    """Things on a wall, a sheet that is carried before them, and in the corner how bright the room's number is."""
    rng = np.random.default_rng(seed)
    picture = np.full((HEIGHT, WIDTH), 120, np.uint8)
    for _ in range(25):
        x, y, w, h = rng.integers((0, 0, 15, 15), (WIDTH, HEIGHT, 80, 80)).tolist()
        cv2.rectangle(picture, (x, y), (x + w, y + h), int(rng.integers(40, 220)), -1)
    cv2.rectangle(picture, (20 + 30 * hand % 200, 40), (110 + 30 * hand % 200, 150), 240, -1)
    cv2.rectangle(picture, (40 + 30 * hand % 200, 60), (90 + 30 * hand % 200, 130), 10, -1)
    picture[-20:, -20:] = 60 * seed
    return np.clip(light * picture, 0, 255).astype(np.uint8)


def frame(picture: np.ndarray, arrived: float) -> Frame:
    return Frame("cam0", int(1e9 * arrived), arrived, encoded=cv2.imencode(".jpg", picture)[1].tobytes())


def seen(seconds: int = 8) -> SameCamera:
    """A camera that has looked at room 1 for so long."""
    camera = SameCamera()
    assert all(camera.admits(frame(room(1, hand=k), float(k))) for k in range(seconds))
    return camera


def test_real_cameras_know_their_own_scene_from_each_others(shared_data):
    """Two cameras side by side, before which a board is carried that fills half of their pictures."""
    sides = {}
    for side in ("left", "right"):
        paths = sorted((shared_data / "stereo").glob(f"{side}*.jpg"))
        sides[side] = [np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)) for path in paths]
    for side, other in (("left", "right"), ("right", "left")):
        memory = SceneMemory()
        for picture in sides[side][:6]:
            memory.learn(picture)
        assert min(memory.agreement(picture) for picture in sides[side][6:]) > same_camera.SAME
        assert max(memory.agreement(picture) for picture in sides[other]) < 0.2
        assert memory.agreement(cv2.flip(sides[side][6], 1)) < 0.2


@pytest.mark.parametrize("light", [1.0, 0.5, 1.4])
def test_the_same_scene_is_let_through_with_something_else_before_it_and_in_another_light(light):
    camera = seen()
    camera.doubt()
    assert camera.admits(frame(room(1, hand=11, light=light), 60.0))
    assert camera.trouble == ""


def test_another_scene_is_left_out_and_said_until_the_first_is_back():
    camera = seen()
    camera.doubt()
    assert not any(camera.admits(frame(room(2, hand=k), 60.0 + k)) for k in range(9))
    assert "another camera's pictures" in camera.trouble
    assert camera.left_out == 9
    assert camera.admits(frame(room(1, hand=3), 80.0))
    assert camera.trouble == ""


def test_another_size_is_left_out_and_said_at_once():
    camera = seen(1)
    assert not camera.admits(frame(room(1)[::2, ::2], 1.0))
    assert camera.trouble.startswith("gives pictures of 160x90 and gave 320x180")
    assert camera.admits(frame(room(1), 2.0))


def test_of_a_bare_wall_nothing_is_claimed():
    camera, wall = SameCamera(), np.full((HEIGHT, WIDTH), 128, np.uint8)
    for k in range(8):
        camera.admits(frame(wall, float(k)))
    camera.doubt()
    assert camera.admits(frame(room(2), 60.0))


@pytest.fixture
def recorded(numbered, tmp_path, monkeypatch):
    """recorded(connections, enough): which rooms a recording of a stream shows, what was said, and what the source
    came to. connections: rooms, and the wait before each in s."""
    return partial(_recorded, numbered, tmp_path, monkeypatch)


def _recorded(numbered, folder, monkeypatch, connections, enough, look_every=0.02):
    monkeypatch.setattr(same_camera, "_LOOK_EVERY", look_every)
    monkeypatch.setattr(source, "_FIRST_RETRY", 0.05)
    said, until, waiting = [], time.monotonic() + 20, list(connections)

    def of_connection():
        rooms = enumerate(waiting.pop(0) if waiting else [])
        return ((cv2.imencode(".jpg", room(seed, hand=number))[1].tobytes(), wait) for number, (seed, wait) in rooms)

    with numbered.served(of_connection) as address:

        def stop() -> str:
            return "enough" if time.monotonic() > until or enough(said) else ""

        def show(states) -> None:
            if not said or said[-1] != states[0].sentence:
                said.append(states[0].sentence)

        done = record_sources({"cam0": parse_source(address)}, folder / "room.mcap", stop, show)
    pictures = open_recording([folder / "room.mcap"]).camera("cam0").source.images()
    return [round(float(image[-10:, -10:].mean()) / 60) for image in pictures if image is not None], said, done


def test_another_cameras_pictures_after_a_reconnect_are_not_recorded(recorded):
    usual = [(1, 0.03)] * 20
    rooms, said, done = recorded(
        [usual, [(2, 0.03)] * 15, usual, [(3, 0.03)] * 5],
        enough=lambda said: sum("came back with another scene" in one for one in said) > 1,
    )  # fmt: skip
    assert set(rooms) == {1}
    assert len(rooms) >= 30
    assert any(one.startswith("cam0 came back with another scene") for one in said)
    assert done.sources[0].left_out >= 15


def test_what_was_held_back_through_a_stall_is_not_taken_for_now(recorded, monkeypatch):
    monkeypatch.setattr(source, "STALL_SECONDS", 0.5)
    stalled = [(1, 0.06)] * 20 + [(1, 0.9)] + [(2, 0.0)] * 10 + [(1, 0.06)] * 10
    # The scene is not looked at: their hurry alone says how old they are.
    rooms, said, _ = recorded([stalled], enough=lambda said: "is lost" in str(said), look_every=1e9)
    assert set(rooms) == {1}
    assert any(one.startswith("cam0 is stalled") for one in said)
