"""What one picture shows of its camera, as lines for people and as JSON for programs."""

from collections.abc import Sequence

import numpy as np

from quadrig.io.formats.rig_json import json_text
from quadrig.single.arrays import Floats
from quadrig.single.calibration import Calibration
from quadrig.single.lens import DISTORTION_NAMES
from quadrig.single.rectangle import Rectangle
from quadrig.single.rotation import angles_from_rotation
from quadrig.single.solve.corners import Reason
from quadrig.single.solve.cramer_rao import paper_sigmas
from quadrig.single.solve.focal_advice import percent, view_tilt
from quadrig.single.view import View


def text_report(
    name: str, rectangle: Rectangle, view: View, calibration: Calibration, remarks: Sequence[str] = ()
) -> str:
    """Lines for people; remarks: sentences on what was put right in the input."""
    lens, pose = calibration.intrinsics, calibration.rect_from_cameras[0]
    sigmas = paper_sigmas(calibration.covariance(), calibration.camera_from_rects[0])
    angles = np.degrees(np.array(angles_from_rotation(pose.rotation)))
    centre, centre_sigma = lens.principal_point, np.sqrt(np.diag(calibration.lens_covariance)[1:3])
    rows = [
        ("picture", f"{name}, {lens.width} x {lens.height}"),
        ("rectangle", f"{rectangle.name}, {rectangle.width:g} x {rectangle.height:g} m, {len(view.pixels)} points"),
        ("focal", _focal_line(calibration)),
        ("principal point", f"{centre[0]:.1f}, {centre[1]:.1f} px +- {centre_sigma[0]:.1f}, {centre_sigma[1]:.1f}"),
        ("lens", _lens_line(calibration)),
        ("camera at", f"{_list(pose.translation, 4)} m +- {_list(sigmas[:3], 4)}"),
        ("theta x y z", f"{_list(angles, 2)} degrees +- {_list(np.degrees(sigmas[3:6]), 2)}"),
        ("distance, tilt", f"{np.linalg.norm(pose.translation):.3f} m, {_tilt(calibration):.1f} degrees"),
        ("residual", f"{calibration.rms:.2f} px RMS; sigmas are for {calibration.noise:.2f} px a coordinate"),
        ("mirror twin", _twin_line(calibration)),
    ]
    lines = [f"{label:<16}{value}" for label, value in rows]
    lines += [f"- {sentence}" for sentence in (*remarks, *calibration.notes)]
    return "\n".join(lines)


def _lens_line(calibration: Calibration) -> str:
    """The model with its larger coefficients: of a fisheye all four, of a pinhole the two that pictures show."""
    lens = calibration.intrinsics
    names = DISTORTION_NAMES[lens.model][: 4 if lens.model == "fisheye" else 2]
    values, sigmas = lens.distortion[: len(names)], np.sqrt(np.diag(calibration.lens_covariance)[3 : 3 + len(names)])
    if not values.any():
        return f"{lens.model}, no distortion"
    bends = ", ".join(f"{name} {value:.3f}" for name, value in zip(names, values, strict=True))
    return f"{lens.model}, {bends} +- {_list(sigmas, 3)}"


def _focal_line(calibration: Calibration) -> str:
    focal, sigma = calibration.intrinsics.focal, calibration.focal_sigma
    if sigma == 0:
        return f"{focal:.1f} px (given)"
    low, high = calibration.focal_interval
    if calibration.reason == Reason.FOCAL_UNKNOWABLE:
        return f"cannot be determined from this picture; taken as {focal:.0f} px"
    return f"{focal:.1f} px +- {sigma:.1f} ({percent(sigma / focal)}); 95 %: {low:.0f} to {high:.0f} px"


def json_report(
    name: str, rectangle: Rectangle, view: View, calibration: Calibration, remarks: Sequence[str] = ()
) -> str:
    """The same as JSON; what is without bound is null."""
    lens, pose = calibration.intrinsics, calibration.rect_from_cameras[0]
    sigmas = paper_sigmas(calibration.covariance(), calibration.camera_from_rects[0])
    lens_sigmas = np.sqrt(np.diag(calibration.lens_covariance))
    twins = calibration.twins
    twin = None
    if twins is not None and twins.exists:
        twin = {
            "rect_from_camera": twins.camera_from_rect[1].inverse().matrix(),
            "log_likelihood_ratio": twins.log_likelihood_ratio,
        }
    values = {
        "image": name,
        "width": lens.width,
        "height": lens.height,
        "rectangle": {"name": rectangle.name, "width": rectangle.width, "height": rectangle.height},
        "points": len(view.pixels),
        "reason": calibration.reason.name.lower(),
        "focal_px": lens.focal,
        "focal_interval_px": calibration.focal_interval,
        "principal_point": lens.principal_point,
        "camera_matrix": lens.camera_matrix,
        "model": lens.model,
        "distortion": lens.distortion,
        "rect_from_camera": pose.matrix(),
        "theta_deg": np.degrees(np.array(angles_from_rotation(pose.rotation))),
        "tilt_deg": _tilt(calibration),
        "sigma": {
            "focal_px": calibration.focal_sigma,
            "principal_point_px": lens_sigmas[1:3],
            "distortion": lens_sigmas[3:8],
            "position_m": sigmas[:3],
            "theta_deg": np.degrees(sigmas[3:6]),
        },
        "covariance": calibration.rect_from_camera_covariance[0],
        "rms_px": calibration.rms,
        "noise_px": calibration.noise,
        "twin": twin,
        "notes": [*remarks, *calibration.notes],
    }
    return json_text(values)


def _twin_line(calibration: Calibration) -> str:
    twins = calibration.twins
    if twins is None or not twins.exists:
        return "none"
    ratio = float(twins.log_likelihood_ratio)
    if ratio > np.log(1e6):
        return "excluded: more than a million times less likely"
    return f"{np.exp(ratio):.3g} times less likely"


def _tilt(calibration: Calibration) -> float:
    return float(np.degrees(view_tilt(calibration.camera_from_rects[0])))


def _list(values: Floats, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in values)
