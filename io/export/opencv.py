"""OpenCV's FileStorage: image size, camera matrix, distortion and pose of every camera."""

import cv2
import numpy as np

from quadrig.rig.result import Rig


def opencv_files(rig: Rig, suffix: str = ".yml") -> dict[str, str]:
    """One file with camera_names and, for each camera NAME, <NAME>_image_size, _camera_matrix, _distortion, _model,
    _rig_from_camera (4x4) and the rvec and tvec of camera_from_rig, as cv::projectPoints takes them."""
    storage = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("rig_frame", rig.reference)
    keys = node_names([camera.name for camera in rig.cameras])
    storage.startWriteStruct("camera_names", cv2.FILE_NODE_SEQ)
    for camera in rig.cameras:
        storage.write("", camera.name)
    storage.endWriteStruct()
    for camera, key in zip(rig.cameras, keys, strict=True):
        lens, camera_from_rig = camera.intrinsics, camera.rig_from_camera.inverse()
        distortion = lens.distortion if lens.model == "pinhole" else lens.distortion[:4]
        storage.write(f"{key}_image_size", np.array([[lens.width, lens.height]], np.int32))
        storage.write(f"{key}_model", lens.model)
        storage.write(f"{key}_camera_matrix", lens.camera_matrix)
        storage.write(f"{key}_distortion", distortion.reshape(1, -1))
        storage.write(f"{key}_rig_from_camera", camera.rig_from_camera.matrix())
        storage.write(f"{key}_rvec", camera_from_rig.rotation_vector().reshape(3, 1))
        storage.write(f"{key}_tvec", camera_from_rig.translation.reshape(3, 1))
    return {f"rig{suffix}": storage.releaseAndGetString()}


def node_names(names: list[str]) -> list[str]:
    """Names that FileStorage takes: letters, digits, _ and -, a letter first; made distinct by numbers."""
    taken: list[str] = []
    for name in names:
        plain = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name)
        plain = plain if plain[:1].isalpha() else f"cam_{plain}"
        number = 2
        unique = plain
        while unique in taken:
            unique, number = f"{plain}_{number}", number + 1
        taken.append(unique)
    return taken
