"""Detections kept: an MCAP of ImageAnnotations for the eye and of our own exact record for the next solve."""

import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np

from quadrig.io.recording.camera import RecordedCamera
from quadrig.io.recording.image_folder import folder_images
from quadrig.io.recording.mcap_reader import McapBytes, index_mcap
from quadrig.io.recording.recorded_cameras import Recording
from quadrig.io.rig_file.view_record import ViewRecord, recorded_view, view_record
from quadrig.io.topic_writer import TopicWriter
from quadrig.single.arrays import Ints
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.registry import marking_values
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

DETECTIONS_TOPIC = "/quadrig/detections"
FORMAT = 4
"""Raised when detection or this record changes, so that old files are not taken for new ones."""


class ImageRecord(msgspec.Struct):
    """What was found in one image of one camera; views is None where the image could not be read."""

    key: str
    camera: str
    image: int
    stamp: int
    views: list[ViewRecord] | None


Found = dict[tuple[str, int], tuple[View, ...] | None]
"""Views by camera and image; None where the image could not be read."""


def camera_key(recording: Recording, camera: RecordedCamera, rectangles: Sequence[Rectangle]) -> str:
    """What detections in a camera's images depend on, as a short word: the files, the topic, the markings."""
    files = [_file_mark(path) for path in recording.files]
    # A surveyed pose, or whether it moves, changes nothing of what is seen.
    sheets = [{k: v for k, v in _plain(one).items() if k not in ("moving", "world_from_rect")} for one in rectangles]
    mark = [FORMAT, files, Path(camera.topic).name, camera.width, camera.height, camera.frames, sheets]
    return hashlib.blake2b(msgspec.json.encode(mark), digest_size=12).hexdigest()


def detections_beside(result: Path) -> Path:
    """Where the detections behind a result are kept: rig.detections.mcap beside rig.mcap."""
    return result.with_suffix(".detections.mcap")


def read_detections(path: Path, keys: Mapping[str, str]) -> Found:
    """What is kept in the file for cameras with these keys; nothing where there is no such file, or only others."""
    found: Found = {}
    for partial in (path, _partial(path)):
        for record in _records(partial):
            if keys.get(record.camera) == record.key:
                found[record.camera, record.image] = _views(record)
    return found


class DetectionWriter:
    """Writes what was found, image by image. Made by `keep_detections`."""

    def __init__(self, stream: BinaryIO, keys: Mapping[str, str]) -> None:
        self._keys = keys
        self._writer = TopicWriter(stream, "lz4")
        self._writer.declare_json(DETECTIONS_TOPIC, "quadrig.ImageDetections")

    def write(self, camera: str, image: int, stamp: int, views: Sequence[View] | None) -> None:
        """Add one image. views: None where it could not be read."""
        records = None if views is None else [view_record(view) for view in views]
        record = ImageRecord(self._keys[camera], camera, image, stamp, records)
        self._writer.write_json(DETECTIONS_TOPIC, msgspec.json.encode(record), stamp)
        if views:
            self._writer.write_protobuf(f"/{camera}/annotations", _annotations(views, stamp), stamp)

    def flush(self) -> None:
        """Keep what was written so far, also when this process is killed."""
        self._writer.flush()

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()


@contextmanager
def keep_detections(
    path: Path, keys: Mapping[str, str], kept: Found, stamps: Mapping[str, Ints]
) -> Iterator[DetectionWriter]:
    """A DetectionWriter for `path` that has what was kept before; the file appears whole, also when interrupted.

    A process that is killed leaves a file beside it that the next run reads as far as it goes.
    Raises QuadrigError where the folder cannot be written to.
    """
    partial = _partial(path)
    beside = partial.with_name(f"{partial.name}-{os.getpid()}")
    try:
        stream = beside.open("wb")
    except OSError as error:
        raise QuadrigError(f"{path}: cannot be written ({error.strerror}); choose another place") from error
    try:
        with stream:
            writer = DetectionWriter(stream, keys)
            for (camera, image), views in kept.items():
                writer.write(camera, image, int(stamps[camera][image]), views)
            writer.flush()
            # From here on this file has all that the former partial one had.
            beside.replace(partial)
            try:
                yield writer
            finally:
                writer.finish()
    finally:
        partial.replace(path)


def _partial(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")


def _records(path: Path) -> Iterator[ImageRecord]:
    if not path.is_file():
        return
    try:
        index = index_mcap(path)
    except QuadrigError:
        return
    with closing(McapBytes(path)) as file:
        for topic in index.topics:
            if topic.topic == DETECTIONS_TOPIC:
                for chunk, offset in zip(topic.chunks.tolist(), topic.offsets.tolist(), strict=True):
                    try:
                        yield msgspec.json.decode(file.message(chunk, offset), type=ImageRecord)
                    except msgspec.MsgspecError:
                        return


def _views(record: ImageRecord) -> tuple[View, ...] | None:
    if record.views is None:
        return None
    return tuple(replace(recorded_view(one), camera=record.camera) for one in record.views)


def _annotations(views: Sequence[View], stamp: int) -> Any:
    from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
    from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation

    message = ImageAnnotations()
    for view in views:
        marks = message.points.add(type=PointsAnnotation.POINTS, thickness=4.0)
        marks.timestamp.FromNanoseconds(stamp)
        marks.outline_color.r, marks.outline_color.g, marks.outline_color.b = 0.1, 0.9, 0.4
        marks.outline_color.a = 1.0
        for x, y in np.asarray(view.pixels).tolist():
            marks.points.add(x=x, y=y)
        label = message.texts.add(text=view.rectangle, font_size=14.0)
        label.timestamp.FromNanoseconds(stamp)
        label.position.x, label.position.y = np.asarray(view.pixels).mean(axis=0).tolist()
        label.text_color.r = label.text_color.g = label.text_color.b = label.text_color.a = 1.0
    return message


def _file_mark(path: Path) -> list:
    """Name, size and time of a file, or of every image in a folder: what changes when the pictures do."""
    parts = folder_images(path) if path.is_dir() else [path]
    return [[part.name, part.stat().st_size, part.stat().st_mtime_ns] for part in parts]


def _plain(rectangle: Rectangle) -> dict[str, Any]:
    return {**asdict(rectangle), "marking": marking_values(rectangle.marking), "world_from_rect": None}
