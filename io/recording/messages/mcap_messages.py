"""The messages of one topic: where they are, small to send to another process; and reading them from open files."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from quadrig.io.recording.messages.image_message import (
    STAMP_BYTES,
    EncodedImage,
    read_image,
    read_stamp,
    stamp_of_whole,
)
from quadrig.io.recording.messages.mcap_reader import McapBytes, TopicMessages
from quadrig.io.recording.messages.ros_bag import BagBytes, is_bag
from quadrig.single.arrays import Ints

# ns; what a signed integer of 64 bits holds: a later time is damaged.
_LATEST = 2**63 - 1


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
    def paths(self) -> tuple[Path, ...]:
        """The files."""
        return tuple(dict.fromkeys(topic.path for topic in self.topics))

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

    def opened(self) -> "OpenMessages":
        """The messages for reading, to be used in a `with` statement."""
        return OpenMessages(self)

    def stamps(self) -> Ints:
        """Time of each message (N,) int64 ns: its own stamp, or its log time where that is unset."""
        with self.opened() as opened:
            return np.array([opened.stamp(index) for index in range(len(self))], np.int64)

    def quick_stamps(self) -> Ints:
        """Log time of each message (N,) int64 ns."""
        log_times = np.zeros(len(self), np.int64)
        for k, topic in enumerate(self.topics):
            here = self.files == k
            log_times[here] = topic.log_times[self.messages[here]]
        return log_times


class OpenMessages:
    """Reads messages; their files are opened when they are first needed, and closed at the end of `with`."""

    def __init__(self, messages: McapMessages) -> None:
        self._messages = messages
        self._files: dict[Path, McapBytes | BagBytes] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        while self._files:
            self._files.popitem()[1].close()

    def data(self, index: int, limit: int | None = None) -> bytes:
        """The bytes of a message, or its first `limit`. Raises ValueError where the file is damaged there."""
        topic, message = self._place(index)
        if topic.path not in self._files:
            self._files[topic.path] = (BagBytes if is_bag(topic.path) else McapBytes)(topic.path)
        return self._files[topic.path].message(int(topic.chunks[message]), int(topic.offsets[message]), limit)

    def image(self, index: int) -> EncodedImage:
        """The image of a message. Raises ValueError where the bytes are not such a message."""
        return read_image(self._messages.message_encoding, self._messages.schema, self.data(index))

    def stamp(self, index: int) -> int:
        """Time (ns) of a message: its own stamp, or its log time where that is unset."""
        encoding, schema = self._messages.message_encoding, self._messages.schema
        try:
            stamp = read_stamp(encoding, self.data(index, STAMP_BYTES))
            if stamp is None:
                stamp = stamp_of_whole(encoding, schema, self.data(index))
        except ValueError:
            stamp = 0
        if not 0 < stamp <= _LATEST:
            stamp = 0
        topic, message = self._place(index)
        return stamp or int(topic.log_times[message])

    def _place(self, index: int) -> tuple[TopicMessages, int]:
        return self._messages.topics[self._messages.files[index]], int(self._messages.messages[index])
