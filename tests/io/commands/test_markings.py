"""`rig calibrate` with markings that people own, on rendered pictures with a lens's bend, blur, noise and tone."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.io.config.rig_toml import RigConfig, config_text, read_config
from quadrig.io.rig_file.rig_mcap import read_rig
from quadrig.io.search import plain_sights
from quadrig.single.arrays import Floats
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.april_grid import AprilGridMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.circle_grid import CircleGridMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Marking, Rectangle
from quadrig.single.render.capture import SRGB, Capture
from quadrig.single.render.picture import Sheet, ray_grid, render_image

LENSES = (
    Intrinsics(640, 480, 640.0, np.array([322.0, 237.0]), np.array([-0.18, 0.05, 3e-4, -2e-4, 0.0])),
    Intrinsics(640, 480, 700.0, np.array([316.0, 243.0]), np.array([-0.1, 0.02, -2e-4, 4e-4, 0.0])),
)
FRAMES = 9
KALIBR = """
target_type: 'aprilgrid' #gridtype
tagCols: 5               #number of apriltags
tagRows: 4               #number of apriltags
tagSize: 0.036           #size of apriltag, edge to edge [m]
tagSpacing: 0.3          #ratio of space between tags to tagSize
"""


def board(marking: Marking, back: bool = False) -> Rectangle:
    assert marking.size is not None
    return Rectangle("board", *marking.size, marking, moving=True, back=back)


def record(folder: Path, rectangle: Rectangle, cameras: tuple[Pose, ...], seed: int = 0) -> None:
    """A folder of pictures for each of the cameras (camera_from_world), the board turning before them."""
    rng = np.random.default_rng(seed)
    poses = [
        Pose.from_vectors(rng.uniform(-0.5, 0.5, 3) * [1, 1, 2], np.array([*rng.uniform(-0.06, 0.06, 2), 0.62]))
        for _ in range(FRAMES)
    ]
    capture = Capture(blur=0.7, noise=2.0, curve=SRGB, jpeg=92, slope=(0.15, -0.1))
    for number, (lens, camera) in enumerate(zip(LENSES, cameras, strict=True)):
        grid = ray_grid(lens)
        (folder / f"cam{number}").mkdir(parents=True)
        for frame, pose in enumerate(poses):
            shown = {"background": 0.3, "capture": capture, "samples": 4, "colour": False, "rng": rng}
            image = render_image(grid, camera, [Sheet(rectangle, pose)], **shown)
            cv2.imwrite(str(folder / f"cam{number}" / f"{frame:03}.png"), image)


BESIDE = (Pose.identity(), Pose.from_vectors(np.array([0.0, 0.25, 0.05]), np.array([-0.16, 0.01, 0.03])))
# Half a turn about the upright axis through the board: the second camera stands behind it.
BEHIND = (Pose.identity(), Pose.from_vectors(np.array([0.0, np.pi - 0.1, 0.0]), np.array([0.05, 0.0, 1.22])))


def calibrate(folder: Path) -> list[str]:
    """The command for a recording and a rig.toml in a folder."""
    cameras = [str(folder / "room" / f"cam{k}") for k in (0, 1)]
    files = ["--config", str(folder / "rig.toml"), "-o", str(folder / "rig.mcap")]
    return ["calibrate", *cameras, *files, "--workers", "1", "--no-cache"]


def surprise(rig, cameras: tuple[Pose, ...]) -> Floats:
    """How many of its own sigmas (6,) the second camera's pose in the first one's frame is off the truth."""
    one, two = (rig.camera(f"cam{k}").rig_from_camera for k in (0, 1))
    found, truth = one.inverse() @ two, cameras[0] @ cameras[1].inverse()
    turn = cv2.Rodrigues(truth.rotation.T @ found.rotation)[0].ravel()
    step = np.concatenate([turn, truth.rotation.T @ (found.translation - truth.translation)])
    return step / np.sqrt(rig.relative_covariance("cam0", "cam1").diagonal())


@pytest.mark.parametrize(
    ("marking", "cameras"),
    [
        (AprilGridMarking(5, 4, 0.036, 0.3), BESIDE),
        (CircleGridMarking(7, 6, 0.032), BESIDE),
        (CircleGridMarking(4, 9, 0.024, asymmetric=True), BESIDE),
        (CharucoMarking(7, 5, 0.036, 0.027, "aruco_4x4_50"), BEHIND),
    ],
    ids=["aprilgrid", "circles", "acircles", "behind"],
)
def test_a_rig_comes_out_within_its_sigmas(tmp_path, marking, cameras):
    rectangle = board(marking, back=cameras is BEHIND)
    record(tmp_path / "room", rectangle, cameras)
    if marking.kind == "aprilgrid":
        (tmp_path / "april.yaml").write_text(KALIBR)
        (tmp_path / "rig.toml").write_text('[[rectangle]]\nname = "board"\nmoving = true\ntarget = "april.yaml"\n')
        assert read_config(tmp_path / "rig.toml").rectangles == (rectangle,)
    else:
        (tmp_path / "rig.toml").write_text(config_text(RigConfig((rectangle,))))
    assert run(calibrate(tmp_path)) == 0
    rig = read_rig(tmp_path / "rig.mcap")
    assert [camera.views for camera in rig.cameras] == [pytest.approx(FRAMES, abs=1)] * 2
    assert np.abs(surprise(rig, cameras)).max() < 3.5
    for camera, lens in zip(rig.cameras, LENSES, strict=True):
        assert abs(camera.intrinsics.focal - lens.focal) < 0.01 * lens.focal


GIVEN = board(CharucoMarking(6, 4, 0.036, 0.027, "aruco_4x4_50"))


@pytest.mark.parametrize(
    ("shown", "given", "cameras", "said"),
    [
        (GIVEN, GIVEN, BEHIND, ["cam1 sees 'board' mirrored", "back = true"]),
        (
            board(ChessboardMarking(10, 7, 0.022)),
            board(ChessboardMarking(9, 6, 0.022)),
            BESIDE,
            ["9 x 6 are its inner corners", "columns = 10, rows = 7, square = 0.022"],
        ),
        (
            board(CharucoMarking(6, 4, 0.036, 0.027, "aruco_5x5_50")),
            GIVEN,
            BESIDE,
            ["sees tag 0, 1, 2", "of aruco_5x5_50"],
        ),
    ],
    ids=["mirrored", "inner corners", "dictionary"],
)
def test_what_is_in_plain_sight_is_said(tmp_path, capsys, shown, given, cameras, said):
    record(tmp_path / "room", board(shown.marking, back=cameras is BEHIND), cameras)
    (tmp_path / "rig.toml").write_text(config_text(RigConfig((given,))))
    run([*calibrate(tmp_path), "--json"])
    printed = capsys.readouterr()
    for words in said:
        assert words in printed.err
    if cameras is BEHIND:
        assert said[0] in json.loads(printed.out)["missing"]["cam1"]


def test_what_is_in_plain_sight_is_seen_in_smaller_pictures(tmp_path, capsys, monkeypatch):
    """As those of many megapixels are looked at; these are halved."""
    monkeypatch.setattr(plain_sights, "_PIXELS", 80_000)
    record(tmp_path / "room", board(ChessboardMarking(10, 7, 0.022)), BESIDE)
    (tmp_path / "rig.toml").write_text(config_text(RigConfig((board(ChessboardMarking(9, 6, 0.022)),))))
    run(calibrate(tmp_path))
    assert "columns = 10, rows = 7, square = 0.022" in capsys.readouterr().err


def test_one_picture_of_a_kalibr_target(tmp_path, capsys):
    record(tmp_path / "room", board(AprilGridMarking(5, 4, 0.036, 0.3)), BESIDE)
    (tmp_path / "april.yaml").write_text(KALIBR)
    picture = str(tmp_path / "room" / "cam0" / "000.png")
    assert run(["single", picture, "--target", str(tmp_path / "april.yaml"), "--json"]) == 0
    low, high = json.loads(capsys.readouterr().out)["focal_interval_px"]
    assert low - 10 < LENSES[0].focal < high + 10
    # One picture, a lens of which nothing is known, a board as flat and as square as prints are: an interval of 23 %.
    assert high - low < 0.3 * LENSES[0].focal


def test_one_picture_says_it_too(tmp_path, capsys):
    record(tmp_path / "room", board(ChessboardMarking(10, 7, 0.022)), BESIDE)
    picture = str(tmp_path / "room" / "cam0" / "000.png")
    assert run(["single", picture, "--chessboard", "9x6:0.022"]) == 1
    assert "9 x 6 are its inner corners" in capsys.readouterr().err
