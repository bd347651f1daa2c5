"""ROS: sensor_msgs/CameraInfo as camera_info_manager's YAML, static transforms as a launch file, and URDF.

Frames after REP 103: NAME_optical (x right, y down, z forward) is what images carry; NAME_link is the same camera as
a body (x forward, y left, z up). The base frame carries the rig frame.
"""

import shlex
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from xml.sax.saxutils import quoteattr

import msgspec
import numpy as np
import yaml

from quadrig.io.formats.format import Files, Held, Options, coefficients, lens_of, pose_of_quaternion
from quadrig.io.safe_yaml import read_yaml
from quadrig.io.whole_file import LARGEST_OF_CAMERAS, read_whole
from quadrig.rig.result import Camera, Rig
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import LensModel
from quadrig.single.pose import Pose
from quadrig.single.rotation import rotation_from_vector

_LINK_FROM_OPTICAL = Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
FRAMES = ("link", "optical")
"""What a camera's frames are called behind its name: the body's, and that of its pictures."""

_OPTICAL = ("_optical_frame", "_optical")
_MODELS: dict[str, LensModel] = {
    **dict.fromkeys(("plumb_bob", "rational_polynomial"), "pinhole"),
    **dict.fromkeys(("equidistant", "fisheye"), "fisheye"),
}


class _Matrix(msgspec.Struct):
    data: list[float]


class _CameraInfo(msgspec.Struct):
    image_width: int
    image_height: int
    camera_matrix: _Matrix
    distortion_model: str
    distortion_coefficients: _Matrix
    camera_name: str = ""


def ros_files(rig: Rig, _options: Options) -> Files:
    """NAME.yaml for each camera."""
    return {f"{camera.name}.yaml": _camera_info(camera) for camera in rig.cameras}


def tf_files(rig: Rig, options: Options) -> Files:
    """A ROS 2 XML launch file that starts a static_transform_publisher for each frame."""
    lines = ["<launch>"]
    for parent, child, parent_from_child in _frames(rig, options):
        x, y, z = parent_from_child.translation.tolist()
        qx, qy, qz, qw = parent_from_child.quaternion().tolist()
        arguments = (
            f"--x {x!r} --y {y!r} --z {z!r} --qx {qx!r} --qy {qy!r} --qz {qz!r} --qw {qw!r} "
            f"--frame-id {parent} --child-frame-id {child}"
        )
        lines.append(f'  <node pkg="tf2_ros" exec="static_transform_publisher" args={quoteattr(arguments)}/>')
    return {"rig.launch.xml": "\n".join([*lines, "</launch>", ""])}


def urdf_files(rig: Rig, options: Options) -> Files:
    """A link for each frame, and a fixed joint to its parent."""
    lines = ['<?xml version="1.0"?>', '<robot name="rig">', f"  <link name={quoteattr(options.base)}/>"]
    for parent, child, parent_from_child in _frames(rig, options):
        xyz = " ".join(repr(value) for value in parent_from_child.translation.tolist())
        rpy = " ".join(repr(value) for value in roll_pitch_yaw(parent_from_child.rotation))
        lines += [
            f"  <link name={quoteattr(child)}/>",
            f'  <joint name={quoteattr(f"{parent}_to_{child}")} type="fixed">',
            f"    <parent link={quoteattr(parent)}/>",
            f"    <child link={quoteattr(child)}/>",
            f'    <origin xyz="{xyz}" rpy="{rpy}"/>',
            "  </joint>",
        ]
    return {"rig.urdf": "\n".join([*lines, "</robot>", ""])}


def _frames(rig: Rig, options: Options) -> Iterator[tuple[str, str, Pose]]:
    """Parent, child and parent_from_child of every frame but the base."""
    for camera in rig.cameras:
        link, optical = (f"{camera.name}_{frame}" for frame in FRAMES)
        yield options.base, link, options.base_from_rig @ camera.rig_from_camera @ _LINK_FROM_OPTICAL.inverse()
        yield link, optical, _LINK_FROM_OPTICAL
    for placed in rig.rectangles:
        if not placed.rectangle.moving:
            yield options.base, placed.name, options.base_from_rig @ placed.rig_from_rect


def roll_pitch_yaw(rotation: Floats) -> tuple[float, float, float]:
    """URDF's angles, rad, of a rotation (3, 3) = Rz(yaw) Ry(pitch) Rx(roll); roll is zero where pitch is upright."""
    r = np.asarray(rotation, float)
    upright = np.hypot(r[0, 0], r[1, 0])
    pitch = float(np.arctan2(-r[2, 0], upright))
    # Below this roll and yaw turn about the same axis to the last bits, and one of them is free.
    if upright < 1e-12:
        return 0.0, pitch, float(np.arctan2(-r[0, 1], r[1, 1]))
    return float(np.arctan2(r[2, 1], r[2, 2])), pitch, float(np.arctan2(r[1, 0], r[0, 0]))


def _camera_info(camera: Camera) -> str:
    lens = camera.intrinsics
    projection = np.column_stack([lens.camera_matrix, np.zeros(3)])
    values = {
        "image_width": lens.width,
        "image_height": lens.height,
        "camera_name": camera.name,
        "camera_matrix": _matrix(lens.camera_matrix),
        "distortion_model": "plumb_bob" if lens.model == "pinhole" else "equidistant",
        "distortion_coefficients": _matrix(coefficients(lens).reshape(1, -1)),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(projection),
    }
    return yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=1000)


