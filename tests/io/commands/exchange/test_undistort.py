"""`rig undistort`: what a lens bent comes out straight."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.io.formats.maps import ideal_lens
from quadrig.io.recording.video import read_video
from quadrig.io.rig_file.rig_mcap import write_rig
from quadrig.single.lens import Intrinsics

SPOTS = np.array([[-0.5, -0.3, 1.0], [0.45, 0.3, 1.0], [0.0, 0.25, 1.0], [0.4, -0.25, 1.0]])


@pytest.fixture(params=["pinhole", "fisheye"])
def lens(request) -> Intrinsics:
    distortion = np.array([-0.25, 0.05, 1e-3, -1e-3, 0.0] if request.param == "pinhole" else [0.1, -0.02, 0, 0, 0])
    return Intrinsics(640, 480, 400.0, np.array([310.0, 250.0]), distortion, aspect=1.01, model=request.param)


@pytest.fixture
def rig(lens, example_rig, tmp_path):
    cameras = [replace(example_rig.cameras[0], intrinsics=lens), *example_rig.cameras[1:]]
    write_rig(tmp_path / "rig.mcap", replace(example_rig, cameras=tuple(cameras)))
    return str(tmp_path / "rig.mcap")


def spotted(lens: Intrinsics) -> np.ndarray:
    """A picture (480, 640, 3) of a blurred spot at each of SPOTS."""
    rows, columns = np.mgrid[:480, :640]
    away = [np.hypot(columns - x, rows - y) for x, y in lens.project(SPOTS)]
    picture = 255 * np.exp(-((np.min(away, axis=0) / 3) ** 2) / 2)
    return np.repeat(picture.astype(np.uint8)[..., None], 3, axis=2)


def spots_of(picture: np.ndarray, near: np.ndarray) -> np.ndarray:
    """The centre of brightness around each expected place."""
    found = []
    for x, y in near.round().astype(int):
        part = picture[y - 9 : y + 10, x - 9 : x + 10].astype(float)
        rows, columns = np.mgrid[y - 9 : y + 10, x - 9 : x + 10]
        found.append([(columns * part).sum() / part.sum(), (rows * part).sum() / part.sum()])
    return np.array(found)


def test_pictures_come_out_straight(lens, rig, tmp_path):
    folder = tmp_path / "cam0"
    folder.mkdir()
    cv2.imwrite(str(folder / "0001.png"), spotted(lens))
    assert run(["undistort", rig, str(folder), "-o", str(tmp_path / "flat")]) == 0
    picture = cv2.imread(str(tmp_path / "flat" / "cam0" / "0001.png"), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    expected = ideal_lens(lens).project(SPOTS)
    assert np.abs(expected - lens.project(SPOTS)).max() > 5
    np.testing.assert_allclose(spots_of(picture, expected), expected, atol=0.1)


def test_a_video_keeps_its_times(lens, rig, tmp_path):
    av = pytest.importorskip("av", reason="videos need PyAV")
    with av.open(str(tmp_path / "cam0.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 640, 480, "yuv420p"
        for number in (0, 1, 5, 6):
            frame = av.VideoFrame.from_ndarray(spotted(lens), format="bgr24")
            frame.pts = number
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    before = read_video(tmp_path / "cam0.mp4")
    assert run(["undistort", rig, str(tmp_path / "cam0.mp4"), "-o", str(tmp_path / "flat")]) == 0
    after = read_video(tmp_path / "flat" / "cam0.mp4")
    np.testing.assert_array_equal(after.stamps() - after.stamps()[0], before.stamps() - before.stamps()[0])
    expected = ideal_lens(lens).project(SPOTS)
    for picture in after.images(gray=True):
        assert picture is not None
        np.testing.assert_allclose(spots_of(picture, expected), expected, atol=0.2)


def test_what_is_wrong_is_one_sentence(lens, rig, tmp_path, capsys):
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((100, 100), np.uint8))
    (tmp_path / "broken.png").write_bytes(b"\x89PNG broken")
    (tmp_path / "notes.txt").write_text("no picture")
    out = ["-o", str(tmp_path / "flat")]
    for name, camera, sentence in (
        ("small.png", "cam0", "calibrated at 640x480"),
        ("small.png", None, "Give --camera, one of cam0"),
        ("broken.png", "cam0", "cannot be read as a picture"),
        ("notes.txt", "cam0", "no picture, video or folder"),
        ("absent.png", "cam0", "there is no"),
    ):
        asked = [] if camera is None else ["--camera", camera]
        assert run(["undistort", rig, str(tmp_path / name), *asked, *out]) == 1
        said = capsys.readouterr().err
        assert sentence in said
        assert len(said.splitlines()) == 1
    cv2.imwrite(str(tmp_path / "same.png"), spotted(lens))
    assert run(["undistort", rig, str(tmp_path / "same.png"), "--camera", "cam0", "-o", str(tmp_path)]) == 1
    assert "written over" in capsys.readouterr().err


def test_what_is_refused_is_refused_before_anything_is_written(lens, rig, tmp_path, capsys):
    for name in ("cam0", "cam1", "nobody"):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / "0001.png"), spotted(lens))
    whole, picture = str(tmp_path / "cam0"), str(tmp_path / "cam0" / "0001.png")
    for given, words in (
        ([str(tmp_path / "nobody")], "which camera took it"),
        ([str(tmp_path / "cam1")], "is 640x480, the lens was calibrated at 1280x720"),
        ([picture, picture], "would both become"),
    ):
        assert run(["undistort", rig, whole, *given, "-o", str(tmp_path / "flat")]) == 1
        assert words in capsys.readouterr().err
        assert not (tmp_path / "flat").exists()
