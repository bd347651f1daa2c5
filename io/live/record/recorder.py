"""Recording while it happens: an MCAP of what the cameras gave, whole up to the last second whatever happens."""

import os
import queue
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from quadrig.io.file_kind import RECORDING
from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.record.kept_views import KEPT_SCHEMA, KEPT_TOPIC
from quadrig.io.topic_writer import TopicWriter
from quadrig.io.whole_file import cannot_write, new_part, place_held, refuse_other_kind
from quadrig.single.errors import QuadrigError

# A chunk is closed when it is this old, so that a crash loses less than the second that is promised.
FLUSH_SECONDS = 0.5
# Frames that wait for a slow disk; more than this (a second or two of four cameras) and new ones are dropped.
_WAITING_FRAMES = 64


@dataclass(frozen=True, eq=False)
class _Note:
    stamp: int
    data: bytes


class LiveRecorder:
    """Writes frames to an MCAP on a thread of its own, as foxglove.CompressedImage on /NAME/image_raw/compressed.

    The file appears with the first of them, in the place of what was there and of the files that it `replaces`.
    A recording that stops without close() has no index at its end; every chunk that was flushed can be read.
    Raises QuadrigError where the file cannot be written, or another process writes it.
    """

    def __init__(
        self, path: Path, attachments: Mapping[str, bytes] | None = None, replaces: Sequence[Path] = ()
    ) -> None:
        self.path, self.dropped, self._replaces = path, 0, tuple(replaces)
        self._held = ExitStack()
        self._place = self._held.enter_context(place_held(path))
        try:
            refuse_other_kind(path, RECORDING)
            self._part: Path | None = new_part(self._place)
            self._file = self._part.open("wb")
        except OSError as error:
            self._held.close()
            raise cannot_write(path, error) from error
        except QuadrigError:
            self._held.close()
            raise
        # Uncompressed: JPEG does not get smaller by compressing it again.
        self._writer = TopicWriter(self._file)
        self._writer.declare_json(KEPT_TOPIC, KEPT_SCHEMA)
        for name, data in (attachments or {}).items():
            self._writer.attach(name, "application/octet-stream", data, time.time_ns())
        self._queue: queue.Queue[Frame | _Note | None] = queue.Queue(_WAITING_FRAMES)
        self._failure, self._written = "", False
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
            kept = "" if self._part else "; what was recorded until then is kept"
            self._failure = f"{self.path}: recording stopped ({error.strerror}); make room on the disk{kept}"
            _empty(self._queue)
        except QuadrigError as error:
            self._failure = str(error)
            _empty(self._queue)
        finally:
            with suppress(OSError):
                self._file.close()
            if self._part is not None:
                self._part.unlink(missing_ok=True)
            self._held.close()

    def _write_until_closed(self) -> None:
        flushed = time.monotonic()
        while True:
            try:
                item = self._queue.get(timeout=max(0.0, flushed + FLUSH_SECONDS - time.monotonic()))
                if item is None:
                    break
                self._write(item)
            except queue.Empty:
                pass
            if time.monotonic() - flushed >= FLUSH_SECONDS:
                self._flush()
                flushed = time.monotonic()
        self._flush()

    def _write(self, item: Frame | _Note) -> None:
        if isinstance(item, Frame):
            topic = f"/{item.camera}/image_raw/compressed"
            self._writer.write_protobuf(topic, _compressed_image(item), item.stamp)
        else:
            self._writer.write_json(KEPT_TOPIC, item.data, item.stamp)
        self._written = True

    def _flush(self) -> None:
        """Keep what was written also when this process is killed; with the first of it the file appears."""
        self._writer.flush()
        if self._part is not None and self._written:
            for old in self._replaces:
                old.unlink(missing_ok=True)
            self._part.replace(self._place)
            self._part = None


def _compressed_image(frame: Frame) -> Any:
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    message = CompressedImage(frame_id=frame.camera, data=frame.jpeg(), format=frame.format)
    message.timestamp.FromNanoseconds(frame.stamp)
    return message


def _empty(waiting: "queue.Queue[Frame | _Note | None]") -> None:
    while True:
        try:
            waiting.get_nowait()
        except queue.Empty:
            return