def _matrix(values: Floats) -> dict:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": values.ravel().tolist()}


def is_camera_info(_path: Path, head: bytes) -> bool:
    """Whether a file speaks of a camera as camera_info_manager does."""
    return b"image_width:" in head and b"distortion_model:" in head and b"%YAML:1.0" not in head


def read_camera_info(path: Path) -> Held:
    """The lens of one camera, by its camera_name or the file's. Raises QuadrigError where its model is unknown."""
    info = msgspec.convert(read_yaml(read_whole(path)), _CameraInfo, strict=False)
    if info.distortion_model not in _MODELS:
        raise QuadrigError(f"{path}: the model is {info.distortion_model}; quadrig reads {', '.join(_MODELS)}")
    size, model = (info.image_width, info.image_height), _MODELS[info.distortion_model]
    matrix = np.reshape(info.camera_matrix.data, (3, 3))
    return Held(
        {info.camera_name or path.stem: lens_of(size, matrix, info.distortion_coefficients.data, f"{path}", model)}
    )


def is_frames(_path: Path, head: bytes) -> bool:
    """Whether a file is a URDF or a launch file of static transforms."""
    return b"<robot" in head or (b"<launch" in head and b"static_transform_publisher" in head)


def read_frames(path: Path) -> Held:
    """Where every frame stands in the root: by its own name, and a camera's optical frame by the camera's too.

    Raises QuadrigError where the frames are no tree.
    """
    parents: dict[str, tuple[str, Pose]] = {}
    root = ElementTree.fromstring(read_whole(path, LARGEST_OF_CAMERAS))
    for parent, child, pose in _joints(root) if root.tag == "robot" else _publishers(root):
        if child in parents:
            raise QuadrigError(f"{path}: frame {child!r} has two parents; give each one")
        parents[child] = parent, pose
    bases = {parent for parent, _ in parents.values()} - parents.keys()
    if len(bases) != 1:
        raise QuadrigError(f"{path}: its frames have {len(bases)} roots; give a file with one tree of them")
    poses = {child: _in_root(child, parents) for child in parents}
    cameras = {
        child.removesuffix(ending): pose
        for ending in _OPTICAL
        for child, pose in poses.items()
        if child.endswith(ending)
    }
    return Held(poses={**poses, **cameras}, frame=bases.pop())


def _in_root(child: str, parents: dict[str, tuple[str, Pose]]) -> Pose:
    pose = Pose.identity()
    for _ in parents:
        parent, parent_from_child = parents[child]
        pose, child = parent_from_child @ pose, parent
        if child not in parents:
            return pose
    raise ValueError("its frames go in a circle")


def _joints(robot: ElementTree.Element) -> Iterator[tuple[str, str, Pose]]:
    for joint in robot.iter("joint"):
        parent, child, origin = joint.find("parent"), joint.find("child"), joint.find("origin")
        if parent is None or child is None:
            continue
        words = {"xyz": "0 0 0", "rpy": "0 0 0", **({} if origin is None else origin.attrib)}
        translation, angles = ([float(word) for word in words[key].split()] for key in ("xyz", "rpy"))
        yield parent.attrib["link"], child.attrib["link"], Pose(from_roll_pitch_yaw(*angles), np.array(translation))


def _publishers(launch: ElementTree.Element) -> Iterator[tuple[str, str, Pose]]:
    """Of ROS 2's flags, or of the older words in a row: x y z, then qx qy qz qw or yaw pitch roll, then the names."""
    for node in launch.iter("node"):
        words = shlex.split(node.attrib.get("args", ""))
        if "static_transform_publisher" not in (node.attrib.get("exec"), node.attrib.get("type")):
            continue
        if words[0].startswith("--"):
            names, words = [word.removeprefix("--") for word in words[::2]], words[1::2]
        else:
            turned = ["yaw", "pitch", "roll"] if not _is_number(words[6]) else ["qx", "qy", "qz", "qw"]
            names = ["x", "y", "z", *turned, "frame-id", "child-frame-id"]
        values: dict[str, str] = dict(zip(names, words, strict=False))
        parent, child = values["frame-id"], values["child-frame-id"]
        translation = [float(values.get(name, 0)) for name in "xyz"]
        if values.keys() & {"qx", "qy", "qz", "qw"}:
            quaternion = [float(values.get(name, name == "qw")) for name in ("qx", "qy", "qz", "qw")]
            yield parent, child, pose_of_quaternion(quaternion, translation, f"frame {child!r}")
        else:
            rotation = from_roll_pitch_yaw(*(float(values.get(name, 0)) for name in ("roll", "pitch", "yaw")))
            yield parent, child, Pose(rotation, np.array(translation))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def from_roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> Floats:
    """The rotation Rz(yaw) Ry(pitch) Rx(roll) of URDF's angles, rad."""
    about_x, about_y, about_z = rotation_from_vector(np.diag([roll, pitch, yaw]))
    return about_z @ about_y @ about_x
