"""Recording while it happens: an MCAP of what the cameras gave, whole up to the last second whatever happens."""

import os
import queue
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.kept_views import KEPT_SCHEMA, KEPT_TOPIC
from quadrig.single.errors import QuadrigError

# A chunk is closed when it is this old, so that a crash loses less than the second that is promised.
FLUSH_SECONDS = 0.5
# ... or this large: chunks are what a reader of a cut file holds in memory.
_CHUNK_BYTES = 4 * 1024 * 1024
# Frames that wait for a slow disk; more than this (a second or two of four cameras) and new ones are dropped.
_WAITING_FRAMES = 64


@dataclass(frozen=True, eq=False)
class _Note:
    stamp: int
    data: bytes


class LiveRecorder:
    """Writes frames to an MCAP on a thread of its own, as foxglove.CompressedImage on /NAME/image_raw/compressed.

    A recording that stops without close() has no index at its end; every chunk that was flushed can be read.
    Raises QuadrigError where the file cannot be written.
    """

    def __init__(self, path: Path, attachments: Mapping[str, bytes] | None = None) -> None:
        from mcap.writer import CompressionType, Writer

        self.path, self.dropped, self.frames = path, 0, 0
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise QuadrigError(f"{path}: cannot be written ({error.strerror}); choose another place") from None
        # JPEG does not get smaller by compressing it again.
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES, compression=CompressionType.NONE)
        self._writer.start(profile="", library="quadrig")
        for name, data in (attachments or {}).items():
            self._writer.add_attachment(0, time.time_ns(), name, "application/octet-stream", data)
        self._channels: dict[str, int] = {}
        self._schema = _register_compressed_image(self._writer)
        self._queue: queue.Queue[Frame | _Note | None] = queue.Queue(_WAITING_FRAMES)
        self._failure = ""
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def write(self, frame: Frame, wait: bool = False) -> None:
        """Hand a frame over. Where the disk cannot keep up: dropped and counted, or waited for.

        Raises QuadrigError where an earlier frame could not be written.
        """
        if self._failure:
            raise QuadrigError(self._failure)
        try:
            self._queue.put(frame, block=wait)
        except queue.Full:
            self.dropped += 1

    def note(self, stamp: int, data: bytes) -> None:
        """Keep a record of Views (JSON, see kept_views) with the frames; notes are waited for, never dropped."""
        if self._failure:
            raise QuadrigError(self._failure)
        self._queue.put(_Note(stamp, data))

    def close(self) -> None:
        """Write what waits, the index and the end of the file."""
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()
        if self._failure:
            raise QuadrigError(self._failure)

    def _run(self) -> None:
        try:
            self._write_until_closed()
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            self._failure = f"{self.path}: recording stopped ({error.strerror}); make room on the disk"
            _empty(self._queue)
        except QuadrigError as error:
            self._failure = str(error)
            _empty(self._queue)
        finally:
            self._file.close()

    def _write_until_closed(self) -> None:
        flushed = time.monotonic()
        while True:
            try:
                item = self._queue.get(timeout=max(0.0, flushed + FLUSH_SECONDS - time.monotonic()))
                if item is None:
                    return
                if isinstance(item, Frame):
                    self._write_frame(item)
                else:
                    self._write_note(item)
            except queue.Empty:
                pass
            if time.monotonic() - flushed >= FLUSH_SECONDS:
                self._writer.flush()
                flushed = time.monotonic()

    def _write_note(self, note: _Note) -> None:
        if KEPT_TOPIC not in self._channels:
            schema = self._writer.register_schema(KEPT_SCHEMA, "jsonschema", b'{"type": "object"}')
            self._channels[KEPT_TOPIC] = self._writer.register_channel(KEPT_TOPIC, "json", schema)
        self._writer.add_message(self._channels[KEPT_TOPIC], note.stamp, note.data, note.stamp)

    def _write_frame(self, frame: Frame) -> None:
        if frame.camera not in self._channels:
            topic = f"/{frame.camera}/image_raw/compressed"
            self._channels[frame.camera] = self._writer.register_channel(topic, "protobuf", self._schema)
        data = _compressed_image(frame)
        self._writer.add_message(self._channels[frame.camera], frame.stamp, data, frame.stamp, self.frames)
        self.frames += 1


def _register_compressed_image(writer) -> int:
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
    from mcap_protobuf.schema import build_file_descriptor_set

    descriptors = build_file_descriptor_set(CompressedImage).SerializeToString()
    return writer.register_schema("foxglove.CompressedImage", "protobuf", descriptors)


def _compressed_image(frame: Frame) -> bytes:
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    message = CompressedImage(frame_id=frame.camera, data=frame.jpeg(), format=frame.format)
    message.timestamp.FromNanoseconds(frame.stamp)
    return message.SerializeToString()


def _empty(waiting: "queue.Queue[Frame | _Note | None]") -> None:
    while True:
        try:
            waiting.get_nowait()
        except queue.Empty:
            return
