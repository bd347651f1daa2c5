"""`rig single` as a person types it: pictures in, lines or JSON out, one sentence where it fails."""

import json
import re

import cv2
import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.blank_sheet import PlainMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.picture import Sheet, render_image
from quadrig.single.rotation import rotation_from_angles

LENS = Intrinsics(800, 600, 750.0, np.array([399.5, 299.5]))
POSE = Pose(rotation_from_angles(np.radians(35), np.radians(15), 0.2), np.array([0.02, 0.01, 0.55]))
CORNERS = LENS.project(POSE.transform(Rectangle("sheet", 0.297, 0.21).corners))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("pictures")
    for name, rectangle in (
        ("plain.png", Rectangle("sheet", 0.297, 0.21, PlainMarking())),
        ("tag.png", Rectangle("tag", 0.16, 0.16, TagMarking("apriltag_36h11", 7))),
    ):
        picture = render_image(LENS, Pose.identity(), [Sheet(rectangle, POSE)])
        cv2.imwrite(str(place / name), picture)
    return place


def answer(capsys, *arguments):
    code = run(["single", *map(str, arguments)])
    said = capsys.readouterr()
    assert code == 0, said.err
    return said.out


def refusal(capsys, *arguments):
    code = run(["single", *map(str, arguments)])
    said = capsys.readouterr()
    assert code == 1
    assert said.out == ""
    assert "Traceback" not in said.err
    assert len(said.err.strip().splitlines()) == 1
    return said.err


def as_text(points):
    return [f"{u:.3f},{v:.3f}" for u, v in points]


def values_of(capsys, *arguments):
    return json.loads(answer(capsys, *arguments, "--json"))


@pytest.mark.parametrize(
    ("picture", "how"),
    [
        ("tag.png", ["--tag", "apriltag_36h11:7", "--width", "0.16"]),
        ("plain.png", ["--paper", "A4"]),
        ("plain.png", ["--width", "0.297", "--height", "0.21", "--plain"]),
        ("plain.png", ["--paper", "a4", "--corners", *as_text(CORNERS)]),
    ],
)
def test_focal_and_pose_with_sigmas(folder, capsys, picture, how):
    values = values_of(capsys, folder / picture, *how, "--principal-point", "399.5,299.5")
    assert abs(values["focal_px"] - 750) < 5 * values["sigma"]["focal_px"] + 0.5
    assert np.allclose(values["rect_from_camera"], POSE.inverse().matrix(), atol=3e-3)
    assert values["focal_interval_px"][0] < 750 < values["focal_interval_px"][1]
    assert values["reason"] == "ok"


def test_lines_for_people_name_what_limits_them(folder, capsys):
    text = answer(capsys, folder / "plain.png", "--paper", "A4", "--sigma", "0.5")
    assert "focal" in text
    assert "+-" in text
    assert re.search(r"\n- the focal is known to [\d.]+ %: take more points of the sheet, or several Views", text)
    far = answer(capsys, folder / "plain.png", "--paper", "A4", "--corners", *as_text(0.4 * CORNERS + 240.0))
    assert re.search(r"the principal point is only known to \d+ px: the focal is known to", far)


def test_corners_in_the_wrong_turn_are_put_right_and_said(folder, capsys):
    y_up = CORNERS[[3, 2, 1, 0]]
    values = values_of(capsys, folder / "plain.png", "--paper", "A4", "--corners", *as_text(y_up), "--focal", "750")
    assert any("wrong way round" in note for note in values["notes"])
    assert values["focal_px"] == 750
    assert np.allclose(values["rect_from_camera"], POSE.inverse().matrix(), atol=5e-3)


