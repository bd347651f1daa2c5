"""Rigs in the formats of other programs: one registry, one small function each."""

import json
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from quadrig.rig.result import Camera, PlacedRectangle, Rig
from quadrig.single.errors import QuadrigError

from .export_colmap import colmap_files
from .export_kalibr import kalibr_files
from .export_opencv import opencv_files
from .export_ros import ros_files, tf_files, urdf_files

Files = dict[str, str]


@dataclass(frozen=True)
class Format:
    """A format: what it is, and the function that makes its files, by name. single: it is one file, of any name."""

    what: str
    files: Callable[[Rig], Files]
    single: bool = True


def json_files(rig: Rig) -> Files:
    """Everything a program needs, with sigmas, as JSON; nan and what cannot be told are null."""
    return {"rig.json": json.dumps(rig_values(rig), indent=2) + "\n"}


def rig_values(rig: Rig) -> dict:
    """The values of the JSON export: poses 4x4 in the rig frame, metres; sigma in px, degrees, metres."""
    return {
        "rig_frame": rig.reference,
        "cameras": {camera.name: _camera_values(rig, camera) for camera in rig.cameras},
        "working_accuracy_mm": _number(1e3 * rig.working_accuracy),
        "rectangles": {placed.name: _rectangle_values(placed) for placed in rig.rectangles},
    }


def export_files(rig: Rig, name: str) -> Files:
    """The files of a rig in a format, by name. Raises QuadrigError where there is no such format."""
    if name not in FORMATS:
        raise QuadrigError(f"there is no format {name!r}; there are {', '.join(FORMATS)}")
    return FORMATS[name].files(rig)


def _camera_values(rig: Rig, camera: Camera) -> dict:
    lens = camera.intrinsics
    return {
        "width": lens.width,
        "height": lens.height,
        "model": lens.model,
        "camera_matrix": lens.camera_matrix.tolist(),
        "distortion": lens.distortion.tolist(),
        "rig_from_camera": camera.rig_from_camera.matrix().tolist(),
        "sigma": {
            "focal_px": _number(rig.focal_sigma(camera.name)),
            "rotation_deg": _number(np.degrees(rig.rotation_sigma(camera.name))),
            "position_m": _number(rig.position_sigma(camera.name)),
        },
        "rms_px": _number(camera.rms),
    }


def _rectangle_values(placed: PlacedRectangle) -> dict:
    values = {
        "width": placed.rectangle.width,
        "height": placed.rectangle.height,
        "rig_from_rect": placed.rig_from_rect.matrix().tolist(),
    }
    return {**values, "framesets": np.asarray(placed.framesets).tolist()} if placed.rectangle.moving else values


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


FORMATS: dict[str, Format] = {
    "json": Format("cameras, rectangles and sigmas as JSON", json_files),
    "opencv": Format("one OpenCV FileStorage (YAML) with every camera", opencv_files),
    "opencv-xml": Format("the same as XML", lambda rig: opencv_files(rig, ".xml")),
    "ros": Format("camera_info YAML, one file for each camera", ros_files, single=False),
    "tf": Format("static transforms as a ROS 2 launch file", tf_files),
    "urdf": Format("links and fixed joints as URDF", urdf_files),
    "kalibr": Format("Kalibr's camchain YAML", kalibr_files),
    "colmap": Format("COLMAP's text model: cameras, images, points3D", colmap_files, single=False),
}
