"""The rig of a live session in space in rerun, as far as it is known, and where the sheet should be held next."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import rerun as rr

from quadrig.io.drawing.geometry import RING, extent
from quadrig.io.drawing.palette import DONE, SHEET, Colour
from quadrig.io.drawing.things import layout, room_map, things
from quadrig.io.viewer.setup.blueprint import MAGNIFIED
from quadrig.io.viewer.shapes import doubt_ellipsoid, faces, frustum, named_points, transform
from quadrig.rig.coach.advice import Advice
from quadrig.rig.result import Rig
from quadrig.rig.words import length
from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle

# ... at most as this part of the rig's extent.
_LARGEST = 0.1
# What is shown is about this wide (px): four of them fill a screen, and a viewer decodes them in no time.
_PICTURE_WIDTH = 640


@dataclass(frozen=True, eq=False)
class Pictures:
    """The cameras' pictures as they are shown. colours, shrinks: by camera; by how much they are smaller."""

    colours: Mapping[str, Colour]
    shrinks: dict[str, int] = field(default_factory=dict)

    def shrink_to_fit(self, camera: str, width: int) -> int:
        """By how much the camera's pictures of that width, px, are shown smaller from now on."""
        self.shrinks[camera] = max(1, round(width / _PICTURE_WIDTH))
        return self.shrinks[camera]

    def shown(self, camera: str, pixels: Floats) -> Floats:
        """Where pixels (..., 2) of the camera's picture are in the smaller one that is shown."""
        return (pixels + 0.5) / self.shrinks.get(camera, 1) - 0.5


def log_rig(recording: rr.RecordingStream, rig: Rig, pictures: Pictures) -> None:
    """Log cameras with their doubt and names, and the sheets where they were held."""
    # In a room cameras are drawn as large as it can show them.
    size = extent(rig) if rig.room is None else room_map(rig, rig.room).extent
    for camera in rig.cameras:
        path, colour = f"cameras/{camera.name}", pictures.colours[camera.name]
        shrink = pictures.shrinks.get(camera.name, 1)
        recording.log(path, transform(camera.rig_from_camera))
        recording.log(
            f"{path}/image", frustum(camera.intrinsics, colour, 0.08 * size, rr.Radius.ui_points(2.0), shrink)
        )
        ellipsoid = doubt_ellipsoid(rig, camera, colour, MAGNIFIED, _LARGEST * size)
        if ellipsoid is not None:
            recording.log(f"doubt/{camera.name}", ellipsoid)
    names = [_label(rig, camera.name) for camera in rig.cameras]
    positions = np.array([camera.rig_from_camera.translation for camera in rig.cameras])
    colours = [pictures.colours[camera.name] for camera in rig.cameras]
    recording.log("names", named_points(names, positions, colours))
    rings = [ring for thing in things(rig) for ring in thing.rings.reshape(-1, 5, 3)]
    if rig.room is not None:
        # The room where the rig saw it last.
        rings += list(rig.room.rig_from_body[-1].transform(layout(rig, rig.room)[1]))
    recording.log("sheets", rr.LineStrips3D(rings, colors=SHEET, radii=rr.Radius.ui_points(1.0)))


def log_ghost(
    recording: rr.RecordingStream,
    advice: Advice | None,
    rectangles: Mapping[str, Rectangle],
    rig: Rig | None,
    pictures: Pictures,
) -> None:
    """Log where the advice wants the sheet, in space and in the pictures; or clear it."""
    if advice is None or advice.ghost is None or advice.rectangle not in rectangles:
        recording.log("ghost", rr.Clear(recursive=True))
        for name in pictures.colours:
            recording.log(f"cameras/{name}/image/ghost", rr.Clear(recursive=False))
        return
    corners = advice.ghost.transform(rectangles[advice.rectangle].corners)
    thick = rr.Radius.ui_points(3.0)
    if rig is not None and rig.room is not None:
        # What hangs on a wall cannot be held elsewhere: the pictures show where it is to be seen.
        recording.log("ghost", rr.Clear(recursive=True))
    else:
        rings = _with_its_body(rig, advice.rectangle, advice.ghost, corners)
        recording.log("ghost", faces(rings, DONE))
        labels = ["hold it here"] + [""] * (len(rings) - 1)
        recording.log("ghost/outline", rr.LineStrips3D(list(rings), colors=[DONE], radii=thick, labels=labels))
    for name in pictures.colours:
        pixels = _in_picture(rig, name, corners)
        # Without a label: it would lie on the sheet's own whenever the sheet is nearly there.
        line = rr.LineStrips2D([pictures.shown(name, pixels[RING])], colors=[DONE], radii=thick)
        seen = np.isfinite(pixels).all()
        recording.log(f"cameras/{name}/image/ghost", line if seen else rr.Clear(recursive=False))


def _with_its_body(rig: Rig | None, rectangle: str, pose: Pose, corners: Floats) -> Floats:
    """Outlines (K, 5, 3) of a rectangle of these corners (4, 3) at a pose, and of what is fixed to it."""
    body = next((one for one in rig.bodies if rectangle in one.rectangles), None) if rig is not None else None
    if rig is None or body is None:
        return corners[RING][None]
    rig_from_body = pose @ body.body_from_rect[body.rectangles.index(rectangle)].inverse()
    return rig_from_body.transform(layout(rig, body)[1])


def _in_picture(rig: Rig | None, name: str, points: Floats) -> Floats:
    """Pixels (P, 2) of points (P, 3) in the rig frame; nan where the camera is not placed or does not see them."""
    for camera in rig.cameras if rig is not None else ():
        if camera.name == name:
            return camera.intrinsics.project(camera.rig_from_camera.inverse().transform(points))
    return np.full((len(points), 2), np.nan)


def _label(rig: Rig, name: str) -> str:
    """A camera's name and how sure its position is; the reference's is so by definition."""
    sigma = rig.position_sigma(name)
    return f"{name} ± {length(sigma)}" if sigma > 0 else name
