"""OpenCV's FileStorage: image size, camera matrix, distortion and pose of every camera."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from quadrig.io.formats.format import Files, Held, Options, coefficients, lens_of, plain_names, pose_of
from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics

# What the samples and the programs that store a camera call its matrix and distortion.
_MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K")
_DISTORTION = ("distortion", "distortion_coefficients", "Distortion_Coefficients", "dist_coeffs", "distCoeffs", "D")


def opencv_files(rig: Rig, options: Options, suffix: str = ".yml") -> Files:  # noqa: ARG001
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
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    try:
        names = storage.getNode("camera_names")
        if names.empty():
            return Held({path.stem: _lens(storage, "", f"{path}")})
        each = [names.at(index).string() for index in range(names.size())]
        lenses, poses = {}, {}
        for name, key in zip(each, plain_names(each), strict=True):
            where = f"{path}: camera {name!r}"
            lenses[name] = _lens(storage, f"{key}_", where)
            poses[name] = pose_of(_matrix(storage, [f"{key}_rig_from_camera"], where), where)
        return Held(lenses, poses, storage.getNode("rig_frame").string())
    finally:
        storage.release()


def _lens(storage: cv2.FileStorage, prefix: str, where: str) -> Intrinsics:
    fisheye = storage.getNode(f"{prefix}model").string() == "fisheye" or bool(
        storage.getNode(f"{prefix}fisheye_model").real()
    )
    size = [storage.getNode(f"{prefix}image_{side}").real() for side in ("width", "height")]
    if not all(size):
        size = _matrix(storage, [f"{prefix}image_size"], where).ravel()
    matrix = _matrix(storage, [f"{prefix}{name}" for name in _MATRIX], where)
    distortion = _matrix(storage, [f"{prefix}{name}" for name in _DISTORTION], where).ravel()
    return lens_of(size, matrix, distortion, where, "fisheye" if fisheye else "pinhole")


def _matrix(storage: cv2.FileStorage, keys: Sequence[str], where: str) -> Floats:
    """The matrix, or list of numbers, of the first of these keys that is there."""
    for key in keys:
        node = storage.getNode(key)
        if node.isSeq():
            return np.array([node.at(index).real() for index in range(node.size())])
        if not node.empty():
            return np.asarray(node.mat(), float)
    raise QuadrigError(f"{where}: there is no {keys[0]} in it; give an OpenCV file that has image size and lens")
