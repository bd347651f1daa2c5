"""Kalibr's camchain: cam0, cam1, ... each with T_cn_cnm1, the transform from the camera before it."""

from pathlib import Path

import msgspec
import numpy as np
import yaml

from quadrig.io.formats.format import Files, Held, Options, camera_matrix, lens_of, pose_of
from quadrig.io.recording.camera import camera_name
from quadrig.io.safe_yaml import read_yaml
from quadrig.io.whole_file import read_whole
from quadrig.rig.result import Camera, Rig
from quadrig.single.arrays import Mask
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics, LensModel
from quadrig.single.pose import Pose

_ZERO = 1e-12
"""k3 this small bends no ray: Kalibr's four coefficients then say the same."""

_MODELS: dict[str, LensModel] = {"radtan": "pinhole", "none": "pinhole", "equidistant": "fisheye"}


class _Camera(msgspec.Struct):
    camera_model: str
    intrinsics: list[float]
    resolution: tuple[int, int]
    distortion_model: str = "none"
    distortion_coeffs: list[float] = []
    rostopic: str = ""
    T_cn_cnm1: list[list[float]] | None = None


def kalibr_files(rig: Rig, _options: Options) -> Files:
    """camchain.yaml. Raises QuadrigError where a lens has a k3, which Kalibr's radtan does not know."""
    chain, rig_from_before, overlaps = {}, None, _overlaps(rig)
    for index, camera in enumerate(rig.cameras):
        chain[f"cam{index}"] = values = _values(camera)
        values["cam_overlaps"] = [other for other in range(len(rig.cameras)) if overlaps[index, other]]
        if rig_from_before is not None:
            values["T_cn_cnm1"] = (camera.rig_from_camera.inverse() @ rig_from_before).matrix().tolist()
        rig_from_before = camera.rig_from_camera
    # PyYAML reads 1e-05 as a word: its own writer knows that, and gives every number its point.
    return {"camchain.yaml": yaml.safe_dump(chain, sort_keys=False, default_flow_style=None, width=200)}


def _values(camera: Camera) -> dict:
    lens = camera.intrinsics
    if lens.model == "pinhole" and abs(lens.distortion[4]) > _ZERO:
        raise QuadrigError(
            f"camera {camera.name!r} has k3 = {lens.distortion[4]:.3g}, and Kalibr's radtan has no k3; "
            'calibrate with lens = "f c k1 k2", export with --undistorted, or another format'
        )
    return {
        "camera_model": "pinhole",
        "intrinsics": [lens.focal, lens.focal * lens.aspect, *lens.principal_point.tolist()],
        "distortion_model": "radtan" if lens.model == "pinhole" else "equidistant",
        "distortion_coeffs": lens.distortion[:4].tolist(),
        "resolution": [lens.width, lens.height],
        "rostopic": f"/{camera.name.strip('/')}/image_raw",
    }


def _overlaps(rig: Rig) -> Mask:
    """Which cameras (C, C) saw a rectangle together; all others of a rig whose Views are not known."""
    index = {camera.name: number for number, camera in enumerate(rig.cameras)}
    seen = {(fit.view.rectangle, fit.view.frameset, index[fit.view.camera]) for fit in rig.fits if not fit.rejected}
    if not seen:
        return ~np.eye(len(index), dtype=bool)
    moments = {key[:2]: row for row, key in enumerate(seen)}
    sight = np.zeros((len(seen), len(index)), bool)
    for rectangle, frameset, camera in seen:
        sight[moments[rectangle, frameset], camera] = True
    return (sight.T.astype(int) @ sight > 0) & ~np.eye(len(index), dtype=bool)


def is_kalibr(_path: Path, head: bytes) -> bool:
    """Whether a file speaks of cameras as Kalibr does."""
    return b"camera_model:" in head and b"intrinsics:" in head


def read_kalibr(path: Path) -> Held:
    """Lenses and poses of a camchain, of camera or camera-IMU calibration; cameras are named by their topics, where
    those differ. The rig frame is the first camera. Raises QuadrigError where a camera is of another model."""
    root = read_yaml(read_whole(path))
    chain = {key: value for key, value in root.items() if isinstance(value, dict) and "camera_model" in value}
    # Not strict: other writers leave 1e-05, which YAML 1.1 takes for a word.
    cameras = msgspec.convert(chain, dict[str, _Camera], strict=False)
    names = [camera_name(camera.rostopic) if camera.rostopic else key for key, camera in cameras.items()]
    if len(set(names)) < len(names):
        names = list(cameras)
    lenses, poses = {}, {}
    before: Pose | None = None
    for name, (key, camera) in zip(names, cameras.items(), strict=True):
        where = f"{path}: {key}"
        lenses[name] = _lens(camera, where)
        if not poses and before is None:
            before = poses[name] = Pose.identity()
        elif camera.T_cn_cnm1 is not None and before is not None:
            camera_from_before = pose_of(np.array(camera.T_cn_cnm1, float), where)
            before = poses[name] = before @ camera_from_before.inverse()
        else:
            before = None
    return Held(lenses, poses)


def _lens(camera: _Camera, where: str) -> Intrinsics:
    if camera.camera_model != "pinhole" or camera.distortion_model not in _MODELS:
        raise QuadrigError(
            f"{where}: the model is {camera.camera_model}-{camera.distortion_model}; of Kalibr's, quadrig knows "
            "pinhole-radtan and pinhole-equidistant: calibrate with one of those"
        )
    matrix = camera_matrix(*camera.intrinsics)
    model = _MODELS[camera.distortion_model]
    return lens_of(camera.resolution, matrix, camera.distortion_coeffs, where, model)
