"""Rigs and lenses come back from files of every format, and what is wrong with a file is one sentence."""

import json
from dataclasses import replace

import numpy as np
import pytest

from quadrig.io.formats.any_file import read_any_lenses, read_any_rig
from quadrig.io.formats.format import Options
from quadrig.io.formats.maps import ideal_rig
from quadrig.io.formats.registry import export_files
from quadrig.io.rig_file.rig_mcap import write_rig
from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError

POINTS = np.array([[0.1, 0.2, 1.9], [-0.3, 0.1, 2.2], [0.2, -0.2, 2.0]])


def pixels(rig: Rig) -> dict[str, np.ndarray]:
    """The points, given in the first camera's frame, in every picture."""
    points = rig.cameras[0].rig_from_camera.transform(POINTS)
    return {one.name: one.intrinsics.project(one.rig_from_camera.inverse().transform(points)) for one in rig.cameras}


def written(folder, rig, *names, **options):
    """The paths of a rig's files in these formats."""
    files = [file for name in names for file in export_files(rig, name, Options(**options)).items()]
    for name, content in files:
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return [folder / name for name, _ in files]


@pytest.fixture
def fisheyes(example_rig):
    """The same rig seen through fisheye lenses."""
    curved = [replace(one.intrinsics, model="fisheye", distortion=np.array([0.05, -0.02, 0.01, -0.003, 0.0]))
              for one in example_rig.cameras]  # fmt: skip
    cameras = [replace(one, intrinsics=lens) for one, lens in zip(example_rig.cameras, curved, strict=True)]
    return replace(example_rig, cameras=tuple(cameras))


def assert_same(again, rig, tolerance=1e-6):
    assert again.reference == rig.reference
    found, expected = pixels(again), pixels(rig)
    assert found.keys() == expected.keys()
    for camera in expected:
        np.testing.assert_allclose(found[camera], expected[camera], rtol=0, atol=tolerance)


LENSES_AND_POSES = ["json", "opencv", "opencv-xml", "opencv-json", "ros urdf", "ros tf", "kalibr", "anipose",
                    "freemocap", "pose2sim", "nerfstudio"]  # fmt: skip


@pytest.mark.parametrize("lens", ["pinhole", "fisheye"])
@pytest.mark.parametrize("names", LENSES_AND_POSES)
def test_a_rig_comes_back(names, lens, example_rig, fisheyes, tmp_path):
    rig = example_rig if lens == "pinhole" else fisheyes
    assert_same(read_any_rig(*written(tmp_path, rig, *names.split())), rig)


@pytest.mark.parametrize("lens", ["pinhole", "fisheye"])
@pytest.mark.parametrize(("name", "unit"), [("colmap", None), ("colmap-binary", 1.0)])
def test_a_folder_of_colmap_comes_back(name, unit, lens, example_rig, fisheyes, tmp_path):
    rig = example_rig if lens == "pinhole" else fisheyes
    first, *_ = written(tmp_path, rig, name)
    for path in (tmp_path, first):
        assert_same(read_any_rig(path, unit=unit), rig)


def test_mrcal_comes_back(example_rig, tmp_path):
    assert_same(read_any_rig(*written(tmp_path, example_rig, "mrcal")), example_rig)


def test_caliscope_comes_back_with_numbers_for_names(example_rig, tmp_path):
    again = read_any_rig(*written(tmp_path, example_rig, "caliscope"))
    named = [replace(camera, name=f"cam{camera.name}") for camera in again.cameras]
    assert_same(replace(again, reference="cam0", cameras=tuple(named)), example_rig)


def test_usd_comes_back_to_its_floats(example_rig, tmp_path):
    pytest.importorskip("pxr", reason="USD is read by usd-core")
    # Its focal lengths and apertures are float32: 700 px to seven digits.
    assert_same(read_any_rig(*written(tmp_path, ideal_rig(example_rig), "usd")), ideal_rig(example_rig), 3e-4)


