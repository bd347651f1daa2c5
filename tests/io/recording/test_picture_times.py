"""Folders and patterns of pictures: which belong together is known by numbers, EXIF or a rate, and never made up."""

from io import BytesIO

import cv2
import numpy as np
import pytest
from PIL import Image

from quadrig.io.commands.main import run
from quadrig.io.recording.framesets import NO_FRAME, build_framesets
from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.single.errors import QuadrigError

EXIF, TAKEN, FRACTION, ORIENTATION = 0x8769, 0x9003, 0x9291, 0x0112


def save(path, picture, second=None, orientation=None):
    """A JPEG of a BGR picture, taken so many seconds after noon by its EXIF."""
    path.parent.mkdir(parents=True, exist_ok=True)
    exif = Image.Exif()
    if orientation is not None:
        exif[ORIENTATION] = orientation
    if second is not None:
        whole, part = divmod(round(second * 100), 100)
        exif[EXIF] = {TAKEN: f"2024:05:01 12:{whole // 60:02}:{whole % 60:02}", FRACTION: f"{part:02}"}
    stream = BytesIO()
    Image.fromarray(np.ascontiguousarray(picture[..., ::-1])).save(stream, "JPEG", exif=exif, quality=95)
    path.write_bytes(stream.getvalue())


def paired(recording, pictures):
    """What the cameras show in each frameset, None where a camera has no image."""
    found = build_framesets(recording)
    return [
        tuple(pictures.number(recording.frame(camera, k)) if k != NO_FRAME else None
              for camera, k in zip(found.cameras, row, strict=True))
        for row in found.frames.tolist()
    ]  # fmt: skip


def folders(tmp_path, pictures, left, right, **taken):
    """Picture k of each camera shows k; left and right: numbers in the names; taken: seconds of EXIF."""
    for side, numbers in {"left": left, "right": right}.items():
        for k, number in enumerate(numbers):
            second = taken[f"{side}_taken"][k] if taken else None
            save(tmp_path / side / f"IMG_{number}.jpg", pictures.picture(k), second)
    return tmp_path


def test_shared_numbers_are_instants_without_a_time(tmp_path, pictures):
    recording = open_recording(folders(tmp_path, pictures, range(1000, 1006), range(1000, 1006)))
    assert paired(recording, pictures) == [(k, k) for k in range(6)]
    assert not any(camera.source.timed for camera in recording.cameras)
    assert "pictures with the same number in their names are taken as one instant" in recording.notes[0]


def test_singles_that_one_camera_may_have_taken_are_said_to_be_of_several(tmp_path, pictures):
    for name in ("left01", "left02", "left03", "door"):
        save(tmp_path / f"{name}.jpg", pictures.picture(0))
    recording = open_recording(sorted(tmp_path.glob("left*.jpg")))
    assert recording.notes == (
        "3 single pictures are taken as those of 3 cameras at one instant; where one camera took them, give their "
        "folder",
    )
    assert open_recording([tmp_path / "left01.jpg", tmp_path / "door.jpg"]).notes == ()


def test_numbers_that_do_not_match_are_named_and_nothing_is_paired(tmp_path, pictures):
    recording = open_recording(folders(tmp_path, pictures, range(1000, 1006), range(1137, 1143)))
    assert recording.notes == (
        "the numbers in the pictures' names do not match between cameras (left 1000 to 1005, right 1137 to 1142), "
        "and they carry no time, so no two are taken as one instant; where picture k of each camera is, in the order "
        "of their names, give --rate",
    )
    assert build_framesets(recording).sizes().max() == 1
    with_rate = open_recording(tmp_path, rate=4.0)
    assert with_rate.notes == ()
    assert paired(with_rate, pictures) == [(k, k) for k in range(6)]
    assert with_rate.cameras[0].stamps.tolist() == [250_000_000 * k for k in range(6)]
    assert all(camera.source.timed for camera in with_rate.cameras)


def test_exif_pairs_what_numbers_cannot(tmp_path, pictures):
    seconds = [0.0, 1.5, 3.25, 7.0, 8.0, 20.0]
    recording = open_recording(
        folders(tmp_path, pictures, range(1000, 1006), range(1137, 1143),
                left_taken=seconds, right_taken=[second + 0.1 for second in seconds])
    )  # fmt: skip
    assert paired(recording, pictures) == [(k, k) for k in range(6)]
    assert "they are paired by the times in their EXIF" in recording.notes[0]
    assert np.diff(recording.cameras[0].stamps).tolist() == [round(1e9 * step) for step in np.diff(seconds)]


