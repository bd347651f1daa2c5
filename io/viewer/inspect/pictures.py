"""The pictures of a recording that belong to the framesets of a rig."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from quadrig.io.recording.framesets import build_framesets
from quadrig.io.recording.recorded_cameras import Recording, open_recording
from quadrig.rig.result import Rig
from quadrig.single.arrays import Ints, Picture

# Enough to see every place the rectangles were held; a thousand pictures would make a file of gigabytes.
MOST_FRAMESETS = 80
_QUALITY = 80


def rig_pictures(
    rig: Rig, times: Sequence[int], paths: Sequence[Path], most: int = MOST_FRAMESETS
) -> Iterator[tuple[int, str, bytes]]:
    """(frameset, camera, JPEG) of the framesets that the rig has Views of, by time; at most so many framesets.

    times: ns of the rig's framesets, by index; without them the recording's own framesets are counted anew.
    Raises QuadrigError where the recording cannot be read or lacks a camera of the rig.
    """
    recording = open_recording(paths, {camera.name: None for camera in rig.cameras})
    framesets = sorted({fit.view.frameset for fit in rig.fits})
    if len(framesets) > most:
        framesets = [framesets[int(i)] for i in np.linspace(0, len(framesets) - 1, most).round()]
    for camera in rig.cameras:
        images = images_of_framesets(recording, camera.name, framesets, times)
        source = recording.camera(camera.name).source
        known = [(frameset, image) for frameset, image in zip(framesets, images, strict=True) if image >= 0]
        indices = np.array([image for _, image in known], int)
        if not len(indices):
            continue
        for (frameset, _), picture in zip(known, source.part(indices).images(), strict=False):
            if picture is not None:
                yield frameset, camera.name, _jpeg(picture)


def images_of_framesets(
    recording: Recording, camera: str, framesets: Sequence[int], times: Sequence[int]
) -> list[int]:
    """Index of the camera's image of each frameset, -1 where it has none."""
    if not times:
        built = build_framesets(recording)
        column = built.frames[:, built.cameras.index(camera)]
        return [int(column[index]) if index < len(column) else -1 for index in framesets]
    stamps = recording.camera(camera).stamps
    return [_nearest(stamps, times[index]) if index < len(times) else -1 for index in framesets]


def _nearest(stamps: Ints, time: int) -> int:
    """The image nearest to a time, within half the usual interval of images."""
    if not len(stamps):
        return -1
    nearest = int(np.argmin(np.abs(stamps - time)))
    interval = float(np.median(np.diff(np.sort(stamps)))) if len(stamps) > 1 else np.inf
    return nearest if abs(int(stamps[nearest]) - time) <= 0.6 * interval else -1


def _jpeg(picture: Picture) -> bytes:
    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return data.tobytes() if done else b""
