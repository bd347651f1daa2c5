"""Files as other programs write them, made with those programs or by their rules, come in as they mean it."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from quadrig.io.formats import any_file
from quadrig.io.formats.any_file import read_any_lenses, read_any_rig
from quadrig.io.formats.format import Held
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose

POINTS = np.array([[0.1, 0.2, 1.9], [-0.3, 0.1, 2.2], [0.2, -0.2, 2.0]])
MATRIX = [[700.0, 0.0, 330.5], [0.0, 702.0, 250.25], [0.0, 0.0, 1.0]]
DISTORTION = [-0.1, 0.02, 1e-3, -2e-3]


def pixels(camera, points=POINTS):
    return camera.intrinsics.project(camera.rig_from_camera.inverse().transform(points))


@pytest.mark.parametrize("binary", [False, True])
def test_a_rig_that_colmap_solved_over_many_frames(binary, tmp_path):
    pycolmap = pytest.importorskip("pycolmap", reason="the model is COLMAP's own")
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig, options.num_points3D = 1, 3, 5, 20
    model = pycolmap.synthesize_dataset(options)
    (model.write_binary if binary else model.write_text)(str(tmp_path))
    with pytest.raises(QuadrigError, match="--unit"):
        read_any_rig(tmp_path)
    found = {camera.name: camera for camera in read_any_rig(tmp_path, unit=1.0).cameras}
    [rig] = model.rigs.values()
    for number, lens in model.cameras.items():
        sensor = pycolmap.sensor_t(type=pycolmap.SensorType.CAMERA, id=number)
        pose = np.eye(4)[:3] if rig.is_ref_sensor(sensor) else rig.sensor_from_rig(sensor).matrix()
        ahead = POINTS + np.array([0.0, 0.0, 6.0])
        expected = lens.img_from_cam(ahead @ pose[:, :3].T + pose[:, 3]) - 0.5
        np.testing.assert_allclose(pixels(found[f"camera{number}"], ahead), expected, atol=1e-9)


def test_pictures_that_no_rig_ties_are_refused(tmp_path):
    pycolmap = pytest.importorskip("pycolmap", reason="the model is COLMAP's own")
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig, options.num_points3D = 2, 1, 3, 20
    pycolmap.synthesize_dataset(options).write_text(str(tmp_path))
    with pytest.raises(QuadrigError, match="no rig says where camera"):
        read_any_rig(tmp_path, unit=1.0)


@pytest.mark.parametrize(
    ("model", "parameters"),
    [
        ("SIMPLE_PINHOLE", [700, 331, 251]),
        ("PINHOLE", [700, 702, 331, 251]),
        ("SIMPLE_RADIAL", [700, 331, 251, -0.1]),
        ("RADIAL", [700, 331, 251, -0.1, 0.02]),
        ("OPENCV", [700, 702, 331, 251, *DISTORTION]),
        ("OPENCV_FISHEYE", [700, 702, 331, 251, 0.05, -0.02, 0.01, -0.003]),
        ("FULL_OPENCV", [700, 702, 331, 251, *DISTORTION, 0.01, 0, 0, 0]),
        ("SIMPLE_RADIAL_FISHEYE", [700, 331, 251, 0.05]),
        ("RADIAL_FISHEYE", [700, 331, 251, 0.05, -0.02]),
    ],
)
def test_every_model_of_colmap_that_is_read_projects_as_colmap_does(model, parameters, tmp_path):
    pycolmap = pytest.importorskip("pycolmap", reason="the model is COLMAP's own")
    numbers = " ".join(str(value) for value in parameters)
    (tmp_path / "cameras.txt").write_text(f"1 {model} 640 480 {numbers}\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 left/shot.jpg\n\n")
    [lens] = read_any_lenses(tmp_path).values()
    camera = pycolmap.Camera(model=model, width=640, height=480, params=parameters)
    np.testing.assert_allclose(lens.intrinsics.project(POINTS), camera.img_from_cam(POINTS) - 0.5, atol=1e-9)


@pytest.mark.parametrize(
    ("model", "parameters", "sentence"),
    [
        ("FOV", [700, 702, 331, 251, 0.9], "model FOV"),
        ("FULL_OPENCV", [700, 702, 331, 251, *DISTORTION, 0, 0.1, 0, 0], "8 coefficients"),
        ("OPENCV", [700, 702, 331, 251], "8 parameters, not 4"),
    ],
)
def test_models_that_quadrig_does_not_have_are_refused(model, parameters, sentence, tmp_path):
    numbers = " ".join(str(value) for value in parameters)
    (tmp_path / "cameras.txt").write_text(f"1 {model} 640 480 {numbers}\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 shot.jpg\n\n")
    with pytest.raises(QuadrigError, match=sentence):
        read_any_lenses(tmp_path)


def pixels_by_opencv(points, rotation_vector, translation):
    found, _ = cv2.projectPoints(points, np.array(rotation_vector), np.array(translation), np.array(MATRIX),
                                 np.array(DISTORTION))  # fmt: skip
    return found[:, 0]


def anipose_table(name: str, translation: list[float], extra: str = "") -> str:
    return (
        f'[{name}]\nname = "{name}"\nsize = [ 640.0, 480.0,]\nmatrix = {MATRIX}\ndistortions = {DISTORTION}\n'
        f"rotation = [ 0.1, -0.2, 0.05,]\ntranslation = {translation}\n{extra}\n"
    )


@pytest.mark.parametrize(
    ("metadata", "extra", "unit"),
    [
        ("[metadata]\ncharuco_square_size = 51.0\n", "", 1e-3),  # freemocap
        ("[metadata]\nadjusted = false\nerror = 0.0\n", "fisheye = false", 1.0),  # Pose2Sim
    ],
)
def test_toml_is_read_in_the_unit_of_its_program(metadata, extra, unit, tmp_path):
    translation = [0.3 / unit, -0.2 / unit, 0.4 / unit]
    (tmp_path / "calib.toml").write_text(anipose_table("cam_0", translation, extra) + metadata)
    [camera] = read_any_rig(tmp_path / "calib.toml").cameras
    expected = pixels_by_opencv(POINTS, [0.1, -0.2, 0.05], [0.3, -0.2, 0.4])
    np.testing.assert_allclose(pixels(camera), expected, atol=1e-9)


def test_kalibr_writes_numbers_that_yaml_takes_for_words(tmp_path):
    (tmp_path / "camchain-imucam.yaml").write_text(
        "cam0:\n  cam_overlaps: [1]\n  camera_model: pinhole\n  distortion_coeffs: [-0.1, 2e-2, 1e-05, -2e-3]\n"
        "  distortion_model: radtan\n  intrinsics: [700.0, 702.0, 330.5, 250.25]\n  resolution: [640, 480]\n"
        "  rostopic: /left/image_raw\n  timeshift_cam_imu: 0.001\n"
        "cam1:\n  T_cn_cnm1:\n  - [1.0, 0.0, 0.0, -0.11]\n  - [0.0, 1.0, 0.0, 0.0]\n  - [0.0, 0.0, 1.0, 0.0]\n"
        "  - [0.0, 0.0, 0.0, 1.0]\n  camera_model: pinhole\n  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]\n"
        "  distortion_model: equidistant\n  intrinsics: [700.0, 702.0, 330.5, 250.25]\n  resolution: [640, 480]\n"
        "  rostopic: /right/image_raw\n"
    )
    rig = read_any_rig(tmp_path / "camchain-imucam.yaml")
    assert [camera.name for camera in rig.cameras] == ["left", "right"]
    assert rig.reference == "left"
    np.testing.assert_allclose(rig.camera("left").intrinsics.distortion, [-0.1, 0.02, 1e-5, -2e-3, 0])
    assert rig.camera("right").intrinsics.model == "fisheye"
    np.testing.assert_allclose(rig.camera("right").rig_from_camera.translation, [0.11, 0, 0])


def test_old_launch_files_say_poses_in_a_row(tmp_path):
    (tmp_path / "left.yaml").write_text(
        "image_width: 640\nimage_height: 480\ncamera_name: left\n"
        "camera_matrix: {rows: 3, cols: 3, data: [700, 0, 330.5, 0, 702, 250.25, 0, 0, 1]}\n"
        "distortion_model: rational_polynomial\n"
        "distortion_coefficients: {rows: 1, cols: 8, data: [-0.1, 0.02, 0.001, -0.002, 0, 0, 0, 0]}\n"
    )
    turned = Pose.from_vectors(np.array([0, 0, np.pi / 2]), np.array([1.0, 2.0, 3.0]))
    for words in (
        "1 2 3 0 0 0.70710678 0.70710678 base left_optical_frame 9",
        "1 2 3 1.57079633 0 0 base left 9",
    ):
        (tmp_path / "tf.launch").write_text(
            f'<launch><node pkg="tf" type="static_transform_publisher" name="a" args="{words}"/></launch>'
        )
        rig = read_any_rig(tmp_path / "left.yaml", tmp_path / "tf.launch")
        assert rig.reference == "base"
        np.testing.assert_allclose(rig.camera("left").rig_from_camera.matrix(), turned.matrix(), atol=1e-7)


def test_a_transforms_json_with_one_lens_for_all_frames(tmp_path):
    looking_down = np.diag([1.0, -1.0, -1.0, 1.0])
    looking_down[:3, 3] = 0.5, 0, 0
    values = {
        "w": 640, "h": 480, "fl_x": 700.0, "fl_y": 702.0, "cx": 331.0, "cy": 250.75, "k1": -0.1, "k2": 0.02,
        "p1": 1e-3, "p2": -2e-3, "frames": [
            {"file_path": "images/a.png", "transform_matrix": np.diag([1.0, -1.0, -1.0, 1.0]).tolist()},
            {"file_path": "images/b.png", "transform_matrix": looking_down.tolist()},
        ],
    }  # fmt: skip
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    rig = read_any_rig(tmp_path / "transforms.json", unit=1.0)
    np.testing.assert_allclose(pixels(rig.camera("a")), pixels_by_opencv(POINTS, [0.0] * 3, [0.0] * 3), atol=1e-9)
    np.testing.assert_allclose(pixels(rig.camera("b")), pixels_by_opencv(POINTS, [0.0] * 3, [-0.5, 0, 0]), atol=1e-9)


def test_mrcal_25_calls_its_pose_by_another_name(tmp_path):
    (tmp_path / "left.cameramodel").write_text(
        "# a remark\n{\n    'lensmodel':  'LENSMODEL_OPENCV8',\n"
        "    'intrinsics': [ 700, 702, 330.5, 250.25, -0.1, 0.02, 0.001, -0.002, 0, 0, 0, 0,],\n"
        "    'rt_cam_ref': [ 0.1, -0.2, 0.05, 0.3, -0.2, 0.4,],\n    'imagersize': [ 640, 480,],\n"
        "    'optimization_inputs': b'abc',\n}\n"
    )
    [camera] = read_any_rig(tmp_path / "left.cameramodel").cameras
    expected = pixels_by_opencv(POINTS, [0.1, -0.2, 0.05], [0.3, -0.2, 0.4])
    np.testing.assert_allclose(pixels(camera), expected, atol=1e-9)


def opencv_file(path, **nodes):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in nodes.items():
        storage.write(name, np.array(value, float) if isinstance(value, list) else value)
    storage.release()
    return path


@pytest.mark.parametrize("suffix", [".yml", ".xml", ".json"])
def test_opencv_files_of_other_programs(suffix, tmp_path):
    path = opencv_file(
        tmp_path / f"left{suffix}", image_width=640, image_height=480, camera_matrix=MATRIX,
        distortion_coefficients=[[value] for value in [*DISTORTION, 0.0]], avg_reprojection_error=0.3,
    )  # fmt: skip
    lens = read_any_lenses(path)["left"].intrinsics
    np.testing.assert_allclose(lens.project(POINTS), pixels_by_opencv(POINTS, [0.0] * 3, [0.0] * 3), atol=1e-9)


@pytest.mark.parametrize("suffix", [".yml", ".xml"])
def test_a_stereo_pair_as_opencv_s_sample_writes_it(suffix, tmp_path):
    rotation = cv2.Rodrigues(np.array([0.1, -0.2, 0.05]))[0].tolist()
    intrinsics = opencv_file(
        tmp_path / f"intrinsics{suffix}", M1=MATRIX, D1=[[*DISTORTION, 0.0]], M2=MATRIX, D2=[[*DISTORTION, 0.0]]
    )
    extrinsics = opencv_file(tmp_path / f"extrinsics{suffix}", R=rotation, T=[[300.0], [-200.0], [400.0]])
    with pytest.raises(QuadrigError, match="--size"):
        read_any_rig(intrinsics, extrinsics, unit=1e-3)
    with pytest.raises(QuadrigError, match="--unit"):
        read_any_rig(intrinsics, extrinsics, size=(640, 480))
    rig = read_any_rig(intrinsics, extrinsics, unit=1e-3, size=(640, 480))
    assert rig.reference == "left"
    assert {(one.intrinsics.width, one.intrinsics.height) for one in rig.cameras} == {(640, 480)}
    expected = pixels_by_opencv(POINTS, [0.1, -0.2, 0.05], [0.3, -0.2, 0.4])
    np.testing.assert_allclose(pixels(rig.camera("right")), expected, atol=1e-9)


def test_eight_coefficients_are_refused_and_not_cut(tmp_path):
    path = opencv_file(
        tmp_path / "left.yml", image_width=640, image_height=480, camera_matrix=MATRIX,
        distortion_coefficients=[[*DISTORTION, 0.0, 0.1, 0.0, 0.0]],
    )  # fmt: skip
    with pytest.raises(QuadrigError, match="8 coefficients, 5 of which"):
        read_any_lenses(path)


def test_a_skew_is_refused(tmp_path):
    skewed = [[700.0, 1.5, 330.5], *MATRIX[1:]]
    path = opencv_file(tmp_path / "left.yml", image_size=[[640, 480]], camera_matrix=skewed, D=[DISTORTION])
    with pytest.raises(QuadrigError, match=r"skew of 1\.5"):
        read_any_lenses(path)


def test_one_camera_in_two_files_is_refused(example_rig, tmp_path):
    from quadrig.io.formats.registry import export_files

    alone = replace(example_rig, cameras=example_rig.cameras[:1], fits=())
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "cam0.yaml").write_text(str(export_files(alone, "ros")["cam0.yaml"]))
    with pytest.raises(QuadrigError, match="camera 'cam0' is in an earlier file too"):
        read_any_lenses(tmp_path / "a" / "cam0.yaml", tmp_path / "b" / "cam0.yaml")


@pytest.mark.parametrize("unit", [float("-inf"), float("nan"), 0.0, -0.01])
def test_a_unit_that_is_none_is_refused(unit):
    held = Held(poses={"cam0": Pose.identity()}, unit=unit)
    with pytest.raises(QuadrigError, match="unit of lengths"):
        any_file._in_metres(held, None, "rig.usda")  # noqa: SLF001 - no format but USD states a unit, and it is an extra
