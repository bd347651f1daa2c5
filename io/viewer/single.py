"""One picture with its camera and sheet, as a rerun file."""

from pathlib import Path

import cv2
import numpy as np

from quadrig.io.whole_file import written_beside
from quadrig.single.arrays import Floats
from quadrig.single.calibration import Calibration
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

_SHEET, _CAMERA, _TWIN, _SEEN, _FITTED = (
    [240, 220, 160],
    [80, 160, 255],
    [150, 150, 150],
    [255, 80, 80],
    [80, 230, 120],
)
# ln of a likelihood ratio of a thousand to one: beyond it the mirror twin is no candidate, and would only confuse.
_EXCLUDED = 7.0
# The sheet's outline in Eq. 4's corners, closed.
_RING = [0, 1, 2, 3, 0]


def save_calibration(path: Path, picture: Floats, rectangle: Rectangle, view: View, calibration: Calibration) -> None:
    """Write an .rrd: the picture with measured and fitted points, the sheet, the camera, and its mirror twin.

    picture (h, w, 3) uint8, blue green red. Raises QuadrigError where the file cannot be written.
    """
    import rerun as rr
    import rerun.blueprint as rrb

    lens, pose = calibration.intrinsics, calibration.rect_from_cameras[0]
    blueprint = rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(origin="/"), rrb.Spatial2DView(origin="/camera/image"), column_shares=[1, 1]
        ),
        collapse_panels=True,
    )
    with written_beside(path) as beside, rr.RecordingStream("quadrig single") as recording:
        recording.save(str(beside), default_blueprint=blueprint)
        recording.log("/", rr.ViewCoordinates.RDF, static=True)
        outline = rectangle.corners[_RING]
        recording.log("sheet", rr.LineStrips3D([outline], colors=[_SHEET], labels=[rectangle.name]), static=True)
        recording.log(
            "sheet/points", rr.Points3D(view.points, colors=_SHEET, radii=rr.Radius.ui_points(2)), static=True
        )
        distance = float(np.linalg.norm(pose.translation))
        _log_camera(recording, "camera", pose, calibration, 0.25 * distance, _CAMERA)
        rgb = cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
        recording.log("camera/image", rr.Image(rgb).compress(jpeg_quality=90), static=True)
        fitted = view.pixels - calibration.residuals[0]
        recording.log(
            "camera/image/measured", rr.Points2D(view.pixels, colors=_SEEN, radii=rr.Radius.ui_points(4)), static=True
        )
        recording.log(
            "camera/image/fitted", rr.Points2D(fitted, colors=_FITTED, radii=rr.Radius.ui_points(2)), static=True
        )
        edge = lens.project(calibration.camera_from_rects[0].transform(_dense(outline)))
        recording.log("camera/image/outline", rr.LineStrips2D([edge], colors=[_FITTED]), static=True)
        twins = calibration.twins
        if twins is not None and twins.log_likelihood_ratio < _EXCLUDED:
            _log_camera(recording, "twin", twins.camera_from_rect[1].inverse(), calibration, 0.12 * distance, _TWIN)


def _log_camera(
    recording, name: str, rect_from_camera, calibration: Calibration, size: float, colour: list[int]
) -> None:
    import rerun as rr

    lens = calibration.intrinsics
    transform = rr.Transform3D(translation=rect_from_camera.translation, mat3x3=rect_from_camera.rotation)
    recording.log(name, transform, static=True)
    recording.log(
        f"{name}/image",
        rr.Pinhole(
            image_from_camera=lens.camera_matrix,
            resolution=[lens.width, lens.height],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=size,
            color=colour,
        ),
        static=True,
    )


def _dense(outline: Floats) -> Floats:
    """Points along the outline, close enough for a distorted lens to bend it."""
    sides = np.diff(outline, axis=0)
    steps = np.linspace(0, 1, 20)
    return (outline[:-1, None] + steps[:, None] * sides[:, None]).reshape(-1, 3)
