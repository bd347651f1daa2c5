"""Rigs as plain values: what every text format is made of."""

import json

import numpy as np

from quadrig.rig.result import Camera, PlacedRectangle, Rig

Files = dict[str, str]


def json_files(rig: Rig) -> Files:
    """Everything a program needs, with sigmas, as JSON; what is not determined is null."""
    return {"rig.json": json.dumps(rig_values(rig), indent=2) + "\n"}


def rig_values(rig: Rig) -> dict:
    """The values of the JSON export: poses 4x4 in the rig frame, metres; sigma in px, degrees, metres."""
    return {
        "rig_frame": rig.reference,
        "cameras": {camera.name: _camera_values(rig, camera) for camera in rig.cameras},
        "working_accuracy_mm": _number(1e3 * rig.working_accuracy),
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