@pytest.mark.parametrize("name", ["anipose", "colmap-binary", "nerfstudio"])
def test_a_file_that_does_not_say_its_unit_is_asked_for_it(name, example_rig, tmp_path):
    first, *_ = written(tmp_path, example_rig, name)
    if name != "colmap-binary":
        first.write_text(first.read_text().replace("unit", "remark"))
    with pytest.raises(QuadrigError, match=r"unit of lengths; .* --unit"):
        read_any_rig(first)
    again = read_any_rig(first, unit=1e-3)
    shift = again.camera("cam1").rig_from_camera.translation
    np.testing.assert_allclose(shift, 1e-3 * example_rig.camera("cam1").rig_from_camera.translation, atol=1e-12)


def test_rig_mcap_is_read_too(example_rig, tmp_path):
    write_rig(tmp_path / "rig.mcap", example_rig)
    np.testing.assert_array_equal(read_any_rig(tmp_path / "rig.mcap").covariance, example_rig.covariance)


def test_what_a_file_does_not_say_is_not_a_number(example_rig, tmp_path):
    again = read_any_rig(*written(tmp_path, example_rig, "kalibr"))
    assert np.isnan(again.focal_sigma("cam1"))
    assert np.isnan(again.position_sigma("cam1"))
    assert again.position_sigma("cam0") == 0
    [lens] = [known for name, known in read_any_lenses(tmp_path / "camchain.yaml").items() if name == "cam2"]
    assert np.isnan(lens.covariance).all()


def test_json_holds_sigmas_and_the_covariance_where_asked(example_rig, tmp_path):
    [path] = written(tmp_path, example_rig, "json")
    again = read_any_rig(path)
    np.testing.assert_allclose(np.diag(again.covariance), np.diag(example_rig.covariance), rtol=1e-12)
    assert again.position_sigma("cam1") == pytest.approx(example_rig.position_sigma("cam1"))
    assert np.isnan(again.relative_covariance("cam1", "cam2")).any()
    [path] = written(tmp_path, example_rig, "json", covariance=True)
    np.testing.assert_array_equal(read_any_rig(path).covariance, example_rig.covariance)


def test_json_holds_rectangles(example_rig, tmp_path):
    again = read_any_rig(*written(tmp_path, example_rig, "json"))
    found, expected = ([placed.rectangle for placed in rig.rectangles] for rig in (again, example_rig))
    assert found == expected
    for found, placed in zip(again.rectangles, example_rig.rectangles, strict=True):
        np.testing.assert_allclose(found.rig_from_rect.matrix(), placed.rig_from_rect.matrix(), atol=1e-12)
        np.testing.assert_array_equal(found.framesets, placed.framesets)
        assert np.isnan(found.covariance).all()


