"""Corners given by hand as Views of a recording."""

from collections.abc import Sequence

import numpy as np

from quadrig.io.config.corners_toml import CORNER_NAMES, PointedCorners, refuse_incomplete
from quadrig.io.config.rig_toml import RigConfig
from quadrig.io.recording.camera import RecordedCamera
from quadrig.io.recording.framesets import Framesets
from quadrig.io.recording.recorded_cameras import Recording
from quadrig.single.errors import QuadrigError
from quadrig.single.view import View


def corner_views(
    pointed: Sequence[PointedCorners], recording: Recording, framesets: Framesets
) -> tuple[list[View], list[str]]:
    """The Views of corners, each at the frameset of its image; and in sentences which are left out, since a corner
    lies outside its picture.

    Raises QuadrigError where a corner is missing, they are no picture of a rectangle, or they do not belong to this
    recording: no such camera or image; and where every one would be left out.
    """
    views, outside = [], []
    for one in pointed:
        if said := _outside(one, _camera_of(one, recording)):
            outside.append(said)
            continue
        refuse_incomplete(one)
        views.append(corner_view(one, recording, framesets))
    if outside and not views:
        raise QuadrigError(outside[0])
    return views, [f"left out: {said}" for said in outside]


def corner_view(pointed: PointedCorners, recording: Recording, framesets: Framesets) -> View:
    """One of corner_views."""
    camera = camera_of(pointed, recording)
    sets, images = framesets.of_camera(camera.name)
    row = int(np.flatnonzero(images == (pointed.image or 0))[0])
    frameset, stamp = int(sets[row]), int(camera.stamps[images[row]])
    return View(
        pointed.rectangle.name,
        pointed.rectangle.corners,
        pointed.pixels,
        camera.name,
        frameset,
        sigma=pointed.sigma,
        time=(stamp - int(framesets.times[0])) / 1e9 if camera.source.timed else float("nan"),
    )


def camera_of(pointed: PointedCorners, recording: Recording) -> RecordedCamera:
    """The camera that corners are of. Raises QuadrigError where they cannot be of this recording."""
    camera = _camera_of(pointed, recording)
    if said := _outside(pointed, camera):
        raise QuadrigError(said)
    return camera


def _camera_of(pointed: PointedCorners, recording: Recording) -> RecordedCamera:
    """The camera that corners are of. Raises QuadrigError where there is none, or no such image."""
    camera = next((one for one in recording.cameras if one.name == pointed.camera), None)
    if camera is None:
        names = ", ".join(one.name for one in recording.cameras)
        raise QuadrigError(f"{pointed.place}: the recording has no such camera; its cameras are {names}")
    if pointed.image is None and pointed.rectangle.moving and camera.frames > 1:
        raise QuadrigError(
            f"{pointed.place}: the rectangle moves; say in which of the camera's {camera.frames} images they are, "
            "from 0, as image = 12"
        )
    if (pointed.image or 0) >= camera.frames:
        raise QuadrigError(
            f"{pointed.place}: image is {pointed.image}, but the camera has {camera.frames} images, counted from 0"
        )
    return camera


def _outside(pointed: PointedCorners, camera: RecordedCamera) -> str:
    """That a corner lies outside the camera's pictures, in a sentence, or ""."""
    # A pixel reaches half its width around its centre.
    most = np.array([camera.width, camera.height]) - 0.5
    for name, pixel in zip(CORNER_NAMES, pointed.pixels, strict=True):
        if (pixel < -0.5).any() or (pixel > most).any():
            return (
                f"{pointed.place}: {name} is at {pixel[0]:g}, {pixel[1]:g}, outside the picture of "
                f"{camera.width}x{camera.height}; click it again with rig pick, on pictures of this recording"
            )
    return ""


def without_corners(config: RigConfig) -> list[str]:
    """A sentence for each rectangle that waits for its corners."""
    given = {one.rectangle.name for one in config.corners}
    waiting = [one.name for one in config.rectangles if one.marking.by_hand and one.name not in given]
    return [
        f"rectangle {name!r} has its corners given by hand, and corners.toml beside rig.toml has none of it; click "
        "them with rig pick"
        for name in waiting
    ]
