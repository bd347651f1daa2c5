"""A rig in space in rerun: cameras with their doubt, rectangles where they stood, and names that do not overlap."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from quadrig.io.drawing.geometry import apart, extent, first_eye, foot, magnification, positions
from quadrig.io.drawing.palette import MOVED, MOVING, STATIC, Colour
from quadrig.io.drawing.things import Thing, things
from quadrig.io.viewer.inspect.timeline import framesets_of, set_frameset
from quadrig.io.viewer.shapes import doubt_ellipsoid, faces, frustum, named_points, outline, transform
from quadrig.rig.result import Camera, Rig
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
    shown = things(rig)
    for thing in shown:
        _log_thing(recording, rig, thing, times)
    _log_names(recording, rig, shown, colours, times)


def log_frustum(
    recording: rr.RecordingStream, path: str, camera: Camera, pose: Pose, colour: Colour, size: float
) -> None:
    """Log a camera as a frustum of which a picture makes the far end. pose: of the camera in the space; size: m, of
    the whole rig."""
    recording.log(path, transform(pose), static=True)
    recording.log(path, frustum(camera.intrinsics, colour, 0.1 * size, 0.003 * size), static=True)


def _log_thing(recording: rr.RecordingStream, rig: Rig, thing: Thing, times: Sequence[int]) -> None:
    """A rectangle, or the rectangles of a body as the faces of one thing, and faintly all places where it was."""
    path = f"space/rectangles/{thing.name}"
    if not thing.moves:
        recording.log(path, outline(thing.rings[0], STATIC, 2.5), static=True)
        return
    recording.log(f"space/everywhere/{thing.name}", _everywhere(thing), static=True)
    for frameset in framesets_of(rig):
        set_frameset(recording, frameset, times)
        rings = thing.at(frameset)
        if rings is None:
            recording.log(path, rr.Clear(recursive=True))
            continue
        recording.log(path, outline(rings, MOVING, 3.0 if len(rings) == 1 else 1.5))
        if len(rings) > 1:
            recording.log(f"{path}/faces", faces(rings, MOVING))
    recording.reset_time()


def _everywhere(thing: Thing) -> rr.LineStrips3D | rr.Points3D:
    """Faint outlines of a rectangle, or the places of a body's middle: its faces would hide it where it turns."""
    if len(thing.rings[0]) == 1:
        return rr.LineStrips3D(list(thing.rings[:, 0]), colors=[MOVED], radii=rr.Radius.ui_points(0.6))
    return rr.Points3D(thing.rings[..., :4, :].mean(axis=(1, 2)), colors=[MOVED], radii=rr.Radius.ui_points(1.5))


def _log_names(
    recording: rr.RecordingStream,
    rig: Rig,
    shown: Sequence[Thing],
    colours: dict[str, Colour],
    times: Sequence[int],
) -> None:
    """Names of cameras and things, moved apart where they would lie on one another from where one looks first."""
    still = [thing for thing in shown if not thing.moves]
    eye = first_eye(rig)
    anchors = [*positions(rig), *(foot(thing.rings[0], eye) for thing in still)]
    names = [*(camera.name for camera in rig.cameras), *(thing.name for thing in still)]
    shades = [*(colours[camera.name] for camera in rig.cameras), *([STATIC] * len(still))]
    labels = apart(eye, names, np.array(anchors))
    recording.log("space/names/still", named_points(names, labels, shades), static=True)
    recording.log("space/names/leads", _leads(np.array(anchors), labels, shades), static=True)
    moving = [thing for thing in shown if thing.moves]
    for frameset in framesets_of(rig) if moving else []:
        set_frameset(recording, frameset, times)
        here = [(thing.name, thing.at(frameset)) for thing in moving]
        here = [(name, foot(rings, eye)) for name, rings in here if rings is not None]
        if not here:
            recording.log("space/names/moving", rr.Clear(recursive=False))
            continue
        every = np.concatenate([labels, np.array([position for _, position in here])])
        beside = apart(eye, names + [name for name, _ in here], every)[len(names) :]
        recording.log("space/names/moving", named_points([name for name, _ in here], beside, [MOVING] * len(here)))
    recording.reset_time()


def _leads(anchors: Floats, labels: Floats, colours: Sequence[Colour]) -> rr.LineStrips3D:
    return rr.LineStrips3D(list(np.stack([anchors, labels], axis=1)), colors=colours, radii=rr.Radius.ui_points(0.5))