def test_one_lens_as_the_calibration_sample_of_opencv_writes_it(tmp_path):
    path = tmp_path / "left.yml"
    path.write_text(
        "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n"
        "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        "   data: [ 536.5, 0., 342.25, 0., 536.75, 235.5, 0., 0., 1. ]\n"
        "distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n"
        "   data: [ -0.28, 0.1, 1.5e-3, -2e-4, 0.01 ]\n"
    )
    lens = read_any_lenses(path)["left"].intrinsics
    assert (lens.width, lens.height, lens.focal, lens.model) == (640, 480, 536.5, "pinhole")
    np.testing.assert_array_equal(lens.camera_matrix[1], [0, 536.75, 235.5])
    np.testing.assert_array_equal(lens.distortion, [-0.28, 0.1, 1.5e-3, -2e-4, 0.01])
    with pytest.raises(QuadrigError, match="'left' has a lens and no pose"):
        read_any_rig(path)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("empty.yml", b"", "0 bytes"),
        ("rig.json", b'{"rig_frame": "cam0", "cameras": {"cam0": {"width": 6', "cannot be read as json"),
        ("rig.json", b'{"rig_frame": "cam0", "cameras": {"cam0": {"width": "wide"}}}', r"cameras\[...\]"),
        ("rig.json", b'{"rig_frame": "cam0", "version": 99, "cameras": {}}', "upgrade"),
        ("rig.yml", b"%YAML:1.0\n---\ncamera_matrix: !!opencv-mat", "rig.yml"),
        ("chain.yaml", b"cam0:\n  camera_model: omni\n  intrinsics: [1, 700, 700, 320, 240]\n"
                       b"  resolution: [640, 480]\n", "pinhole-radtan"),
        ("chain.yaml", b"cam0:\n  camera_model: pinhole\n  intrinsics: [700, 700\n", "cannot be read as kalibr"),
        ("notes.txt", b"nothing of the kind", "none of the formats"),
        ("picture.yml", b"\x89PNG\r\n\x1a\n\x00\xff\xfe", "none of the formats"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_sentence(name, content, sentence, tmp_path, capfd):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(QuadrigError, match=sentence) as caught:
        read_any_rig(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_huge_file_is_refused_at_once(tmp_path):
    with (tmp_path / "rig.yml").open("wb") as stream:
        stream.write(b"%YAML:1.0\n")
        stream.truncate(1 << 30)
    with pytest.raises(QuadrigError, match="which no file of cameras has"):
        read_any_rig(tmp_path / "rig.yml")
    (tmp_path / "chain.yaml").write_text(
        "cam0:\n  camera_model: pinhole\n  intrinsics: [" + "1, " * 2_000_000 + "1]\n"
    )
    with pytest.raises(QuadrigError, match="bytes of YAML are no file of cameras"):
        read_any_rig(tmp_path / "chain.yaml")


def test_aliases_within_aliases_are_one_sentence(tmp_path):
    lines = ["cam0: &a0 {camera_model: pinhole, intrinsics: [1, 1, 1, 1]}"]
    lines += [f"x{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 30)]
    (tmp_path / "chain.yaml").write_text("\n".join(lines))
    with pytest.raises(QuadrigError, match="cannot be read as kalibr"):
        read_any_rig(tmp_path / "chain.yaml")


@pytest.mark.parametrize("names", ["mrcal", "ros urdf", "ros tf"])
def test_a_folder_of_files_is_one_rig(names, example_rig, tmp_path):
    written(tmp_path, example_rig, *names.split())
    (tmp_path / "notes.txt").write_text("nothing of the kind")
    assert_same(read_any_rig(tmp_path), example_rig)


def test_poses_of_two_files_are_in_two_frames(example_rig, tmp_path):
    one, two = (tmp_path / name for name in ("one", "two"))
    for folder, cameras in ((one, example_rig.cameras[:2]), (two, example_rig.cameras[2:])):
        folder.mkdir()
        written(folder, replace(example_rig, cameras=cameras, fits=()), "kalibr")
    with pytest.raises(QuadrigError, match="in a frame of its own"):
        read_any_rig(one / "camchain.yaml", two / "camchain.yaml")


def test_a_folder_that_holds_no_model_is_one_sentence(tmp_path):
    with pytest.raises(QuadrigError, match="the folder is in none of the formats"):
        read_any_rig(tmp_path)
    with pytest.raises(QuadrigError, match="there is no"):
        read_any_rig(tmp_path / "absent.json")


def test_lenses_that_quadrig_does_not_have_are_refused(example_rig, tmp_path):
    [path] = written(tmp_path, example_rig, "json")
    values = json.loads(path.read_text())
    values["cameras"]["cam1"]["distortion"] = [0.1, 0, 0, 0, 0, 0.2, 0, 0]
    path.write_text(json.dumps(values))
    with pytest.raises(QuadrigError, match="camera 'cam1': the lens has 8 coefficients"):
        read_any_rig(path)
