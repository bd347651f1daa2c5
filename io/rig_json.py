"""A Rig as the JSON that other programs rely on (`rig export --format json`, `rig calibrate --json`)."""

from typing import Any

import numpy as np

from quadrig.rig.result import Camera, PlacedRectangle, Rig


def rig_values(rig: Rig) -> dict[str, Any]:
    """Plain values: metres, pixels, degrees where the key says so; matrices as lists of rows.

    None stands for what is not known.
    """
    return {
        "rig_frame": rig.reference,
        "cameras": {camera.name: _camera_values(rig, camera) for camera in rig.cameras},
        "working_accuracy_mm": known(1e3 * rig.working_accuracy),
        "rms_px": known(rig.rms),
        "left_out_rms_px": known(rig.left_out_rms),
        "rectangles": {placed.name: _rectangle_values(placed) for placed in rig.rectangles},
        "weak": list(rig.weak),
        "missing": dict(rig.missing),
    }


def known(value: float) -> float | None:
    """A number, or None where it is none: JSON has no nan."""
    return float(value) if np.isfinite(value) else None


def _camera_values(rig: Rig, camera: Camera) -> dict[str, Any]:
    lens = camera.intrinsics
    return {
        "width": lens.width,
        "height": lens.height,
        "model": lens.model,
        "camera_matrix": lens.camera_matrix.tolist(),
        "distortion": lens.distortion.tolist(),
        "rig_from_camera": camera.rig_from_camera.matrix().tolist(),
        "sigma": {
            "focal_px": known(rig.focal_sigma(camera.name)),
            "rotation_deg": known(np.degrees(rig.rotation_sigma(camera.name))),
            "position_m": known(rig.position_sigma(camera.name)),
        },
        "rms_px": known(camera.rms),
        "left_out_rms_px": known(camera.left_out_rms),
        "views": camera.views,
    }


def _rectangle_values(placed: PlacedRectangle) -> dict[str, Any]:
    values = {
        "width": placed.rectangle.width,
        "height": placed.rectangle.height,
        "rig_from_rect": placed.rig_from_rect.matrix().tolist(),
    }
    if placed.framesets.size:
        values["framesets"] = placed.framesets.tolist()
    return values
