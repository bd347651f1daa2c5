"""Rigs as TOML: anipose, and freemocap, Pose2Sim and caliscope, which took its tables over with units of their own.

Each camera has size, matrix, distortions (OpenCV's), and rotation (a rotation vector) and translation of
camera_from_rig. Nothing in anipose's file says the unit; freemocap's is the millimetre, the others' the metre.
"""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from quadrig.io.config.toml_lines import toml_line
from quadrig.io.formats.format import Files, Held, Options, coefficients, lens_of
from quadrig.io.whole_file import LARGEST_OF_CAMERAS, read_whole
from quadrig.rig.result import Camera, Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose

_MILLIMETRES = 1e-3


class _Camera(msgspec.Struct):
    size: tuple[float, float]
    matrix: list[list[float]]
    distortions: list[float]
    rotation: list[Any] | None = None
    translation: list[float] | None = None
    name: str = ""
    fisheye: bool | None = None


def anipose_files(rig: Rig, _options: Options) -> Files:
    """calibration.toml, in metres, as aniposelib's CameraGroup.load takes it."""
    tables = {}
    for key, camera in zip(_keys(rig), rig.cameras, strict=True):
        fisheye = {"fisheye": True} if camera.intrinsics.model == "fisheye" else {}
        tables[key] = {"name": camera.name, **_values(camera), **fisheye}
    return {"calibration.toml": _toml({**tables, "metadata": {"unit": "m"}})}


def freemocap_files(rig: Rig, _options: Options) -> Files:
    """NAME_camera_calibration.toml, in millimetres, with where each camera stands beside what anipose says."""
    tables = {}
    for key, camera in zip(_keys(rig), rig.cameras, strict=True):
        values = _values(camera, _MILLIMETRES)
        stands = {
            "world_orientation": camera.rig_from_camera.rotation.tolist(),
            "world_position": (camera.rig_from_camera.translation / _MILLIMETRES).tolist(),
        }
        fisheye = {"fisheye": True} if camera.intrinsics.model == "fisheye" else {}
        tables[key] = {"name": camera.name, **values, **stands, **fisheye}
    return {"rig_camera_calibration.toml": _toml({**tables, "metadata": {"unit": "mm"}})}


def pose2sim_files(rig: Rig, _options: Options) -> Files:
    """Calib.toml, in metres."""
    tables = {}
    for key, camera in zip(_keys(rig), rig.cameras, strict=True):
        fisheye = camera.intrinsics.model == "fisheye"
        tables[key] = {"name": camera.name, **_values(camera), "fisheye": fisheye}
    return {"Calib.toml": _toml({**tables, "metadata": {"adjusted": False, "error": 0.0, "unit": "m"}})}


def caliscope_files(rig: Rig, _options: Options) -> Files:
    """camera_array.toml, in metres; cameras are numbers there."""
    tables = {}
    for camera in rig.cameras:
        fisheye = camera.intrinsics.model == "fisheye"
        values = {"cam_id": int(camera.name), "rotation_count": 0, **_values(camera), "fisheye": fisheye}
        tables[f"cameras.{camera.name}"] = values
    return {"camera_array.toml": _toml(tables)}


def numbered(names: Sequence[str]) -> list[str]:
    """Names as caliscope has them: numbers, the cameras' own where all are."""
    own = [name for name in names if name.isascii() and name.isdigit() and name == str(int(name))]
    return own if len(own) == len(names) else [str(number) for number in range(len(names))]


def _keys(rig: Rig) -> list[str]:
    """cam_0, cam_1... padded, since aniposelib takes the tables in the order of the alphabet."""
    digits = len(str(len(rig.cameras) - 1))
    return [f"cam_{number:0{digits}d}" for number in range(len(rig.cameras))]


def _values(camera: Camera, unit: float = 1.0) -> dict[str, Any]:
    lens, camera_from_rig = camera.intrinsics, camera.rig_from_camera.inverse()
    return {
        "size": [lens.width, lens.height],
        "matrix": lens.camera_matrix.tolist(),
        "distortions": coefficients(lens).tolist(),
        "rotation": camera_from_rig.rotation_vector().tolist(),
        "translation": (camera_from_rig.translation / unit).tolist(),
    }


def _toml(tables: dict[str, dict[str, Any]]) -> str:
    parts = [[f"[{key}]", *(toml_line(*entry) for entry in table.items()), ""] for key, table in tables.items()]
    return "\n".join("\n".join(lines) for lines in parts)


def is_toml_rig(_path: Path, head: bytes) -> bool:
    """Whether a file holds tables as anipose writes them."""
    return b"distortions" in head and b"matrix" in head and b"[cam" in head


def read_toml(path: Path) -> Held:
    """Lenses and poses of any of the four. Raises QuadrigError where two cameras have one name."""
    root = tomllib.loads(read_whole(path, LARGEST_OF_CAMERAS).decode())
    metadata = root.get("metadata", {})
    tables = root.get("cameras") or {k: v for k, v in root.items() if isinstance(v, dict) and "matrix" in v}
    cameras = msgspec.convert(tables, dict[str, _Camera])
    unit = _unit(metadata, "cameras" in root or any(camera.fisheye is False for camera in cameras.values()))
    lenses, poses = {}, {}
    for key, camera in cameras.items():
        name = camera.name or key
        where = f"{path}: camera {name!r}"
        if name in lenses:
            raise QuadrigError(f"{where} is there twice; give each camera a name of its own")
        model = "fisheye" if camera.fisheye else "pinhole"
        lenses[name] = lens_of(camera.size, np.array(camera.matrix, float), camera.distortions, where, model)
        if camera.rotation is not None and camera.translation is not None:
            rotation = np.array(camera.rotation, float)
            vector = Pose(rotation, np.zeros(3)).rotation_vector() if rotation.ndim == 2 else rotation
            poses[name] = Pose.from_vectors(vector, np.array(camera.translation, float)).inverse()
    return Held(lenses, poses, unit=unit)


def _unit(metadata: dict[str, Any], metric: bool) -> float | None:
    """Metres of one unit. charuco_square_size is freemocap's, in millimetres; `fisheye = false` is written by those
    that keep to metres."""
    stated = {"m": 1.0, "mm": _MILLIMETRES}.get(metadata.get("unit", ""))
    if stated is None and "charuco_square_size" in metadata:
        return _MILLIMETRES
    return 1.0 if stated is None and metric else stated
