"""Rigs as plain values: what every text format is made of."""

import json

import numpy as np

from quadrig.rig.result import Camera, PlacedRectangle, Rig

Files = dict[str, str]


def json_files(rig: Rig) -> Files:
    """Everything a program needs, with sigmas, as JSON; what is not determined is null."""
    return {"rig.json": json_text(rig_values(rig)) + "\n"}


def json_text(values: object) -> str:
    """JSON of nested values and arrays; JSON has no nan and no infinity, which become null."""
    return json.dumps(_plain(values), indent=2)


def rig_values(rig: Rig) -> dict:
    """The values of the JSON export: poses 4x4 in the rig frame, metres; sigma in px, degrees, metres."""
    return {
        "rig_frame": rig.reference,
        "cameras": {camera.name: _camera_values(rig, camera) for camera in rig.cameras},
        "working_accuracy_mm": 1e3 * rig.working_accuracy,
        "rectangles": {placed.name: _rectangle_values(placed) for placed in rig.rectangles},
    }


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
            "focal_px": rig.focal_sigma(camera.name),
            "rotation_deg": np.degrees(rig.rotation_sigma(camera.name)),
            "position_m": rig.position_sigma(camera.name),
        },
        "rms_px": camera.rms,
    }


def _rectangle_values(placed: PlacedRectangle) -> dict:
    values = {
        "width": placed.rectangle.width,
        "height": placed.rectangle.height,
        "rig_from_rect": placed.rig_from_rect.matrix().tolist(),
    }
    return {**values, "framesets": np.asarray(placed.framesets).tolist()} if placed.rectangle.moving else values


def _plain(value: object) -> object:
    match value:
        case dict():
            return {key: _plain(item) for key, item in value.items()}
        case np.ndarray():
            return _plain(value.tolist())
        case list() | tuple():
            return [_plain(item) for item in value]
        case float() | np.floating():
            return float(value) if np.isfinite(value) else None
        case _:
            return value
