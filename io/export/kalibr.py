"""Kalibr's camchain: cam0, cam1, ... each with T_cn_cnm1, the transform from the camera before it."""

from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError

_ZERO = 1e-12
"""k3 this small bends no ray: Kalibr's four coefficients then say the same."""


def kalibr_files(rig: Rig) -> dict[str, str]:
    """camchain.yaml. Raises QuadrigError where a lens has a k3, which Kalibr's radtan does not know."""
    lines = []
    for index, camera in enumerate(rig.cameras):
        lens = camera.intrinsics
        if lens.model == "pinhole" and abs(lens.distortion[4]) > _ZERO:
            raise QuadrigError(
                f"camera {camera.name!r} has k3 = {lens.distortion[4]:.3g}, and Kalibr's radtan has no k3; "
                'calibrate with lens = "f c k1 k2", or export another format'
            )
        matrix, chain = lens.camera_matrix, []
        if index:
            camera_from_before = camera.rig_from_camera.inverse() @ rig.cameras[index - 1].rig_from_camera
            chain = ["  T_cn_cnm1:", *(f"  - {row}" for row in camera_from_before.matrix().tolist())]
        lines += [
            f"cam{index}:",
            *chain,
            "  camera_model: pinhole",
            f"  distortion_coeffs: {lens.distortion[:4].tolist()}",
            f"  distortion_model: {'radtan' if lens.model == 'pinhole' else 'equidistant'}",
            f"  intrinsics: {[float(v) for v in (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])]}",
            f"  resolution: [{lens.width}, {lens.height}]",
            f"  rostopic: /{camera.name.strip('/')}/image_raw",
        ]
    return {"camchain.yaml": "\n".join([*lines, ""])}
