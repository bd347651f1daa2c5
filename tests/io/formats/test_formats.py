"""Exports, each read by the program it is for or by that program's rules, project points as our rig does."""

import json
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml

from quadrig.io.commands.main import run
from quadrig.io.formats.opencv import node_names
from quadrig.io.formats.registry import FORMATS, export_files
from quadrig.io.formats.ros import roll_pitch_yaw
from quadrig.io.rig_file.rig_mcap import write_rig
from quadrig.single.errors import QuadrigError
from quadrig.single.rotation import rotation_from_quaternion, rotation_from_vector

POINTS = np.array([[0.1, 0.2, 1.9], [-0.3, 0.1, 2.2], [0.2, -0.2, 2.0]])


def predicted(camera):
    return camera.intrinsics.project(camera.rig_from_camera.inverse().transform(POINTS))


def test_json_keeps_the_contract(example_rig):
    values = json.loads(export_files(example_rig, "json")["rig.json"])
    assert {"rig_frame", "cameras", "lens_only", "working_accuracy_mm", "rectangles"} < set(values)
    assert (values["format"], values["version"]) == ("quadrig rig", 1)
    assert values["rig_frame"] == "cam0"
    assert values["working_accuracy_mm"] == pytest.approx(1e3 * example_rig.working_accuracy)
    for camera in example_rig.cameras:
        held = values["cameras"][camera.name]
        keys = ["width", "height", "model", "camera_matrix", "distortion", "rig_from_camera", "sigma", "rms_px"]
        assert list(held) == keys
        assert {"focal_px", "lens_px", "rotation_deg", "position_m"} < set(held["sigma"])
        rig_from_camera = np.array(held["rig_from_camera"])
        in_camera = (np.linalg.inv(rig_from_camera) @ np.column_stack([POINTS, np.ones(3)]).T)[:3].T
        matrix, distortion = np.array(held["camera_matrix"]), np.array(held["distortion"])
        pixels, _ = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), matrix, distortion)
        np.testing.assert_allclose(pixels[:, 0], predicted(camera), atol=1e-8)
        assert held["sigma"]["position_m"] == pytest.approx(example_rig.position_sigma(camera.name))
    assert np.shape(values["rectangles"]["desk"]["rig_from_rect"]) == (4, 4)
    assert np.shape(values["rectangles"]["board"]["rig_from_rect"]) == (12, 4, 4)


def test_json_says_null_where_nothing_is_known(example_rig):
    values = json.loads(export_files(replace(example_rig, working_accuracy=float("nan")), "json")["rig.json"])
    assert values["working_accuracy_mm"] is None


@pytest.mark.parametrize("form", ["opencv", "opencv-xml"])
def test_opencv_reads_its_own(form, example_rig, tmp_path):
    [(name, text)] = export_files(example_rig, form).items()
    (tmp_path / name).write_text(text)
    storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_READ)
    names = storage.getNode("camera_names")
    assert [names.at(i).string() for i in range(names.size())] == [camera.name for camera in example_rig.cameras]
    for camera in example_rig.cameras:
        held = {
            key: storage.getNode(f"{camera.name}_{key}").mat()
            for key in ("camera_matrix", "distortion", "rvec", "tvec", "image_size")
        }
        pixels, _ = cv2.projectPoints(POINTS, held["rvec"], held["tvec"], held["camera_matrix"], held["distortion"])
        np.testing.assert_allclose(pixels[:, 0], predicted(camera), atol=1e-8)
        assert held["image_size"].ravel().tolist() == [1280, 720]


def test_opencv_takes_every_name():
    assert node_names(["left eye", "0", "left/eye"]) == ["left_eye", "cam_0", "left_eye_2"]


def test_camera_info_holds_the_lens(example_rig):
    files = export_files(example_rig, "ros")
    assert sorted(files) == ["cam0.yaml", "cam1.yaml", "cam2.yaml", "cam3.yaml"]
    held, lens = yaml.safe_load(files["cam2.yaml"]), example_rig.camera("cam2").intrinsics
    np.testing.assert_array_equal(np.reshape(held["camera_matrix"]["data"], (3, 3)), lens.camera_matrix)
    np.testing.assert_array_equal(held["distortion_coefficients"]["data"], lens.distortion)
    assert held["distortion_model"] == "plumb_bob"
    assert (held["image_width"], held["image_height"]) == (1280, 720)


