"""nerfstudio's transforms.json: rig_from_camera of cameras that look along -z with y up; pixels begin at the corner
of the top-left pixel."""

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from quadrig.io.formats.format import GRAPHICS, HALF_PIXEL, Files, Held, Options, camera_matrix, lens_of, pose_of
from quadrig.io.safe_json import read_json
from quadrig.rig.result import Camera, Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import LensModel

_MODELS: dict[str, LensModel] = {"OPENCV": "pinhole", "PINHOLE": "pinhole", "OPENCV_FISHEYE": "fisheye"}


class _Lens(msgspec.Struct):
    """Intrinsics, of one frame or of all."""

    w: float | None = None
    h: float | None = None
    fl_x: float | None = None
    fl_y: float | None = None
    cx: float | None = None
    cy: float | None = None
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0


class _Frame(msgspec.Struct):
    file_path: str
    transform_matrix: list[list[float]]


class _File(msgspec.Struct):
    frames: list[dict[str, Any]]
    camera_model: str = "OPENCV"
    unit: str = ""


def nerfstudio_files(rig: Rig, _options: Options) -> Files:
    """transforms.json, a frame for each camera with a lens of its own; its picture is images/NAME.jpg.

    Raises QuadrigError where some cameras are fisheyes and some are not: the file has one model for all.
    """
    models = {camera.intrinsics.model for camera in rig.cameras}
    if len(models) > 1:
        raise QuadrigError("transforms.json has one camera model for all, this rig both; export colmap instead")
    values = {
        "camera_model": "OPENCV" if models == {"pinhole"} else "OPENCV_FISHEYE",
        "unit": "m",
        "frames": [_frame(camera) for camera in rig.cameras],
    }
    return {"transforms.json": json.dumps(values, indent=2) + "\n"}


def _frame(camera: Camera) -> dict[str, Any]:
    lens, (cx, cy) = camera.intrinsics, (camera.intrinsics.principal_point + HALF_PIXEL).tolist()
    names = ("k1", "k2", "p1", "p2", "k3") if lens.model == "pinhole" else ("k1", "k2", "k3", "k4")
    return {
        "file_path": f"images/{camera.name}.jpg",
        "transform_matrix": (camera.rig_from_camera @ GRAPHICS).matrix().tolist(),
        "w": lens.width,
        "h": lens.height,
        "fl_x": lens.focal,
        "fl_y": lens.focal * lens.aspect,
        "cx": cx,
        "cy": cy,
        **dict(zip(names, lens.distortion.tolist(), strict=False)),
    }


def is_nerfstudio(_path: Path, head: bytes) -> bool:
    """Whether a file begins like a transforms.json."""
    return head.lstrip()[:1] == b"{" and b'"transform_matrix"' in head


def read_nerfstudio(path: Path) -> Held:
    """Lenses and poses, a camera for each frame, named as its picture. Raises QuadrigError where the model is another
    than OPENCV or OPENCV_FISHEYE."""
    root: dict[str, Any] = read_json(path.read_bytes(), dict)
    file = msgspec.convert(root, _File)
    if file.camera_model not in _MODELS:
        raise QuadrigError(f"{path}: the model is {file.camera_model}; quadrig reads OPENCV and OPENCV_FISHEYE")
    lenses, poses = {}, {}
    for values in file.frames:
        frame = msgspec.convert(values, _Frame)
        name = Path(frame.file_path).stem
        where = f"{path}: camera {name!r}"
        if name in lenses:
            raise QuadrigError(f"{where} is there twice; a rig has one frame for each camera")
        lens = msgspec.convert({**root, **values}, _Lens)
        focal = lens.fl_x if lens.fl_x is not None else lens.fl_y
        if lens.w is None or lens.h is None or focal is None or lens.cx is None or lens.cy is None:
            raise QuadrigError(f"{where} lacks one of w, h, fl_x, cx and cy; add them to the file")
        matrix = camera_matrix(focal, lens.fl_y or focal, lens.cx - HALF_PIXEL, lens.cy - HALF_PIXEL)
        model = _MODELS[file.camera_model]
        pinhole = [lens.k1, lens.k2, lens.p1, lens.p2, lens.k3, lens.k4]
        fisheye = [lens.k1, lens.k2, lens.k3, lens.k4]
        lenses[name] = lens_of((lens.w, lens.h), matrix, pinhole if model == "pinhole" else fisheye, where, model)
        poses[name] = pose_of(np.array(frame.transform_matrix, float), where) @ GRAPHICS
    return Held(lenses, poses, unit={"m": 1.0}.get(file.unit))
