"""What lies in the cameras' pictures in rerun: corners as found, outlines as the rig predicts them, residuals."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from quadrig.io.drawing.geometry import beside
from quadrig.io.drawing.palette import FAULT, FOUND, PREDICTED, Colour
from quadrig.io.drawing.rig_figures import arrow_scale, predicted_outline, residual_arrows
from quadrig.io.viewer.inspect.blueprint import picture_columns
from quadrig.io.viewer.inspect.timeline import set_frameset
from quadrig.rig.result import Camera, Rig, ViewFit
from quadrig.single.arrays import Floats

# Of a name as the viewer writes it, in points: a letter, what is around the word, its height, the gap to its sheet.
_LETTER, _AROUND, _LINE, _GAP = 6.2, 10.0, 20.0, 4.0
# How wide (points) a picture is where two stand side by side in a first look; more of them are as much smaller.
_PICTURE = 270.0


def log_picture_marks(
    recording: rr.RecordingStream, rig: Rig, colours: dict[str, Colour], times: Sequence[int]
) -> None:
    """Log each picture's frame, and what lies in it at each frameset, under space/cameras/<name>/marks."""
    for camera in rig.cameras:
        lens = camera.intrinsics
        frame = [[0, 0], [lens.width, 0], [lens.width, lens.height], [0, lens.height], [0, 0]]
        edge = rr.LineStrips2D([frame], colors=[colours[camera.name]], radii=rr.Radius.ui_points(1))
        recording.log(f"space/cameras/{camera.name}/marks/frame", edge, static=True)
    by_instant: dict[tuple[int, str], list[ViewFit]] = {}
    for fit in rig.fits:
        by_instant.setdefault((fit.view.frameset, fit.view.camera), []).append(fit)
    for frameset in sorted({fit.view.frameset for fit in rig.fits}):
        set_frameset(recording, frameset, times)
        for camera in rig.cameras:
            _log_marks(recording, rig, camera, by_instant.get((frameset, camera.name), []))
    recording.reset_time()


def _log_marks(recording: rr.RecordingStream, rig: Rig, camera: Camera, fits: list[ViewFit]) -> None:
    path = f"space/cameras/{camera.name}/marks"
    for part in ("found", "residuals") if not fits else ():
        recording.log(f"{path}/{part}", rr.Clear(recursive=False))
    if fits:
        _log_corners(recording, path, camera, arrow_scale(rig), fits)
    rings = [(fit, predicted_outline(rig, camera, fit)) for fit in fits]
    drawn = [(fit, ring) for fit, ring in rings if ring is not None]
    for part in ("predicted", "names") if not drawn else ():
        recording.log(f"{path}/{part}", rr.Clear(recursive=False))
    if drawn:
        wide = _PICTURE * min(1.0, 2 / picture_columns(len(rig.cameras)))
        _log_outlines(recording, path, camera, drawn, camera.intrinsics.width / wide)


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
    recording: rr.RecordingStream, path: str, camera: Camera, drawn: list[tuple[ViewFit, Floats]], unit: float
) -> None:
    """Outlines, and the names that find room beside them; the others show where a pointer is held. unit: px of the
    picture for a point of the viewer."""
    colours = [FAULT if fit.rejected else PREDICTED for fit, _ in drawn]
    rings, names = [ring for _, ring in drawn], [fit.view.rectangle for fit, _ in drawn]
    lines = rr.LineStrips2D(
        rings, colors=colours, radii=rr.Radius.ui_points(1.2), labels=names, show_labels=False, draw_order=29
    )
    recording.log(f"{path}/predicted", lines)
    boxes = np.array([[*np.min(ring, axis=0), *np.max(ring, axis=0)] for ring in rings])
    sizes = np.array([[_LETTER * len(name) + _AROUND, _LINE] for name in names]) * unit
    tops = beside(boxes, sizes, (camera.intrinsics.width, camera.intrinsics.height), _GAP * unit)
    room = np.flatnonzero(np.isfinite(tops).all(axis=1))
    labels = rr.Points2D(
        tops[room],
        colors=[colours[index] for index in room],
        radii=rr.Radius.ui_points(0.1),
        labels=[names[index] for index in room],
        show_labels=True,
        draw_order=32,
    )
    recording.log(f"{path}/names", labels)
