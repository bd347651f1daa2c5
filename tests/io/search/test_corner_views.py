"""Corners given by hand: from corners.toml to a rig that holds the truth, or one sentence on what is wrong."""

import re

import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.io.config.corners_toml import PointedCorners, keep_corners
from quadrig.io.config.rig_toml import read_config
from quadrig.io.rig_file.rig_mcap import read_rig
from quadrig.io.search.whole_recording import search_recording
from quadrig.single.errors import QuadrigError

SIGMA = 1.0


@pytest.fixture(scope="module")
def court(load_script):
    return load_script("tests/io/court_room.py")


@pytest.fixture
def folder(court, tmp_path):
    """Three pictures, rig.toml, and corners clicked with noise."""
    court.write(tmp_path)
    rng = np.random.default_rng(7)
    for camera in court.CAMERAS:
        for rectangle in read_config(tmp_path / "rig.toml").rectangles:
            pixels = court.corners(camera, rectangle) + SIGMA * rng.normal(size=(4, 2))
            keep_corners(tmp_path / "corners.toml", PointedCorners(camera, rectangle, pixels, sigma=SIGMA))
    return tmp_path


def pictures(folder):
    return [str(folder / f"{name}.png") for name in ("left", "middle", "right")]


def test_corners_go_to_a_rig_that_holds_the_truth(court, folder, capsys):
    arguments = ["calibrate", *pictures(folder), "--config", str(folder / "rig.toml"), "-o", str(folder / "rig.mcap")]
    assert run(arguments) == 0
    rig = read_rig(folder / "rig.mcap")
    assert rig.reference == "court"
    for camera in rig.cameras:
        off = camera.rig_from_camera.step_to(court.camera_from_court(camera.name).inverse())
        # Chi-square of six degrees of freedom: 1 in 1000 lies beyond 22.5.
        assert off @ np.linalg.solve(rig.pose_covariance(camera.name), off) < 22.5
        assert abs(camera.intrinsics.focal / court.lens(camera.name).focal - 1) < 0.05
    assert "note" not in capsys.readouterr().err


def test_rectangles_without_corners_are_named(folder):
    (folder / "corners.toml").unlink()
    searched = search_recording(pictures(folder), read_config(folder / "rig.toml"))
    assert searched.views == []
    assert [note for note in searched.notes if "rig pick" in note and "'court'" in note]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda at: {"pixels": at[[0, 1, 3, 2]]}, r"corners.toml, line \d+: .*'court' in camera 'left': .*cross"),
        (lambda at: {"pixels": at[::-1]}, r"'court' in camera 'left': .*wrong way; give them as bottom right"),
        (lambda at: {"pixels": np.vstack([at[:3], [[np.nan, np.nan]]])}, r"lack top_right; all four.*rig pick"),
        (
            lambda at: {"pixels": at + np.array([[2000, 0], [0, 0], [0, 0], [0, 0]])},
            r"bottom_right is at .*outside.*1280x720",
        ),
        (lambda _: {"image": 5}, r"image is 5, but the camera has 1 images"),
        (lambda _: {"camera": "centre"}, r"no such camera; its cameras are left, middle, right"),
    ],
)
def test_corners_that_cannot_be_are_one_sentence(court, folder, change, says):
    (folder / "corners.toml").unlink()
    config = read_config(folder / "rig.toml")
    given = {"camera": "left", "pixels": court.corners("left", court.COURT)}
    given |= change(given["pixels"])
    keep_corners(folder / "corners.toml", PointedCorners(rectangle=config.rectangles[0], **given))
    with pytest.raises(QuadrigError, match=says) as raised:
        search_recording(pictures(folder), read_config(folder / "rig.toml"))
    assert "\n" not in str(raised.value)


def test_a_corner_outside_its_picture_leaves_out_its_view_alone(court, folder):
    config = read_config(folder / "rig.toml")
    pixels = court.corners("left", court.COURT)
    pixels[1] = 1e200, 5
    keep_corners(folder / "corners.toml", PointedCorners("left", config.rectangles[0], pixels))
    searched = search_recording(pictures(folder), read_config(folder / "rig.toml"))
    assert len(searched.views) == len(config.rectangles) * len(court.CAMERAS) - 1
    (said,) = (note for note in searched.notes if "outside the picture of 1280x720" in note)
    assert said.startswith("left out: ")
    assert "bottom_left is at 1e+200, 5" in said


def test_a_moving_rectangle_is_of_one_image(court, folder, tmp_path):
    text = (folder / "rig.toml").read_text().replace('"tennis court"', '"tennis court"\nmoving = true', 1)
    text = re.sub(r"world_from_rect = .*\n", "", text).replace('reference = "court"\n', "")
    (folder / "rig.toml").write_text(text)
    series = tmp_path / "series"
    for camera in court.CAMERAS:
        (series / camera).mkdir(parents=True)
        for number in range(3):
            (series / camera / f"{number}.png").write_bytes((folder / f"{camera}.png").read_bytes())
    config = read_config(folder / "rig.toml")
    with pytest.raises(QuadrigError, match=r"'court' in camera 'left': the rectangle moves; say in which"):
        search_recording(series, config)
    (folder / "corners.toml").unlink()
    keep_corners(
        folder / "corners.toml",
        PointedCorners("left", config.rectangles[0], court.corners("left", court.COURT), image=2),
    )
    (view,) = search_recording(series, read_config(folder / "rig.toml")).views
    assert view.frameset == 2