def test_the_same_numbers_taken_one_after_another_are_not_paired(tmp_path, pictures):
    recording = open_recording(
        folders(tmp_path, pictures, range(1, 7), range(1, 7),
                left_taken=[3.0 * k for k in range(6)], right_taken=[300 + 4.5 * k for k in range(6)])
    )  # fmt: skip
    assert build_framesets(recording).sizes().max() == 1
    assert "were taken at other times by their EXIF" in recording.notes[0]


def test_bursts_of_whole_seconds_are_no_clock(tmp_path, pictures):
    recording = open_recording(
        folders(
            tmp_path,
            pictures,
            range(1000, 1004),
            range(1137, 1141),
            left_taken=[0, 0, 1, 1],
            right_taken=[0, 0, 1, 1],
        )
    )
    assert build_framesets(recording).sizes().max() == 1


def test_a_rate_keeps_the_gaps_that_numbers_show(tmp_path, pictures):
    recording = open_recording(folders(tmp_path, pictures, [1, 2, 5], [1, 2, 5]), rate=2.0)
    assert recording.cameras[0].stamps.tolist() == [500_000_000, 1_000_000_000, 2_500_000_000]
    with pytest.raises(QuadrigError, match="--rate 0"):
        open_recording(tmp_path, rate=0)


def test_pictures_without_times_beside_a_recording_with_times(tmp_path, pictures):
    av = pytest.importorskip("av")
    folders(tmp_path, pictures, range(4), ())
    with av.open(str(tmp_path / "cam.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.width, stream.height, stream.pix_fmt = pictures.WIDTH, pictures.HEIGHT, "yuv420p"
        for k in range(4):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pictures.picture(k), format="bgr24")))
        container.mux(stream.encode(None))
    with pytest.raises(QuadrigError, match="pictures of 'left' carry no time and those of 'cam' do"):
        open_recording([tmp_path / "left", tmp_path / "cam.mp4"])
    assert paired(open_recording([tmp_path / "left", tmp_path / "cam.mp4"], rate=10), pictures) == [
        (k, k) for k in range(4)
    ]


def test_several_cameras_in_one_folder_by_a_pattern(tmp_path, pictures, capsys):
    for camera in ("a", "b", "c"):
        for k in range(4):
            save(tmp_path / f"camera_{camera}_{k:03}.jpg", pictures.picture(k))
    pattern = tmp_path / "camera_{camera}_*.jpg"
    recording = open_recording(pattern)
    assert [camera.name for camera in recording.cameras] == ["a", "b", "c"]
    assert paired(recording, pictures) == [(k, k, k) for k in range(4)]
    assert len(recording.files) == 12
    assert run(["record", str(pattern), "-o", str(tmp_path / "room.mcap")]) == 0
    said = capsys.readouterr()
    assert "written as one picture a second, for want of a time; give --rate" in said.err
    assert [camera.name for camera in open_recording(tmp_path / "room.mcap").cameras] == ["a", "b", "c"]
    # The folder itself is one camera, whose numbers repeat.
    assert "give a pattern: 'FOLDER/camera_{camera}_*.jpg'" in open_recording(tmp_path).notes[0]
    with pytest.raises(QuadrigError, match="no image file matches"):
        open_recording(tmp_path / "eye_{camera}_*.jpg")


def test_a_pattern_of_folders(tmp_path, pictures):
    for camera in ("left", "right"):
        for k in range(3):
            save(tmp_path / camera / f"{camera}-{k}.jpg", pictures.picture(k))
    save(tmp_path / "left" / "right-9.jpg", pictures.picture(9))
    recording = open_recording(tmp_path / "{camera}" / "{camera}-*.jpg")
    assert [(camera.name, camera.frames) for camera in recording.cameras] == [("left", 3), ("right", 3)]


def test_a_picture_by_name_is_a_camera(tmp_path, pictures, capsys):
    for side, number in {"left": 1000, "right": 1137}.items():
        save(tmp_path / f"IMG_{number}.jpg", pictures.picture(3))
        (tmp_path / side).mkdir()
    given = ["--camera", f"left={tmp_path}/IMG_1000.jpg", "--camera", f"right={tmp_path}/IMG_1137.jpg"]
    assert run(["record", *given, "-o", str(tmp_path / "pair.mcap")]) == 0
    assert capsys.readouterr().err == ""
    assert paired(open_recording(tmp_path / "pair.mcap"), pictures) == [(3, 3)]


