"""The doubt that is planned with: that of the rig, were its lenses less simple than the Views so far support."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quadrig.rig.doubt.information import covariance_of
from quadrig.rig.doubt.linear_rows import instances, rows_of
from quadrig.rig.result import CAMERA_PARAMETERS, Camera, Rig
from quadrig.single.arrays import Floats
from quadrig.single.lens import LENS_PARAMETERS

# Few Views support only a focal; the next ones bring distortion to light, and the doubt grows. A plan that trusts the
# simple lens would never look for it.
_PLANNED_LENS = ("focal", "cx", "cy", "k1", "k2")
# Sigmas of lens parameters before anything is seen, as parts of the picture's width for focal and principal point:
# webcams' axes lie within 2 %; k1 and k2 of ordinary lenses within 0.1.
_FOCAL, _CENTRE, _BENT, _OTHER = 1.0, 0.02, 0.1, 0.01


def planning_doubt(rig: Rig) -> tuple[tuple[Camera, ...], Floats]:
    """The rig's cameras with each lens parameter free that may yet matter, and their covariance (15 C, 15 C).

    Lenses that are given and fixed stay so. The rig's own covariance where it keeps no fits.
    """
    if not rig.fits:
        return rig.cameras, rig.covariance
    cameras = tuple(
        replace(camera, free_lens=tuple(dict.fromkeys((*camera.free_lens, *_PLANNED_LENS))))
        if camera.free_lens
        else camera
        for camera in rig.cameras
    )
    size = len(cameras) * CAMERA_PARAMETERS
    information = np.zeros((size + len(cameras),) * 2)
    for group in instances(rig):
        rows = rows_of(rig, cameras, group)
        by_all, basis = np.concatenate([rows.by_cameras, rows.by_tones], axis=1), np.linalg.qr(rows.by_pose)[0]
        own = by_all - basis @ (basis.T @ by_all)
        information += own.T @ own
    noise = rig.noise if np.isfinite(rig.noise) and rig.noise > 0 else 1.0
    information = information / noise**2 + np.diag([*_prior_information(cameras), *np.ones(len(cameras))])
    beside = information[:size, size:]
    information = information[:size, :size] - beside @ np.linalg.solve(information[size:, size:], beside.T)
    reference = rig.reference if any(c.name == rig.reference for c in cameras) else cameras[0].name
    return cameras, covariance_of(cameras, information, reference)


def _prior_information(cameras: Sequence[Camera]) -> Floats:
    result = np.zeros((len(cameras), CAMERA_PARAMETERS))
    for index, camera in enumerate(cameras):
        width = camera.intrinsics.width
        sigma = {"focal": _FOCAL * width, "cx": _CENTRE * width, "cy": _CENTRE * width, "k1": _BENT, "k2": _BENT}
        result[index, : len(LENS_PARAMETERS)] = [
            1 / sigma.get(name, _OTHER) ** 2 if name in camera.free_lens else 0.0 for name in LENS_PARAMETERS
        ]
    return result.ravel()
