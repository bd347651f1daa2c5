"""One picture with its camera and sheet, as a rerun file."""

from pathlib import Path

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from quadrig.io.drawing.geometry import RING
from quadrig.io.drawing.palette import FOUND, PREDICTED, SHEET, STATIC, camera_colours
from quadrig.io.viewer.rrd_file import rrd_written
from quadrig.io.viewer.shapes import frustum, transform
from quadrig.single.arrays import Floats, Picture
from quadrig.single.calibration import Calibration
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

# ln of a likelihood ratio of a thousand to one: beyond it the mirror twin is no candidate, and would only confuse.
_EXCLUDED = 7.0
_CAMERA = camera_colours(["camera"])["camera"]


def save_calibration(
    path: Path, picture: Picture, rectangle: Rectangle, view: View, calibration: Calibration
) -> None:
    """Write an .rrd: the picture with measured and fitted points, the sheet, the camera, and its mirror twin.

    picture (h, w, 3), blue green red. Raises QuadrigError where the file cannot be written.
    """
    blueprint = rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial3DView(origin="/"), rrb.Spatial2DView(origin="/camera/image"), column_shares=[1, 1]
        ),
        collapse_panels=True,
    )
    with rrd_written(path, "quadrig single", blueprint) as recording:
        _log_space(recording, rectangle, view, calibration)
        _log_picture(recording, picture, rectangle, view, calibration)


def _log_space(recording: rr.RecordingStream, rectangle: Rectangle, view: View, calibration: Calibration) -> None:
    recording.log("/", rr.ViewCoordinates.RDF, static=True)
    outline = rr.LineStrips3D([rectangle.corners[RING]], colors=[SHEET], labels=[rectangle.name])
    recording.log("sheet", outline, static=True)
    points = rr.Points3D(view.points, colors=SHEET, radii=rr.Radius.ui_points(2))
    recording.log("sheet/points", points, static=True)
    lens, pose = calibration.intrinsics, calibration.rect_from_cameras[0]
    distance = float(np.linalg.norm(pose.translation))
    recording.log("camera", transform(pose), static=True)
    recording.log("camera/image", frustum(lens, _CAMERA, 0.25 * distance), static=True)
    twins = calibration.twins
    if twins is not None and twins.log_likelihood_ratio < _EXCLUDED:
        recording.log("twin", transform(twins.camera_from_rect[1].inverse()), static=True)
        recording.log("twin/image", frustum(lens, STATIC, 0.12 * distance), static=True)


def _log_picture(
    recording: rr.RecordingStream, picture: Picture, rectangle: Rectangle, view: View, calibration: Calibration
) -> None:
    rgb = cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
    recording.log("camera/image", rr.Image(rgb).compress(jpeg_quality=90), static=True)
    measured = rr.Points2D(view.pixels, colors=FOUND, radii=rr.Radius.ui_points(4))
    recording.log("camera/image/measured", measured, static=True)
    fitted = rr.Points2D(view.pixels - calibration.residuals[0], colors=PREDICTED, radii=rr.Radius.ui_points(2))
    recording.log("camera/image/fitted", fitted, static=True)
    in_camera = calibration.camera_from_rects[0].transform(_dense(rectangle.corners[RING]))
    edge = rr.LineStrips2D([calibration.intrinsics.project(in_camera)], colors=[PREDICTED])
    recording.log("camera/image/outline", edge, static=True)


def _dense(outline: Floats) -> Floats:
    """Points along the outline, close enough for a distorted lens to bend it."""
    sides = np.diff(outline, axis=0)
    steps = np.linspace(0, 1, 20)
    return (outline[:-1, None] + steps[:, None] * sides[:, None]).reshape(-1, 3)