def test_kalibr_chains_from_camera_to_camera(example_rig):
    held = yaml.safe_load(export_files(example_rig, "kalibr")["camchain.yaml"])
    points = example_rig.cameras[0].rig_from_camera.inverse().transform(POINTS)
    for index, camera in enumerate(example_rig.cameras):
        entry = held[f"cam{index}"]
        if index:
            matrix = np.array(entry["T_cn_cnm1"])
            points = points @ matrix[:3, :3].T + matrix[:3, 3]
        fx, fy, cx, cy = entry["intrinsics"]
        matrix, distortion = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), np.array(entry["distortion_coeffs"])
        pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, distortion)
        np.testing.assert_allclose(pixels[:, 0], predicted(camera), atol=1e-8)


def test_kalibr_refuses_what_it_cannot_say(example_rig):
    first = example_rig.cameras[0]
    bent = replace(first, intrinsics=replace(first.intrinsics, distortion=np.array([0.1, 0, 0, 0, 0.2])))
    with pytest.raises(QuadrigError, match="k3"):
        export_files(replace(example_rig, cameras=(bent, *example_rig.cameras[1:])), "kalibr")


def test_colmap_begins_pixels_at_the_corner(example_rig):
    files = export_files(example_rig, "colmap")
    cameras = [line.split() for line in files["cameras.txt"].splitlines() if line[0] != "#"]
    images = [line.split() for line in files["images.txt"].splitlines() if line and line[0] != "#"]
    for camera, lens, image in zip(example_rig.cameras, cameras, images, strict=True):
        w, x, y, z, *translation = (float(value) for value in image[1:8])
        in_camera = POINTS @ rotation_from_quaternion(np.array([x, y, z, w])).T + translation
        fx, fy, cx, cy, *distortion = (float(value) for value in lens[4:])
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        pixels, _ = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), matrix, np.array(distortion))
        np.testing.assert_allclose(pixels[:, 0], predicted(camera) + 0.5, atol=1e-8)
        assert image[9] == f"{camera.name}.jpg"


def test_urdf_and_launch_place_links_in_the_rig_frame(example_rig):
    robot = ElementTree.fromstring(export_files(example_rig, "urdf")["rig.urdf"])
    links = {link.get("name") for link in robot.findall("link")}
    assert links == {"cam0", "cam1", "cam2", "cam3", "desk", "wall"}
    for joint in robot.findall("joint"):
        child, origin = (dict(one.attrib) for name in ("child", "origin") for one in joint.iter(name))
        placed = {camera.name: camera.rig_from_camera for camera in example_rig.cameras}
        placed |= {p.name: p.rig_from_rect for p in example_rig.rectangles}
        roll, pitch, yaw = (float(value) for value in origin["rpy"].split())
        about_z, about_y, about_x = rotation_from_vector(np.array([[0, 0, yaw], [0, pitch, 0], [roll, 0, 0]]))
        pose = placed[child["link"]]
        np.testing.assert_allclose(about_z @ about_y @ about_x, pose.rotation, atol=1e-12)
        np.testing.assert_array_equal([float(v) for v in origin["xyz"].split()], pose.translation)
    launch = ElementTree.fromstring(export_files(example_rig, "tf")["rig.launch.xml"])
    assert len(launch.findall("node")) == 5
    assert "--frame-id cam0 --child-frame-id cam1" in launch.findall("node")[0].attrib["args"]


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_upright_links_have_angles_too(pitch):
    about_z, about_y = rotation_from_vector(np.array([0, 0, 0.7])), rotation_from_vector(np.array([0, pitch, 0]))
    roll, found, yaw = roll_pitch_yaw(about_z @ about_y)
    again = rotation_from_vector(np.array([0, 0, yaw])) @ rotation_from_vector(np.array([0, found, 0]))
    again = again @ rotation_from_vector(np.array([roll, 0, 0]))
    np.testing.assert_allclose(again, about_z @ about_y, atol=1e-8)  # upright, an angle is known to root epsilon


@pytest.mark.parametrize("form", list(FORMATS))
def test_the_command_writes_every_format(form, example_rig, tmp_path, capsys):
    write_rig(tmp_path / "rig.mcap", example_rig)
    output = tmp_path / "out"
    assert run(["export", str(tmp_path / "rig.mcap"), "--format", form, "-o", str(output)]) == 0
    written = capsys.readouterr().out.split()
    assert written
    assert all((tmp_path / name).stat().st_size for name in written)


def test_the_command_says_what_is_wrong(example_rig, tmp_path, capsys):
    write_rig(tmp_path / "rig.mcap", example_rig)
    assert run(["export", str(tmp_path / "rig.mcap"), "--format", "colmap"]) == 1
    assert "folder" in capsys.readouterr().err
    assert run(["export", str(tmp_path / "rig.mcap"), "--format", "word"]) == 2
    assert run(["export", str(tmp_path / "absent.mcap")]) == 1
    assert "Traceback" not in capsys.readouterr().err