def test_pictures_of_another_size_or_turn_are_counted_and_named(tmp_path, pictures):
    for k in range(6):
        save(tmp_path / "left" / f"{k}.jpg", pictures.picture(k), orientation=6)
    save(tmp_path / "left" / "0.jpg", cv2.resize(pictures.picture(0), (48, 32)), orientation=6)
    save(tmp_path / "left" / "7.jpg", pictures.picture(7), orientation=8)
    save(tmp_path / "left" / "8.jpg", pictures.picture(8))
    recording = open_recording(tmp_path)
    assert (recording.cameras[0].width, recording.cameras[0].height) == (64, 96)
    assert recording.cameras[0].frames == 5
    assert recording.notes == (
        "camera 'left': its pictures are turned by 90 degrees, as their EXIF says; its lens is that of such pictures",
        "camera 'left': 3 pictures of another size are left out (the first, 0.jpg, is 32x48, not 64x96)",
    )


def test_turned_pictures_stay_turned_in_a_recording(tmp_path, pictures):
    for k in range(3):
        save(tmp_path / "left" / f"{k}.jpg", np.rot90(pictures.picture(k)), orientation=6)
    assert run(["record", str(tmp_path / "left"), "-o", str(tmp_path / "a.mcap")]) == 0
    recording = open_recording(tmp_path / "a.mcap")
    assert paired(recording, pictures) == [(k,) for k in range(3)]
    assert any("turned by 90 degrees" in note for note in recording.notes)


def rows(line, order=None):
    """A line of the table for image k of camera c."""
    order = order or [(k, c) for k in range(4) for c in range(2)]
    return "\n".join(
        line.format(k=k, c=c, s=100 + k / 10, ms=100_000 + 100 * k, ns=10**11 + k * 10**8) for k, c in order
    )


TABLES = {
    "caliscope": "sync_index,cam_id,frame_time\n" + rows("{k},{c},{s}"),
    "numbered": "frame_index,camera,timestamp\n" + rows("{k},cam{c},{s}"),
    "backwards": "frame,camera,t\n" + rows("{k},cam{c},{s}", [(k, c) for c in (1, 0) for k in (3, 2, 1, 0)]),
    "nanoseconds": "camera;timestamp [ns]\n" + rows("cam{c};{ns}"),
    "milliseconds": "Camera, Frame, time_ms\n" + rows("cam{c}, {k}, {ms}"),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_by_their_header(tmp_path, pictures, name):
    for c in range(2):
        for k in range(4):
            save(tmp_path / f"cam{c}" / f"{k}.jpg", pictures.picture(k))
    table = tmp_path / "timestamps.csv"
    table.write_text(TABLES[name])
    inputs = [str(tmp_path / f"cam{c}") for c in range(2)]
    assert run(["record", *inputs, "--timestamps", str(table), "-o", str(tmp_path / "a.mcap")]) == 0
    recording = open_recording(tmp_path / "a.mcap")
    assert recording.cameras[1].stamps.tolist() == [100 * 10**9 + k * 10**8 for k in range(4)]
    assert paired(recording, pictures) == [(k, k) for k in range(4)]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("cam,shutter,iso\n0,1,2\n", "no column is a time; its header has cam, shutter, iso"),
        ("", "no column is a time; its header has nothing"),
        ("camera,time\n", "no rows"),
        ("time\n1\n2\n", "no column says the camera, and there are 2"),
        ("camera,time\ncam0,1\ncam1,soon\n", "'soon' is no time"),
        ("camera,time\ncam0,1\ncam1\n", "not numbers"),
        ("camera,time\ncam0,1e400\ncam1,1\n", "is no time"),
        ("camera,frame,time\ncam0,99999999999999999999,1\ncam1,0,1\n", "is no number of an image"),
        ("camera,time\nleft,1\nright,1\n", "no rows for camera 'cam0'; it has left, right"),
    ],
)
def test_a_table_that_does_not_fit_says_what_was_found(tmp_path, pictures, capsys, text, words):
    for c in range(2):
        save(tmp_path / f"cam{c}" / "0.jpg", pictures.picture(0))
    table = tmp_path / "timestamps.csv"
    table.write_text(text)
    inputs = [str(tmp_path / f"cam{c}") for c in range(2)]
    assert run(["record", *inputs, "--timestamps", str(table), "-o", str(tmp_path / "a.mcap")]) == 1
    assert words in capsys.readouterr().err
