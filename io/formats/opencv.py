"""OpenCV's FileStorage: image size, camera matrix, distortion and pose of every camera."""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from yaml.constructor import SafeConstructor

from quadrig.io.formats.format import (
    Files,
    Held,
    Options,
    coefficients,
    lens_of,
    plain_names,
    pose_of,
)
from quadrig.io.safe_json import read_json
from quadrig.io.safe_yaml import SAFE_LOADER, read_yaml
from quadrig.io.whole_file import LARGEST_OF_CAMERAS, read_whole
from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics
from quadrig.single.pose import Pose

# What the samples and the programs that store a camera call its matrix and distortion.
_MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K")
_DISTORTION = ("distortion", "distortion_coefficients", "Distortion_Coefficients", "dist_coeffs", "distCoeffs", "D")

_QUOTE = "\ue000"


def opencv_files(rig: Rig, options: Options, suffix: str = ".yml") -> Files:  # noqa: ARG001 - as every format is called
    """One file with camera_names and, for each camera NAME, <NAME>_image_size, _camera_matrix, _distortion, _model,
    _rig_from_camera (4x4) and the rvec and tvec of camera_from_rig, as cv::projectPoints takes them."""
    storage = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("rig_frame", rig.reference)
    keys = plain_names([camera.name for camera in rig.cameras])
    storage.startWriteStruct("camera_names", cv2.FILE_NODE_SEQ)
    for camera in rig.cameras:
        storage.write("", camera.name)
    storage.endWriteStruct()
    for camera, key in zip(rig.cameras, keys, strict=True):
        lens, camera_from_rig = camera.intrinsics, camera.rig_from_camera.inverse()
        storage.write(f"{key}_image_size", np.array([[lens.width, lens.height]], np.int32))
        storage.write(f"{key}_model", lens.model)
        storage.write(f"{key}_camera_matrix", lens.camera_matrix)
        storage.write(f"{key}_distortion", coefficients(lens).reshape(1, -1))
        storage.write(f"{key}_rig_from_camera", camera.rig_from_camera.matrix())
        storage.write(f"{key}_rvec", camera_from_rig.rotation_vector().reshape(3, 1))
        storage.write(f"{key}_tvec", camera_from_rig.translation.reshape(3, 1))
    return {f"rig{suffix}": storage.releaseAndGetString()}


def is_opencv(_path: Path, head: bytes) -> bool:
    """Whether a file begins as FileStorage writes it, in YAML, XML or JSON."""
    return b"opencv_storage" in head or b"%YAML:1.0" in head[:16] or b"opencv-matrix" in head


def read_opencv(path: Path) -> Held:
    """Lenses and poses of our own files; or the one lens of a file with camera_matrix, distortion_coefficients and
    image_width, image_height (or image_size) at the top, named as the file. Raises QuadrigError where there are none.
    """
    nodes = _nodes(path)
    names = nodes.get("camera_names")
    if "M1" in nodes or ("R" in nodes and "T" in nodes):
        return _stereo(nodes, f"{path}")
    if names is None:
        return Held({path.stem: _lens(nodes, "", f"{path}")})
    names = [str(name) for name in names] if isinstance(names, list) else [str(names)]
    lenses, poses = {}, {}
    for name, key in zip(names, plain_names(names), strict=True):
        where = f"{path}: camera {name!r}"
        lenses[name] = _lens(nodes, f"{key}_", where)
        poses[name] = pose_of(_numbers(nodes, [f"{key}_rig_from_camera"], where), where)
    return Held(lenses, poses, str(nodes.get("rig_frame", "")))


def _stereo(nodes: Mapping[str, Any], where: str) -> Held:
    """intrinsics.yml, extrinsics.yml, or both in one, of OpenCV's stereo sample: right_from_left is R, T, in the unit
    of its squares; it does not say the pictures' size."""
    lenses, poses = {}, {}
    for number, name in (("1", "left"), ("2", "right")):
        if f"M{number}" in nodes:
            size = _array(nodes["image_size"]).ravel() if "image_size" in nodes else None
            matrix, distortion = (_numbers(nodes, [f"{letter}{number}"], where) for letter in "MD")
            lenses[name] = lens_of(size, matrix, distortion, f"{where}: {name} camera")
    if "R" in nodes and "T" in nodes:
        right_from_left = np.column_stack([_array(nodes["R"]), _array(nodes["T"]).ravel()])
        poses = {"left": Pose.identity(), "right": pose_of(right_from_left, where).inverse()}
    return Held(lenses, poses, unit=None)


def _lens(nodes: Mapping[str, Any], prefix: str, where: str) -> Intrinsics:
    fisheye = nodes.get(f"{prefix}model") == "fisheye" or float(nodes.get(f"{prefix}fisheye_model", 0)) != 0
    if f"{prefix}image_width" in nodes:
        size = [float(nodes[f"{prefix}image_{side}"]) for side in ("width", "height")]
    else:
        size = _numbers(nodes, [f"{prefix}image_size"], where).ravel()
    matrix = _numbers(nodes, [f"{prefix}{name}" for name in _MATRIX], where)
    distortion = _numbers(nodes, [f"{prefix}{name}" for name in _DISTORTION], where).ravel()
    return lens_of(size, matrix, distortion, where, "fisheye" if fisheye else "pinhole")


def _numbers(nodes: Mapping[str, Any], keys: Sequence[str], where: str) -> Floats:
    """The matrix, or list of numbers, of the first of these keys that is there."""
    for key in keys:
        if key in nodes:
            return _array(nodes[key])
    raise QuadrigError(f"{where}: there is no {keys[0]} in it; give an OpenCV file that has image size and lens")


def _array(node: Any) -> Floats:
    if isinstance(node, dict):
        data = node["data"].split() if isinstance(node["data"], str) else node["data"]
        return np.array(data, float).reshape(int(node["rows"]), int(node["cols"]))
    return np.array(node, float)


def _nodes(path: Path) -> dict[str, Any]:
    """The nodes at the top of a file: matrices as dicts with rows, cols and data, all else as words, numbers, lists.

    Not by cv2.FileStorage: a damaged file makes it write over memory that is not its own.
    """
    content = read_whole(path, LARGEST_OF_CAMERAS)
    if content.lstrip()[:1] == b"<":
        # An escaped quote belongs to a word, a plain one ends it.
        root = ElementTree.fromstring(content.replace(b"&quot;", _QUOTE.encode()))
        return {node.tag: {each.tag: each.text for each in node} or _words(node.text or "") for node in root}
    if content.lstrip()[:1] == b"{":
        return read_json(content, dict)
    # %YAML:1.0 is no directive of YAML's.
    return read_yaml(content.split(b"\n", 1)[-1] if content.startswith(b"%") else content, _Loader)


def _words(text: str) -> str | list[str]:
    """The words of an XML node, in quotes where they hold blanks; a single one by itself."""
    words = [(quoted or plain).replace(_QUOTE, '"') for quoted, plain in re.findall(r'"([^"]*)"|(\S+)', text)]
    return words[0] if len(words) == 1 else words


class _Loader(SAFE_LOADER):
    """YAML with OpenCV's tag for matrices."""


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", SafeConstructor.construct_yaml_map)
