"""ROS 1 bags (.bag) and ROS 2 bags in SQLite (.db3, alone or in their folder), through rosbags.

Their topics look like those of an MCAP file: a message's place is its time and, as offset, its connection and how
many of that connection came before it at the same time. Messages of ROS 1 are turned into CDR, so that they are read
by the same code.
"""

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from quadrig.io.recording.limits import most_bytes, too_many_bytes
from quadrig.io.recording.messages.mcap_reader import McapIndex, TopicMessages, from_zstd
from quadrig.single.errors import QuadrigError

_NTH_BITS = 32


def is_bag(path: Path) -> bool:
    """Whether a path is such a bag: a file, or a folder with metadata.yaml whose messages are in SQLite."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() and any(path.glob("*.db3*"))
    return path.suffix.lower() in (".bag", ".db3")


def index_bag(path: Path) -> McapIndex:
    """Find every message of the bag. Raises QuadrigError where it cannot be read, or rosbags is not installed."""
    _import_rosbags()
    places: dict[tuple[str, str], list[tuple[int, int]]] = {}
    try:
        with _reader(path) as reader:
            _left_folded(reader)
            for connection in reader.connections:
                times = np.array(_times(reader, connection), np.int64)
                first = np.searchsorted(times, times)
                nth = np.arange(len(times)) - first
                offsets = (connection.id << _NTH_BITS) | nth
                place = places.setdefault((connection.topic, connection.msgtype), [])
                place += zip(times.tolist(), offsets.tolist(), strict=True)
    except Exception as error:
        # rosbags, and the SQLite and YAML below it, answer damage with errors of their own.
        raise QuadrigError(
            f"{path}: cannot be read as a bag ({error or type(error).__name__}); was its recording closed? "
            "`rosbag reindex` or `ros2 bag reindex` mends what was not"
        ) from error
    topics = []
    for (topic, schema), place in sorted(places.items()):
        times, offsets = np.array(sorted(place), np.int64).reshape(-1, 2).T
        topics.append(TopicMessages(path, topic, "cdr", schema, times.copy(), times.copy(), offsets.copy()))
    return McapIndex(path, tuple(topics), indexed=True)


class BagBytes:
    """The bytes of messages of one bag, as McapBytes gives them; keeps the bag open."""

    def __init__(self, path: Path) -> None:
        _import_rosbags()
        from rosbags.typesys import Stores, get_typestore

        self._reader = _reader(path)
        self._reader.open()
        if path.suffix.lower() == ".bag":
            _limit_chunks(self._reader)
        self._folded = _left_folded(self._reader)
        self._connections = {connection.id: connection for connection in self._reader.connections}
        # Of ROS 2: what is turned into CDR is its layout, in which a header has no number.
        self._types = get_typestore(Stores.ROS2_HUMBLE) if path.suffix.lower() == ".bag" else None
        # By connection: what comes next, and the place that it is expected at.
        self._running: dict[int, Iterator[Any]] = {}
        self._last: dict[int, tuple[int, int]] = {}

    def close(self) -> None:
        """Let go of the bag."""
        self._reader.close()

    def message(self, time: int, offset: int, limit: int | None = None) -> bytes:
        """The CDR bytes of the message at this place, or their first `limit`.

        Raises ValueError where the bag is damaged there.
        """
        number, nth = offset >> _NTH_BITS, offset & (2**_NTH_BITS - 1)
        connection = self._connections[number]
        try:
            while True:
                if number not in self._running or self._last.get(number, (time, -1)) >= (time, nth):
                    self._running[number] = self._reader.messages([connection], start=time)
                    self._last[number] = (time, -1)
                _, found, raw = next(self._running[number])
                last, count = self._last[number]
                self._last[number] = (found, count + 1 if found == last else 0)
                if self._last[number] == (time, nth):
                    break
                if self._last[number] > (time, nth):
                    raise ValueError("the message is not where it was")
            if self._folded:
                raw = _unfolded(raw, limit)
            data = raw if self._types is None else self._types.ros1_to_cdr(raw, connection.msgtype)
        except Exception as error:
            self._running.pop(number, None)
            raise ValueError(f"the bag is damaged there ({error or type(error).__name__})") from error
        return bytes(data[:limit])


def _import_rosbags() -> ModuleType:
    try:
        import rosbags
    except ImportError as error:
        raise QuadrigError("bags of ROS need rosbags; install it with: pip install 'quadrig[bags]'") from error
    return rosbags


def _reader(path: Path) -> Any:
    if path.suffix.lower() == ".bag":
        from rosbags.rosbag1 import Reader as Ros1Reader

        return Ros1Reader(path)
    from rosbags.rosbag2 import Reader as Ros2Reader

    return Ros2Reader(path)


def _limit_chunks(reader: Any) -> None:
    """Chunks unfold to what is allowed and no further: rosbags unfolds whatever there is."""
    import bz2

    import lz4.frame
    from rosbags.rosbag1.reader import decompressors

    limited = {
        decompressors["bz2"]: lambda data: bz2.BZ2Decompressor().decompress(data, most_bytes()),
        decompressors["lz4"]: lambda data: lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most_bytes()),
    }
    for place, chunk in reader.chunks.items():
        reader.chunks[place] = chunk._replace(decompressor=limited.get(chunk.decompressor, chunk.decompressor))


def _left_folded(reader: Any) -> bool:
    """Whether messages are compressed one by one; this reader then gives them so, for rosbags unfolds whatever there
    is."""
    directory = getattr(reader, "storage", None)
    if getattr(reader, "compression_mode", None) != "message" or directory is None:
        return False
    directory.metadata = directory.metadata._replace(compression_mode=None)
    return True


def _unfolded(raw: bytes, limit: int | None) -> bytes:
    """A compressed message, or its first `limit` bytes. Raises ValueError where it is larger than is read."""
    data = from_zstd(raw, most_bytes() + 1 if limit is None else min(limit, most_bytes()))
    if limit is None and (refused := too_many_bytes(len(data))):
        raise ValueError(f"a message unfolds to more than is read: {refused}")
    return data


def _times(reader: Any, connection: Any) -> list[int]:
    """Time of each message (ns), rising."""
    indexes = getattr(reader, "indexes", None)
    if indexes is not None:
        return [entry.time for entry in indexes[connection.id]]
    return sorted(time for _, time, _ in reader.messages([connection]))
