"""What lies in the cameras' pictures in rerun: corners as found, outlines as the rig predicts them, residuals."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from quadrig.io.drawing.geometry import rises
from quadrig.io.drawing.palette import FAULT, FOUND, PREDICTED, Colour
from quadrig.io.drawing.rig_figures import arrow_scale, predicted_outline, residual_arrows
from quadrig.io.viewer.inspect.timeline import set_frameset
from quadrig.rig.result import Camera, Rig, ViewFit
from quadrig.single.arrays import Floats


def log_picture_marks(
    recording: rr.RecordingStream, rig: Rig, colours: dict[str, Colour], times: Sequence[int]
) -> None:
    """Log each picture's frame, and what lies in it at each frameset, under space/cameras/<name>/marks."""
    for camera in rig.cameras:
        lens = camera.intrinsics
        frame = [[0, 0], [lens.width, 0], [lens.width, lens.height], [0, lens.height], [0, 0]]
        edge = rr.LineStrips2D([frame], colors=[colours[camera.name]], radii=rr.Radius.ui_points(1))
        recording.log(f"space/cameras/{camera.name}/marks/frame", edge, static=True)
    scale = arrow_scale(rig)
    by_instant: dict[tuple[int, str], list[ViewFit]] = {}
    for fit in rig.fits:
        by_instant.setdefault((fit.view.frameset, fit.view.camera), []).append(fit)
    for frameset in sorted({fit.view.frameset for fit in rig.fits}):
        set_frameset(recording, frameset, times)
        for camera in rig.cameras:
            _log_marks(recording, rig, camera, scale, by_instant.get((frameset, camera.name), []))
    recording.reset_time()


def _log_marks(recording: rr.RecordingStream, rig: Rig, camera: Camera, scale: float, fits: list[ViewFit]) -> None:
    path = f"space/cameras/{camera.name}/marks"
    for part in ("found", "residuals") if not fits else ():
        recording.log(f"{path}/{part}", rr.Clear(recursive=False))
    if fits:
        _log_corners(recording, path, camera, scale, fits)
    rings = [(fit, predicted_outline(rig, camera, fit)) for fit in fits]
    drawn = [(fit, ring) for fit, ring in rings if ring is not None]
    for part in ("predicted", "names") if not drawn else ():
        recording.log(f"{path}/{part}", rr.Clear(recursive=False))
    if drawn:
        _log_outlines(recording, path, camera, drawn)


def _log_corners(recording: rr.RecordingStream, path: str, camera: Camera, scale: float, fits: list[ViewFit]) -> None:
    """Found corners, and arrows (enlarged) from where the rig predicts them."""
    pixels = np.concatenate([fit.view.pixels for fit in fits])
    residuals = np.concatenate([fit.residuals for fit in fits])
    used = np.concatenate([np.asarray(fit.used, bool) for fit in fits])
    predicted = np.isfinite(residuals).all(axis=1)
    found = [FOUND if taken else FAULT for taken in used]
    recording.log(f"{path}/found", rr.Points2D(pixels, colors=found, radii=rr.Radius.ui_points(2.5), draw_order=30))
    recording.log(
        f"{path}/residuals",
        rr.Arrows2D(
            origins=(pixels - residuals)[predicted],
            vectors=residual_arrows(camera, residuals[predicted], scale),
            colors=[PREDICTED],
            radii=rr.Radius.ui_points(1.0),
            draw_order=31,
        ),
    )


def _log_outlines(
    recording: rr.RecordingStream, path: str, camera: Camera, drawn: list[tuple[ViewFit, Floats]]
) -> None:
    colours = [FAULT if fit.rejected else PREDICTED for fit, _ in drawn]
    rings, names = [ring for _, ring in drawn], [fit.view.rectangle for fit, _ in drawn]
    lines = rr.LineStrips2D(rings, colors=colours, radii=rr.Radius.ui_points(1.2), draw_order=29)
    recording.log(f"{path}/predicted", lines)
    labels = rr.Points2D(
        _name_positions(rings, names, camera),
        colors=colours,
        radii=rr.Radius.ui_points(0.5),
        labels=names,
        show_labels=True,
        draw_order=32,
    )
    recording.log(f"{path}/names", labels)


def _name_positions(rings: list[Floats], names: list[str], camera: Camera) -> Floats:
    """Below each outline, apart from one another at the size in which a picture of four is shown."""
    width = camera.intrinsics.width
    below = np.array([[(ring[:, 0].min() + ring[:, 0].max()) / 2, ring[:, 1].max()] for ring in rings])
    # The names lowest in the picture are placed first, and the others move up.
    order = np.argsort(-below[:, 1])
    up = below[order] * [1, -1]
    rise = rises(up, [names[i] for i in order], 0.03 * width, 0.06 * width, 0.075 * width)
    below[order, 1] -= rise
    return below
