"""Where a camera's images come from: a topic, a video, a folder. Small to send to another process."""

import os
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np

from quadrig.io.recording.decode_image import decode_image
from quadrig.io.recording.image_message import STAMP_BYTES, Payload, read_payload, read_stamp, stamp_of_whole
from quadrig.io.recording.mcap_reader import McapBytes, TopicMessages
from quadrig.single.arrays import Ints, Picture


class ImageSource(Protocol):
    """The images of one camera in the order of their arrival.

    Frozen and picklable: a part of it is what a worker process gets.
    """

    def __len__(self) -> int: ...

    @property
    def encoding(self) -> str:
        """How the images are stored: jpeg, png, bgr8, h264..."""
        ...

    def stamps(self) -> Ints:
        """Time of each image (N,) int64 ns: the message's own stamp, else the time of its recording."""
        ...

    def quick_stamps(self) -> Ints:
        """As stamps, but of what needs no reading of the images: the time of recording may have to do."""
        ...

    def part(self, indices: Ints) -> "ImageSource":
        """The images of these rising indices alone."""
        ...

    def images(self, gray: bool = True, shrink: int = 1) -> Iterator[Picture | None]:
        """Every image (H, W) or (H, W, 3) BGR uint8 in turn, one in memory at a time; None where it is unreadable.

        shrink: at 1/2, 1/4 or 1/8 of its size, for a quick look.
        """
        ...

    def batches(self, indices: Ints, size: int) -> list[Ints]:
        """Split rising indices into parts of about `size`, where the images can be entered well."""
        ...


def even_batches(indices: Ints, size: int) -> list[Ints]:
    """Parts of `size` indices."""
    return [indices[start : start + size] for start in range(0, len(indices), size)]


@dataclass(frozen=True, eq=False)
class McapMessages:
    """The messages of one topic over one or more files (a recording that was split), by time.

    files (N,): which of `topics` each message is in; messages (N,): its index there.
    """

    topics: tuple[TopicMessages, ...]
    files: Ints
    messages: Ints

    @staticmethod
    def of(topics: Sequence[TopicMessages]) -> "McapMessages":
        """All messages of these topics, in the order of their log times."""
        files = np.concatenate([np.full(len(topic), k, np.int64) for k, topic in enumerate(topics)])
        messages = np.concatenate([np.arange(len(topic)) for topic in topics])
        order = np.argsort(np.concatenate([topic.log_times for topic in topics]), kind="stable")
        return McapMessages(tuple(topics), files[order], messages[order])

    def __len__(self) -> int:
        return len(self.messages)

    @property
    def message_encoding(self) -> str:
        """cdr, protobuf or json."""
        return self.topics[0].encoding

    @property
    def schema(self) -> str:
        """The name of the messages' schema."""
        return self.topics[0].schema

    def part(self, indices: Ints) -> "McapMessages":
        """The messages of these indices alone."""
        files, messages = self.files[indices], self.messages[indices]
        topics = []
        for k, topic in enumerate(self.topics):
            here = files == k
            topics.append(topic.part(messages[here]))
            messages[here] = np.arange(np.count_nonzero(here))
        return McapMessages(tuple(topics), files, messages)

    def data(self, index: int, limit: int | None = None) -> bytes:
        """The bytes of a message, or its first `limit`."""
        topic, message = self.topics[self.files[index]], self.messages[index]
        file = _open_mcap(topic.path, os.getpid())
        return file.message(int(topic.chunks[message]), int(topic.offsets[message]), limit)

    def payload(self, index: int) -> Payload:
        """The image of a message. Raises ValueError where the bytes are not such a message."""
        return read_payload(self.message_encoding, self.schema, self.data(index))

    def stamps(self) -> Ints:
        """Time of each message (N,) int64 ns: its own stamp, or its log time where that is unset."""
        return np.array([self._stamp(index) for index in range(len(self))], np.int64)

    def quick_stamps(self) -> Ints:
        """Log time of each message (N,) int64 ns."""
        log_times = np.zeros(len(self), np.int64)
        for k, topic in enumerate(self.topics):
            here = self.files == k
            log_times[here] = topic.log_times[self.messages[here]]
        return log_times

    def _stamp(self, index: int) -> int:
        try:
            stamp = read_stamp(self.message_encoding, self.schema, self.data(index, STAMP_BYTES))
            if stamp is None:
                stamp = stamp_of_whole(self.message_encoding, self.schema, self.data(index))
        except (ValueError, struct.error):
            stamp = 0
        return stamp or int(self.topics[self.files[index]].log_times[self.messages[index]])


@dataclass(frozen=True, eq=False)
class McapImages:
    """Images of a topic, each by itself in one message."""

    messages: McapMessages
    encoding: str

    def __len__(self) -> int:
        return len(self.messages)

    def stamps(self) -> Ints:
        """As ImageSource has it."""
        return self.messages.stamps()

    def quick_stamps(self) -> Ints:
        """As ImageSource has it."""
        return self.messages.quick_stamps()

    def part(self, indices: Ints) -> "McapImages":
        """As ImageSource has it."""
        return McapImages(self.messages.part(indices), self.encoding)

    def images(self, gray: bool = True, shrink: int = 1) -> Iterator[Picture | None]:
        """As ImageSource has it."""
        for index in range(len(self)):
            try:
                yield decode_image(self.messages.payload(index), gray, shrink)
            except (ValueError, AttributeError, struct.error):
                yield None

    def batches(self, indices: Ints, size: int) -> list[Ints]:
        """As ImageSource has it."""
        return even_batches(indices, size)


@dataclass(frozen=True, eq=False)
class Stamped:
    """A source with other time stamps (N,) int64 ns."""

    source: ImageSource
    given: Ints

    def __len__(self) -> int:
        return len(self.source)

    @property
    def encoding(self) -> str:
        """As ImageSource has it."""
        return self.source.encoding

    def stamps(self) -> Ints:
        """As ImageSource has it."""
        return self.given

    def quick_stamps(self) -> Ints:
        """As ImageSource has it."""
        return self.given

    def part(self, indices: Ints) -> "Stamped":
        """As ImageSource has it."""
        return Stamped(self.source.part(indices), self.given[indices])

    def images(self, gray: bool = True, shrink: int = 1) -> Iterator[Picture | None]:
        """As ImageSource has it."""
        return self.source.images(gray, shrink)

    def batches(self, indices: Ints, size: int) -> list[Ints]:
        """As ImageSource has it."""
        return self.source.batches(indices, size)


# The process is part of the key: a forked child shares the parent's place in an open file, and would lose it.
@lru_cache(maxsize=16)
def _open_mcap(path: Path, process: int) -> McapBytes:
    return McapBytes(path)
