"""rig record: what goes in comes out, at the right time; and videos and folders are recordings themselves."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.io.recording.framesets import NO_FRAME, build_framesets
from quadrig.io.recording.image_source import McapImages
from quadrig.io.recording.recorded_cameras import open_recording

av = pytest.importorskip("av")


def write_video(path, pictures, codec="libx264", count=12, rate=25, **options):
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate, options={key: str(value) for key, value in options.items()})
        stream.width, stream.height, stream.pix_fmt = pictures.WIDTH, pictures.HEIGHT, "yuv420p"
        for k in range(count):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pictures.picture(k), format="bgr24")))
        container.mux(stream.encode(None))


def shown(recording, camera, pictures):
    return [pictures.number(image) for image in recording.camera(camera).source.images() if image is not None]


@pytest.mark.parametrize(
    ("name", "codec", "options"),
    [
        ("cam0.mp4", "libx264", {"g": 5, "bf": 2}),
        ("cam0.mkv", "libx264", {"g": 4, "bf": 0}),
        ("cam0.avi", "mpeg4", {"g": 6}),
        ("cam0.avi", "mjpeg", {}),
        ("cam0.mp4", "libx265", {"x265-params": "log-level=none:keyint=6"}),
    ],
)
def test_video_is_a_recording(tmp_path, pictures, name, codec, options):
    if codec == "mjpeg":
        writer = cv2.VideoWriter(str(tmp_path / name), cv2.VideoWriter.fourcc(*"MJPG"), 25, (96, 64))
        for k in range(12):
            writer.write(pictures.picture(k))
        writer.release()
    else:
        write_video(tmp_path / name, pictures, codec, **options)
    recording = open_recording([tmp_path / name])
    camera = recording.camera("cam0")
    assert (camera.width, camera.height, camera.frames) == (96, 64, 12)
    assert shown(recording, "cam0", pictures) == list(range(12))
    assert np.diff(camera.stamps) == pytest.approx(np.full(11, 0.04e9), abs=1e6)
    # Any images, found from the key frame before them, and in batches that together are all.
    assert [pictures.number(image) for image in camera.source.part(np.array([3, 7, 8])).images()] == [3, 7, 8]
    assert pictures.number(recording.frame("cam0", 10)) == 10
    batches = camera.source.batches(np.arange(12), 3)
    assert np.concatenate(batches).tolist() == list(range(12))
    assert [pictures.number(image) for batch in batches for image in camera.source.part(batch).images()] == [
        *range(12)
    ]


def test_videos_to_mcap_with_a_table_of_times(tmp_path, pictures, capsys):
    for k in range(2):
        write_video(tmp_path / f"cam_{k}.mp4", pictures)
    table = tmp_path / "times.csv"
    rows = [f"{k},{cam},{40 + k},{1700000000 + 0.1 * k + 0.003 * cam:.6f}" for k in range(12) for cam in (1, 0)]
    table.write_text("sync_index,cam_id,frame_index,frame_time\n" + "\n".join(rows))
    videos = [str(tmp_path / f"cam_{k}.mp4") for k in range(2)]
    for form in ("foxglove", "ros2"):
        out = tmp_path / f"{form}.mcap"
        assert run(["record", *videos, "--timestamps", str(table), "-o", str(out), "--format", form]) == 0
        recording = open_recording([out])
        assert [camera.name for camera in recording.cameras] == ["cam_0", "cam_1"]
        for k, camera in enumerate(recording.cameras):
            assert camera.stamps.tolist() == [
                1_700_000_000_000_000_000 + 10**8 * n + 3 * 10**6 * k for n in range(12)
            ]
            assert shown(recording, camera.name, pictures) == list(range(12))
            assert camera.encoding == "jpeg"
    assert capsys.readouterr().err == ""
    table.write_text("cam_id,frame_index,frame_time\n0,3,1.0\n1,3,1.0\n1,4,1.1\n")
    assert run(["record", *videos, "--timestamps", str(table), "-o", str(tmp_path / "few.mcap")]) == 0
    assert "'cam_0': 11 of 12 images have no row" in capsys.readouterr().err
    assert [camera.frames for camera in open_recording([tmp_path / "few.mcap"]).cameras] == [1, 2]
    table.write_text("cam_id,frame_index,frame_time\n7,0,1.0\n")
    assert run(["record", *videos, "--timestamps", str(table), "-o", str(tmp_path / "no.mcap")]) == 1
    assert "no rows for camera 'cam_0'" in capsys.readouterr().err
    assert not (tmp_path / "no.mcap").exists()


def test_png_keeps_every_bit_of_a_video(tmp_path, pictures):
    write_video(tmp_path / "cam0.mp4", pictures)
    assert run(["record", str(tmp_path / "cam0.mp4"), "--images", "png", "-o", str(tmp_path / "a.mcap")]) == 0
    video, copy = open_recording([tmp_path / "cam0.mp4"]), open_recording([tmp_path / "a.mcap"])
    for k in range(12):
        assert np.array_equal(video.frame("cam0", k), copy.frame("cam0", k))


def test_image_files_pair_by_their_numbers_and_are_copied(tmp_path, pictures):
    numbers = {"left": [1, 2, 3, 5, 10], "right": [2, 3, 4, 5, 10]}
    for side, taken in numbers.items():
        for k in taken:
            cv2.imwrite(str(tmp_path / f"{side}{k:02}.png"), pictures.picture(k))
    given = [part for side in numbers for part in ("--camera", f"{side}={tmp_path}/{side}*.png")]
    assert run(["record", *given, "-o", str(tmp_path / "a.mcap")]) == 0
    recording = open_recording([tmp_path / "a.mcap"])
    framesets = build_framesets(recording)
    pairs = [
        tuple(pictures.number(recording.frame(camera, k)) if k != NO_FRAME else None
              for camera, k in zip(framesets.cameras, row, strict=True))
        for row in framesets.frames.tolist()
    ]  # fmt: skip
    assert pairs == [(1, None), (2, 2), (3, 3), (None, 4), (5, 5), (10, 10)]
    source = recording.camera("left").source
    assert isinstance(source, McapImages)
    with source.messages.opened() as opened:
        assert opened.image(0).data == (tmp_path / "left01.png").read_bytes()


def test_folders_are_a_recording(tmp_path, pictures):
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        for k in (3, 1, 11, 2):
            cv2.imwrite(str(tmp_path / side / f"frame {k} of 12.jpg"), pictures.picture(k))
    recording = open_recording([tmp_path])
    assert [camera.name for camera in recording.cameras] == ["left", "right"]
    assert shown(recording, "left", pictures) == [1, 2, 3, 11]
    assert len(build_framesets(recording)) == 4


def test_names_that_are_times(tmp_path, pictures):
    times = [1403636579763555584, 1403636579813555456]
    for k, stamp in enumerate(times):
        cv2.imwrite(str(tmp_path / f"{stamp}.png"), pictures.picture(k))
    assert open_recording([tmp_path]).cameras[0].stamps.tolist() == times


def test_real_pairs_and_webcams(tmp_path, shared_data, capsys):
    stereo = tmp_path / "stereo.mcap"
    sides = [part for side in ("left", "right") for part in ("--camera", f"{side}={shared_data}/stereo/{side}*.jpg")]
    assert run(["record", *sides, "-o", str(stereo)]) == 0
    assert run(["info", str(stereo), "--json"]) == 0
    printed = capsys.readouterr().out
    info = json.loads(printed[printed.index("{") :])
    assert info["framesets"] == {"count": 13, "tolerance_s": 0.5, "shared": 13, "complete": 13}
    assert info["cameras"]["left"]["frames"] == 13
    webcams = open_recording([shared_data / "webcams"])
    assert [(camera.name, camera.frames) for camera in webcams.cameras] == [(f"cam_{k}", 111) for k in range(4)]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["record", "--config", "absent.toml"], "there is no such file"),
        (["record", "--camera", "left"], "NAME=VIDEO"),
        (["record", "--camera", "left=none*.jpg"], "no image file matches"),
        (["record", "absent.mp4"], "no such file"),
        (["info", "absent.mcap"], "no such file"),
    ],
)
def test_what_is_wrong_is_one_line(arguments, words, capsys):
    assert run(arguments) == 1
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert "Traceback" not in said


@pytest.fixture(scope="module")
def numbered(load_script):
    """numbered.stream(...): a motion-JPEG stream on 127.0.0.1."""
    return load_script("tests/io/live/capture/numbered_pictures.py")


def test_live_cameras_are_recorded_as_they_come(tmp_path, numbered, capsys):
    room = tmp_path / "room.mcap"
    with numbered.stream() as left, numbered.stream() as right:
        assert run(["record", f"left={left}", f"right={right}", "--seconds", "2", "-o", str(room)]) == 0
        said = capsys.readouterr()
        assert "2 s are over" in said.out
        assert "left is running" in said.err
        recording = open_recording([room])
        assert [camera.name for camera in recording.cameras] == ["left", "right"]
        for camera in recording.cameras:
            assert camera.frames > 10
            assert f"{camera.name}: {camera.frames} images {camera.width}x{camera.height}" in said.out
            assert np.diff(camera.stamps).min() > 0
            # The bytes are those of the stream.
            shown = [numbered.jpeg(number) for number in range(200)]
            assert isinstance(camera.source, McapImages)
            with camera.source.messages.opened() as opened:
                assert opened.image(3).data in shown
        # What was recorded is not recorded over without being asked.
        assert run(["record", f"left={left}", "--seconds", "1", "-o", str(room)]) == 1
        assert "is there already" in capsys.readouterr().err
        assert run(["record", f"left={left}", "--seconds", "1", "--again", "-o", str(room)]) == 0
        assert [camera.name for camera in open_recording([room]).cameras] == ["left"]


def test_the_sources_of_rig_toml_are_recorded(tmp_path, numbered, pictures):
    sheet = '[[rectangle]]\nname = "a"\nsize = "A4"\nmarking = { kind = "plain" }\n'
    table = '[[camera]]\nname = "porch"\nsource = "{}"\n'
    with numbered.stream() as address:
        (tmp_path / "rig.toml").write_text(sheet + table.format(address))
        given = ["--config", str(tmp_path / "rig.toml"), "-o", str(tmp_path / "live.mcap"), "--seconds", "1"]
        assert run(["record", *given]) == 0
    assert [camera.name for camera in open_recording([tmp_path / "live.mcap"]).cameras] == ["porch"]
    # Sources that are files are turned into a recording, each under its camera's name.
    write_video(tmp_path / "a.mp4", pictures)
    (tmp_path / "rig.toml").write_text(sheet + table.format("a.mp4"))
    assert run(["record", "--config", str(tmp_path / "rig.toml"), "-o", str(tmp_path / "file.mcap")]) == 0
    assert shown(open_recording([tmp_path / "file.mcap"]), "porch", pictures) == list(range(12))


def test_no_live_picture_leaves_no_recording(tmp_path, capsys):
    room = tmp_path / "room.mcap"
    assert run(["record", "http://127.0.0.1:9/none", "--seconds", "1", "-o", str(room)]) == 1
    assert "no source gave a picture: http://127.0.0.1:9/none does not answer" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert run(["record", "0", "--format", "ros2", "-o", str(room)]) == 1
    assert "--format foxglove" in capsys.readouterr().err


def test_ctrl_c_ends_a_live_recording_whole(tmp_path, numbered):
    room = tmp_path / "room.mcap"
    with numbered.stream() as address:
        process = subprocess.Popen(
            [str(Path(sys.executable).with_name("rig")), "record", f"left={address}", "-o", str(room)],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        while process.poll() is None and not (room.exists() and room.stat().st_size > 20_000):
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=20)
    assert process.returncode == 0
    assert "interrupted" in said
    recording = open_recording([room])
    assert recording.indexed
    assert recording.cameras[0].frames > 2


def test_a_video_that_is_none(tmp_path, capsys):
    (tmp_path / "a.mp4").write_bytes(b"not a video at all")
    assert run(["info", str(tmp_path / "a.mp4")]) == 1
    assert "cannot be read as a video" in capsys.readouterr().err


def test_info_of_a_rig_says_the_rig(tmp_path, capsys):
    from quadrig.io.rig_file.rig_mcap import write_rig
    from quadrig.rig.result import Camera, Rig
    from quadrig.single.lens import Intrinsics
    from quadrig.single.pose import Pose

    camera = Camera("porch", Intrinsics.centred(640, 480, 500.0), Pose.identity())
    write_rig(tmp_path / "rig.mcap", Rig("porch", (camera,), (), np.zeros((15, 15))))
    assert run(["info", str(tmp_path / "rig.mcap")]) == 0
    assert "porch" in capsys.readouterr().out
    assert run(["info", str(tmp_path / "rig.mcap"), "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)["cameras"]) == ["porch"]
