"""Turn videos and folders of images into an MCAP recording that any tool opens."""

import heapq
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Literal

import cv2
import numpy as np

from quadrig.io.progress import progress_bar
from quadrig.io.recording.camera import RecordedCamera
from quadrig.io.recording.decode_image import UndecodableImage, read_picture_file
from quadrig.io.recording.image_folder import ImageFiles
from quadrig.io.recording.image_source import Stamped
from quadrig.io.recording.messages.image_message import ROS2_DEFINITIONS
from quadrig.io.topic_writer import TopicWriter
from quadrig.io.whole_file import written_beside
from quadrig.single.arrays import Picture
from quadrig.single.errors import QuadrigError

MessageFormat = Literal["foxglove", "ros2"]
ImageFormat = Literal["jpeg", "png"]

# Files of these kinds go into the recording as they are, to the last bit.
_COPIED = {"jpg": "jpeg", "jpeg": "jpeg", "png": "png"}
# PNG's first level is three times faster than its default and 5 % larger on photographs.
_PNG_LEVEL = 1
# builtin_interfaces/Time counts seconds in 32 bits.
_ROS_ENDS = 2**31


@dataclass(frozen=True)
class Recorded:
    """What was written: images and bytes by camera; unreadable: images that had to be skipped."""

    images: dict[str, int]
    bytes: int
    unreadable: int
    encoded: dict[str, str]


def record(
    cameras: Sequence[RecordedCamera],
    output: Path,
    messages: MessageFormat = "foxglove",
    images: ImageFormat = "jpeg",
    quality: int = 95,
    progress: bool = True,
) -> Recorded:
    """Write the images of these cameras, in the order of their time, on /NAME/image_raw/compressed.

    JPEG and PNG files are copied as they are; what is decoded (videos, other files) is encoded as `images`, JPEG with
    this quality. Raises QuadrigError where the file cannot be written.
    """
    counts = {camera.name: 0 for camera in cameras}
    encoded: dict[str, str] = {}
    size = unreadable = 0
    with written_beside(output) as beside, beside.open("wb") as stream:
        write, finish = image_writer(stream, messages)
        total = sum(camera.frames for camera in cameras)
        with progress_bar("record", total, "images", quiet=not progress) as advance:
            streams = [_encoded(k, camera, images, quality) for k, camera in enumerate(cameras)]
            # An MCAP has no time before zero, as a video or a table may.
            later = max(0, *(-int(camera.stamps.min(initial=0)) for camera in cameras))
            for stamp, k, _, form, data in heapq.merge(*streams, key=lambda entry: entry[:3]):
                advance(1)
                if not data:
                    unreadable += 1
                    continue
                name = cameras[k].name
                write(name, stamp + later, form, data)
                counts[name] += 1
                encoded[name] = form
                size += len(data)
        finish()
    return Recorded(counts, size, unreadable, encoded)


def _encoded(
    number: int, camera: RecordedCamera, form: ImageFormat, quality: int
) -> Iterator[tuple[int, int, int, str, bytes]]:
    """Stamp, camera's number, image's number, format and bytes of each image; no bytes where it is unreadable."""
    source = camera.source.source if isinstance(camera.source, Stamped) else camera.source
    # heapq.merge needs rising stamps from each camera.
    order = np.argsort(camera.stamps, kind="stable")
    if isinstance(source, ImageFiles) and source.encoding in _COPIED:
        for k in order.tolist():
            yield int(camera.stamps[k]), number, k, _COPIED[source.encoding], _bytes_of(source.paths[k])
        return
    rising = bool(np.all(np.diff(order) > 0))
    parts = [camera.source] if rising else (camera.source.part(np.array([k])) for k in order)
    images = (image for part in parts for image in part.images(gray=False))
    for k, image in zip(order.tolist(), images, strict=True):
        data = b"" if image is None else _encode(image, form, quality)
        yield int(camera.stamps[k]), number, k, form, data


def _bytes_of(path: Path) -> bytes:
    """None where the file cannot be read, or is larger than a picture."""
    try:
        return read_picture_file(path)
    except UndecodableImage:
        return b""


def _encode(image: Picture, form: ImageFormat, quality: int) -> bytes:
    if form == "jpeg":
        return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL])[1].tobytes()


Write = Callable[[str, int, str, bytes], None]


def image_writer(stream: BinaryIO, messages: MessageFormat) -> tuple[Write, Callable[[], None]]:
    """How to write one image (camera, stamp ns, format, bytes), and how to finish."""
    # What is JPEG or PNG does not get smaller: chunks without compression can be read in any place.
    if messages == "ros2":
        from mcap.writer import CompressionType
        from mcap_ros2.writer import Writer as Ros2Writer

        ros2 = Ros2Writer(stream, compression=CompressionType.NONE)
        name = "sensor_msgs/msg/CompressedImage"
        schema = ros2.register_msgdef(name, ROS2_DEFINITIONS[name])

        def write_ros2(camera: str, stamp: int, form: str, data: bytes) -> None:
            seconds, nanoseconds = divmod(stamp, 10**9)
            if seconds >= _ROS_ENDS:
                raise QuadrigError(f"ROS 2 has no time of {seconds} s, which is after 2038; give --format foxglove")
            header = {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": camera}
            message = {"header": header, "format": form, "data": data}
            ros2.write_message(_topic(camera), schema, message, stamp, stamp)

        return write_ros2, ros2.finish
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    foxglove = TopicWriter(stream)

    def write_foxglove(camera: str, stamp: int, form: str, data: bytes) -> None:
        message: Any = CompressedImage(frame_id=camera, format=form, data=data)
        message.timestamp.FromNanoseconds(stamp)
        foxglove.write_protobuf(_topic(camera), message, stamp)

    return write_foxglove, foxglove.finish


def _topic(camera: str) -> str:
    return f"/{camera}/image_raw/compressed"
