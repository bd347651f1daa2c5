"""Residuals over each camera's picture in rerun, where corners were, and how long residuals are."""

import cv2
import numpy as np
import rerun as rr

from quadrig.io.drawing.palette import FINE, PREDICTED, rig_colours
from quadrig.io.drawing.rig_figures import arrow_scale, longest_usual, residual_arrows, residual_histogram
from quadrig.rig.doubt.residual_field import ResidualField, residual_field
from quadrig.rig.result import Camera, Rig


def log_fields(recording: rr.RecordingStream, rig: Rig) -> None:
    """Log every camera's residuals under field/<name> and histogram/<name>, on one scale for all."""
    fields = {camera.name: residual_field(rig, camera.name) for camera in rig.cameras}
    top, scale = longest_usual(fields.values()), arrow_scale(rig)
    for camera, colour in zip(rig.cameras, rig_colours(rig).values(), strict=True):
        field = fields[camera.name]
        _log_field(recording, camera, field, scale)
        if len(field.pixels):
            counts, edges = residual_histogram(field, top)
            middles = (edges[1:] + edges[:-1]) / 2
            bars = rr.BarChart(counts, abscissa=middles, widths=np.diff(edges) * 0.9, color=colour)
            recording.log(f"histogram/{camera.name}", bars, static=True)


def _log_field(recording: rr.RecordingStream, camera: Camera, field: ResidualField, scale: float) -> None:
    path, lens = f"field/{camera.name}", camera.intrinsics
    frame = [[0, 0], [lens.width, 0], [lens.width, lens.height], [0, lens.height], [0, 0]]
    recording.log(f"{path}/frame", rr.LineStrips2D([frame], colors=[FINE], radii=rr.Radius.ui_points(1)), static=True)
    recording.log(
        f"{path}/coverage",
        rr.EncodedImage(contents=_coverage_png(field, camera), media_type="image/png"),
        static=True,
    )
    if not len(field.pixels):
        return
    recording.log(
        f"{path}/residuals",
        rr.Arrows2D(
            origins=field.pixels - field.residuals,
            vectors=residual_arrows(camera, field.residuals, scale),
            colors=[PREDICTED],
            radii=rr.Radius.ui_points(0.8),
            draw_order=20,
        ),
        static=True,
    )


def _coverage_png(field: ResidualField, camera: Camera) -> bytes:
    """Where corners were: a picture of blue fields, the more corners the lighter, of the size of the camera's."""
    share = np.sqrt(field.counts / max(field.counts.max(), 1))
    # BGR from near black to a mid blue: arrows stay readable on both.
    blocks = (np.array([34, 26, 22]) + share[..., None] * np.array([120, 70, 20])).astype(np.uint8)
    size = (camera.intrinsics.width, camera.intrinsics.height)
    done, data = cv2.imencode(".png", cv2.resize(blocks, size, interpolation=cv2.INTER_NEAREST))
    return data.tobytes() if done else b""
