"""A rig in space in rerun: cameras with their doubt, rectangles where they stood, and names that do not overlap."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from quadrig.io.drawing.geometry import Eye, apart, extent, first_eye, magnification, outlines, positions
from quadrig.io.drawing.palette import MOVED, MOVING, STATIC, Colour
from quadrig.io.viewer.inspect.timeline import framesets_of, set_frameset
from quadrig.io.viewer.shapes import doubt_ellipsoid, frustum, named_points, transform
from quadrig.rig.result import Camera, PlacedRectangle, Rig
from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose


def log_space(recording: rr.RecordingStream, rig: Rig, colours: dict[str, Colour], times: Sequence[int]) -> None:
    """Log cameras and rectangles under space/, in the rig frame. times: ns of each frameset, by index."""
    recording.log("space", rr.ViewCoordinates.RDF, static=True)
    size, magnified = extent(rig), magnification(rig)
    for camera in rig.cameras:
        colour = colours[camera.name]
        log_frustum(recording, f"space/cameras/{camera.name}", camera, camera.rig_from_camera, colour, size)
        # The verdict says by how much they are enlarged.
        ellipsoid = doubt_ellipsoid(rig, camera, (*colour, 150), magnified)
        if ellipsoid is not None:
            recording.log(f"space/doubt/{camera.name}", ellipsoid, static=True)
    for placed in rig.rectangles:
        _log_rectangle(recording, rig, placed, times)
    _log_names(recording, rig, colours, times)


def log_frustum(
    recording: rr.RecordingStream, path: str, camera: Camera, pose: Pose, colour: Colour, size: float
) -> None:
    """Log a camera as a frustum of which a picture makes the far end. pose: of the camera in the space; size: m, of
    the whole rig."""
    recording.log(path, transform(pose), static=True)
    recording.log(path, frustum(camera.intrinsics, colour, 0.1 * size, 0.003 * size), static=True)


def _log_rectangle(recording: rr.RecordingStream, rig: Rig, placed: PlacedRectangle, times: Sequence[int]) -> None:
    path = f"space/rectangles/{placed.name}"
    rings = outlines(placed)
    if not placed.rectangle.moving:
        recording.log(path, _outline(rings[0], STATIC, 2.5), static=True)
        return
    faint = rr.LineStrips3D(list(rings), colors=[MOVED], radii=rr.Radius.ui_points(0.6))
    recording.log(f"space/everywhere/{placed.name}", faint, static=True)
    by_frameset = dict(zip(np.asarray(placed.framesets).tolist(), rings, strict=True))
    for frameset in framesets_of(rig):
        set_frameset(recording, frameset, times)
        ring = by_frameset.get(frameset)
        recording.log(path, rr.Clear(recursive=False) if ring is None else _outline(ring, MOVING, 3.0))
    recording.reset_time()


def _outline(ring: Floats, colour: Colour, radius: float) -> rr.LineStrips3D:
    return rr.LineStrips3D([ring], colors=[colour], radii=rr.Radius.ui_points(radius))


def _log_names(recording: rr.RecordingStream, rig: Rig, colours: dict[str, Colour], times: Sequence[int]) -> None:
    """Names of cameras and rectangles, moved apart where they would lie on one another from where one looks first."""
    still = [placed for placed in rig.rectangles if not placed.rectangle.moving]
    eye = first_eye(rig)
    anchors = [*positions(rig), *(_foot(outlines(placed)[0], eye) for placed in still)]
    names = [*(camera.name for camera in rig.cameras), *(placed.name for placed in still)]
    shades = [*(colours[camera.name] for camera in rig.cameras), *([STATIC] * len(still))]
    labels = apart(eye, names, np.array(anchors))
    recording.log("space/names/still", named_points(names, labels, shades), static=True)
    recording.log("space/names/leads", _leads(np.array(anchors), labels, shades), static=True)
    moving = [placed for placed in rig.rectangles if placed.rectangle.moving]
    for frameset in framesets_of(rig) if moving else []:
        set_frameset(recording, frameset, times)
        here = [(placed.name, _outline_at(placed, frameset)) for placed in moving]
        here = [(name, _foot(outline, eye)) for name, outline in here if outline is not None]
        if not here:
            recording.log("space/names/moving", rr.Clear(recursive=False))
            continue
        every = np.concatenate([labels, np.array([position for _, position in here])])
        shown = apart(eye, names + [name for name, _ in here], every)[len(names) :]
        recording.log("space/names/moving", named_points([name for name, _ in here], shown, [MOVING] * len(here)))
    recording.reset_time()


def _outline_at(placed: PlacedRectangle, frameset: int) -> Floats | None:
    rows = np.flatnonzero(np.asarray(placed.framesets) == frameset)
    return outlines(placed)[rows[0]] if len(rows) else None


def _foot(outline: Floats, eye: Eye) -> Floats:
    """Below the middle of an outline (5, 3), where its lowest corner ends: a name there covers none of it."""
    middle = outline[:4].mean(axis=0)
    return middle + ((outline - middle) @ eye.up).min() * eye.up


def _leads(anchors: Floats, labels: Floats, colours: Sequence[Colour]) -> rr.LineStrips3D:
    return rr.LineStrips3D(list(np.stack([anchors, labels], axis=1)), colors=colours, radii=rr.Radius.ui_points(0.5))