def test_a_photographs_own_turn_is_applied(folder, capsys, tmp_path):
    """A phone held upright stores the picture lying down, with EXIF orientation 6: turn it clockwise to see it."""
    upright = cv2.imread(str(folder / "tag.png"))
    assert upright is not None
    lying = cv2.rotate(upright, cv2.ROTATE_90_COUNTERCLOCKWISE)
    _, coded = cv2.imencode(".jpg", lying, [cv2.IMWRITE_JPEG_QUALITY, 97])
    tiff = b"II*\x00\x08\x00\x00\x00" + b"\x01\x00" + b"\x12\x01\x03\x00\x01\x00\x00\x00\x06\x00\x00\x00" + bytes(4)
    segment = b"Exif\x00\x00" + tiff
    marker = b"\xff\xe1" + (len(segment) + 2).to_bytes(2, "big") + segment
    photograph = tmp_path / "phone.jpg"
    photograph.write_bytes(coded.tobytes()[:2] + marker + coded.tobytes()[2:])
    how = ["--tag", "apriltag_36h11:7", "--width", "16cm", "--principal-point", "399.5,299.5"]
    values = values_of(capsys, photograph, *how)
    assert (values["width"], values["height"]) == (800, 600)
    assert np.allclose(values["rect_from_camera"], POSE.inverse().matrix(), atol=3e-3)


def test_save_writes_a_file_that_rerun_reads(folder, capsys, tmp_path):
    from rerun.chunk import RrdReader

    saved = tmp_path / "tag.rrd"
    answer(capsys, folder / "tag.png", "--tag", "apriltag_36h11:7", "--width", "0.16", "--save", saved)
    logged = {chunk.entity_path for chunk in RrdReader(str(saved)).stream().to_chunks()}
    assert {"/sheet", "/camera", "/camera/image", "/camera/image/measured"} <= logged


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.png", "--paper", "A4"], "not there"),
        (["{here}", "--paper", "A9"], "no such paper"),
        (["{here}"], "no size"),
        (["{here}", "--width", "-1mm"], "above zero"),
        (["{here}", "--width", "0", "--height", "0.2"], "above zero"),
        (["{here}", "--width", "160"], "160mm or 160m"),
        (["{here}", "--chessboard", "9x6:25"], "25mm or 25m"),
        (["{here}", "--paper", "A4", "--width", "0.3"], "one of them"),
        (["{here}", "--tag", "apriltag_36h11", "--width", "0.16"], "DICTIONARY:ID"),
        (["{here}", "--tag", "no_such:3", "--width", "0.16"], "no tag dictionary"),
        (["{here}", "--tag", "apriltag_36h11:3", "--width", "0.16"], "was not found"),
        (["{here}", "--chessboard", "9x6"], "COLUMNSxROWS:SQUARE"),
        (["{here}", "--chessboard", "9x6:0"], "above zero"),
        (["{here}", "--charuco", "5x7:0.03:0.02"], "COLUMNSxROWS:SQUARE:MARKER:DICTIONARY"),
        (["{here}", "--paper", "A4", "--tag", "apriltag_36h11:7", "--plain"], "different markings"),
        (["{here}", "--paper", "A4", "--focal", "-5"], "focal"),
        (["{here}", "--paper", "A4", "--sigma", "0"], "--sigma"),
        (["{here}", "--paper", "A4", "--principal-point", "4"], "--principal-point"),
        (["{here}", "--paper", "A4", "--corners", "1,2", "3,4", "5,6", "7"], "--corners"),
        (["{here}", "--paper", "A4", "--corners", "0,0", "10,10", "20,20", "0,30"], "one line"),
        (["{here}", "--paper", "A4", "--corners", "300,220", "110,90", "100,200", "290,60"], "cross"),
        (["{here}", "--paper", "A4", "--save", "no/such/folder/x.rrd"], "no folder"),
    ],
)
def test_what_cannot_be_done_is_one_sentence(folder, capsys, arguments, words):
    given = [str(folder / "plain.png") if word == "{here}" else word for word in arguments]
    assert words in refusal(capsys, *given)


def test_a_file_that_is_no_picture(capsys, tmp_path):
    for content in (b"", b"not a picture"):
        path = tmp_path / "x.jpg"
        path.write_bytes(content)
        assert "not a picture" in refusal(capsys, path, "--paper", "A4")
