"""A room that a rig was carried through, in rerun: what hangs in it stands still, and the rig goes its way."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from quadrig.io.drawing.geometry import apart, foot
from quadrig.io.drawing.palette import PREDICTED, STATIC, Colour
from quadrig.io.drawing.things import room_map
from quadrig.io.viewer.inspect.timeline import set_frameset
from quadrig.io.viewer.shapes import faces, frustum, level_grid, named_points, outline, transform
from quadrig.rig.result import PlacedBody, Rig

# A view of the whole room shows cameras of this share of it.
_CAMERA = 0.06


def log_room(
    recording: rr.RecordingStream, rig: Rig, body: PlacedBody, colours: dict[str, Colour], times: Sequence[int]
) -> None:
    """Log the room under room/, in its frame: rectangles, the path, and the rig at its framesets."""
    room = room_map(rig, body)
    recording.log("room", rr.ViewCoordinates.RDF, static=True)
    recording.log("room/rectangles", outline(room.rings, STATIC, 2.5), static=True)
    recording.log("room/rectangles/faces", faces(room.rings, STATIC), static=True)
    eye = room.eye()
    feet = np.array([foot(ring[None], eye) for ring in room.rings]).reshape(-1, 3)
    shades = [STATIC] * len(feet)
    labels = apart(eye, room.names, feet)
    recording.log("room/names", named_points(room.names, labels, shades), static=True)
    path = rr.LineStrips3D(room.stretches(), colors=[PREDICTED], radii=rr.Radius.ui_points(1.2))
    recording.log("room/path", path, static=True)
    for camera in rig.cameras:
        at, depth = f"room/rig/{camera.name}", _CAMERA * room.extent
        recording.log(at, transform(camera.rig_from_camera), static=True)
        line = rr.Radius.ui_points(1.5)
        recording.log(at, frustum(camera.intrinsics, colours[camera.name], depth, line), static=True)
    for row, frameset in enumerate(room.framesets):
        set_frameset(recording, int(frameset), times)
        recording.log("room/rig", transform(room.room_from_rig[row]))
    recording.reset_time()


def room_view(rig: Rig, body: PlacedBody) -> rrb.Spatial3DView:
    """The room as its map's eye sees it."""
    room = room_map(rig, body)
    eye = room.eye()
    return rrb.Spatial3DView(
        origin="room",
        name=f"carried through: {body.name}",
        line_grid=level_grid(room.points(), eye.up, room.extent),
        eye_controls=rrb.EyeControls3D(position=eye.position, look_target=eye.target, eye_up=eye.up),
    )
