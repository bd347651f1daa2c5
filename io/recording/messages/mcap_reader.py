"""MCAP files in any state: where each message lies, and its bytes.

The mcap package reads whole files; recordings that people have were also cut off by a full disk or a pulled plug,
written without an index, or damaged in one chunk. Here the index is used where there is one; else the records are
walked, without reading the messages themselves. What is whole is used, and `note` says what was not.
Record layouts: the MCAP specification, version 0.
"""

import struct
import zlib
from array import array
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Schema, Statistics

from quadrig.io.recording.limits import most_bytes, too_many_bytes
from quadrig.single.arrays import Ints
from quadrig.single.errors import QuadrigError

MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEADER = struct.Struct("<BQ")
_MESSAGE_HEADER = struct.Struct("<HIQQ")
_CHUNK_HEADER = struct.Struct("<QQQII")
_CHUNK_INDEX = struct.Struct("<QQQQI")
_INDEX_ENTRY_BYTES = 16
_MESSAGE_START = _RECORD_HEADER.size + _MESSAGE_HEADER.size
_FOOTER_BYTES = _RECORD_HEADER.size + 20
# Decompressed chunks kept at hand: messages of interleaved topics are read nearly in file order, so two suffice.
_KEPT_CHUNKS = 2
_TOP_LEVEL = -1
_NO_RECORD = 0
# Longer than any topic, schema or name of a compression: what claims more is damaged.
_LONGEST_DEFINITION = 1 << 24
_LONGEST_NAME = 64
# Of compressed data that breaks off, all but the last piece can be had: small against a picture.
_PIECE = 1 << 16
_UNSIGNED = 2**64 - 1
_MOST_REMARKS = 3
# What damaged bytes make of the parsers here and in the mcap package.
_DAMAGE = (McapError, struct.error, EOFError, IndexError, ValueError, OverflowError, OSError)


@dataclass(frozen=True, eq=False)
class TopicMessages:
    """One topic of one file: what its messages are, and where.

    log_times (N,) ns; chunks (N,): file offset of the chunk that holds each message, -1 outside chunks; offsets (N,):
    of the message record, in the chunk's uncompressed bytes or in the file. Sorted by log time.
    """

    path: Path
    topic: str
    encoding: str
    schema: str
    log_times: Ints
    chunks: Ints
    offsets: Ints

    def __len__(self) -> int:
        return len(self.log_times)

    def part(self, indices: Ints) -> "TopicMessages":
        """The messages of these indices alone: little to send to another process."""
        log_times, chunks, offsets = self.log_times[indices], self.chunks[indices], self.offsets[indices]
        return TopicMessages(self.path, self.topic, self.encoding, self.schema, log_times, chunks, offsets)


@dataclass(frozen=True, eq=False)
class McapIndex:
    """What is in an MCAP file. note: what could not be used of it, in words, or ""."""

    path: Path
    topics: tuple[TopicMessages, ...]
    indexed: bool
    note: str = ""


def is_mcap(path: Path) -> bool:
    """Whether the file begins as MCAP files do."""
    with path.open("rb") as stream:
        return stream.read(len(MAGIC)) == MAGIC


def index_mcap(path: Path) -> McapIndex:
    """Find every message of the file. Raises QuadrigError where it is not an MCAP file."""
    with path.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(0)
        if stream.read(len(MAGIC)) != MAGIC:
            what = "is empty" if size == 0 else "is not an MCAP file"
            raise QuadrigError(f"{path}: {what}; give an MCAP recording, videos or folders of images")
        scan = _Scan(path, stream, size)
        indexed = scan.use_summary()
        if not indexed:
            scan.walk()
        return McapIndex(path, scan.topics(), indexed, scan.note())


class McapBytes:
    """The bytes of messages of one file; keeps the file open, so one for each process.

    A compressed chunk whose sum does not agree counts as damaged.
    """

    def __init__(self, path: Path) -> None:
        self._stream = path.open("rb")
        self._size = path.stat().st_size
        self._chunks: OrderedDict[int, tuple[int, bytes | None]] = OrderedDict()

    def close(self) -> None:
        """Let go of the file."""
        self._stream.close()

    def message(self, chunk: int, offset: int, limit: int | None = None) -> bytes:
        """The data of the message at this place, or no more than its first `limit` bytes.

        Raises ValueError where the file is damaged there.
        """
        if chunk != _TOP_LEVEL:
            start, data = self._chunk(chunk)
            if data is not None:
                begin = offset + _MESSAGE_START
                return data[begin : begin + _message_length(data[offset:begin], len(data) - begin, limit)]
            offset += start
        if not 0 <= offset < self._size:
            raise ValueError("the index leads out of the file")
        self._stream.seek(offset)
        header = self._stream.read(_MESSAGE_START)
        return self._stream.read(_message_length(header, self._size - offset - _MESSAGE_START, limit))

    def _chunk(self, chunk: int) -> tuple[int, bytes | None]:
        """File offset of the chunk's records, and their bytes where they are compressed."""
        if chunk in self._chunks:
            self._chunks.move_to_end(chunk)
            return self._chunks[chunk]
        start, data = self._read_chunk(chunk)
        self._chunks[chunk] = (start, data)
        compressed = [key for key, (_, kept) in self._chunks.items() if kept is not None]
        for old in compressed[:-_KEPT_CHUNKS]:
            del self._chunks[old]
        return start, data

    def _read_chunk(self, chunk: int) -> tuple[int, bytes | None]:
        if not 0 <= chunk < self._size:
            raise ValueError("the index leads out of the file")
        self._stream.seek(chunk)
        try:
            header = _read_chunk_header(self._stream)
        except _DAMAGE:
            return 0, b""
        if not header.compression:
            return header.start, None
        # Two of the largest would be too much at once.
        if header.size > most_bytes() // _KEPT_CHUNKS:
            self._chunks.clear()
        try:
            data = _decompress(self._stream.read(min(header.stored, self._size)), header)
        except _RefusedError:
            raise
        except Exception:
            return header.start, b""
        # One that claims to be smaller than it is has the sum of all of it.
        damaged = header.crc != 0 and len(data) == header.size and zlib.crc32(data) != header.crc
        return header.start, b"" if damaged else data[: header.size]


class _Scan:
    """Collects channels and message places of one file."""

    def __init__(self, path: Path, stream: BinaryIO, size: int) -> None:
        self.path, self.stream, self.size = path, stream, size
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        # By channel: a chunk's file offset, and its index entries (log time, offset; <u8 each) for that channel.
        self.entries: dict[int, list[tuple[int, bytes]]] = {}
        # By channel: log time, chunk and offset of each message that no index has, one after the other.
        self.loose: dict[int, array[int]] = {}
        # By a chunk's file offset: its bytes when unfolded, as the summary has them, or those up to its last message.
        self.listed: dict[int, int] = {}
        self.remarks: list[str] = []

    def use_summary(self) -> bool:
        """Take everything from the summary; False where it is missing, broken or has no message index."""
        try:
            records = list(self._summary_records())
            chunks = [_read_chunk_index(data) for op, data in records if op == Opcode.CHUNK_INDEX]
            counts = [Statistics.read(_stream(data)) for op, data in records if op == Opcode.STATISTICS]
            for op, data in records:
                self._definition(op, data)
            self.listed = {start: size for start, _, _, size in chunks}
            for start, behind, length, _ in chunks:
                if not start < behind <= behind + length <= self.size:
                    raise ValueError("the index leads out of the file")
                self.stream.seek(behind)
                for op, data in _records(self.stream.read(length)):
                    if op == Opcode.MESSAGE_INDEX:
                        self._message_index(data, start)
        except _DAMAGE:
            self.entries.clear()
            return False
        found = sum(len(data) for parts in self.entries.values() for _, data in parts) // _INDEX_ENTRY_BYTES
        # Without chunks there is no index of messages; without statistics nobody knows that the index is whole.
        whole = bool(chunks and counts) and counts[0].message_count == found
        if not whole or not set(self.entries) <= set(self.channels):
            self.entries.clear()
            return False
        for start, *_ in chunks:
            self._judge_size(start)
        return True

    def walk(self) -> None:
        """Walk the records of the data section up to its end or to where the file was cut off."""
        position = len(MAGIC)
        while True:
            self.stream.seek(position)
            header = self.stream.read(_RECORD_HEADER.size)
            if len(header) < _RECORD_HEADER.size:
                self._cut_off(position)
                return
            op, length = _RECORD_HEADER.unpack(header)
            end = position + _RECORD_HEADER.size + length
            if op == Opcode.CHUNK:
                end = self._walk_chunk(position, min(end, self.size))
                if position + _RECORD_HEADER.size + length > self.size:
                    self._cut_off(position)
                    return
            elif end > self.size:
                self._cut_off(position)
                return
            elif op == Opcode.DATA_END:
                return
            elif op == _NO_RECORD:
                self._say(f"the file is damaged at byte {position}, and what follows is skipped")
                return
            elif op == Opcode.MESSAGE and length >= _MESSAGE_HEADER.size:
                self._message(self.stream.read(_MESSAGE_HEADER.size), _TOP_LEVEL, position)
            elif op in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._definition(op, self.stream.read(min(length, _LONGEST_DEFINITION)))
            position = end

    def topics(self) -> tuple[TopicMessages, ...]:
        """The topics found, those of several writers joined, in the order of their names."""
        parts: dict[tuple[str, str, str], list[Ints]] = {}
        for channel in self.channels.values():
            schema = self.schemas.get(channel.schema_id)
            key = (channel.topic, channel.message_encoding, schema.name if schema else "")
            parts.setdefault(key, []).append(_places(self.entries.get(channel.id, [])))
            parts[key].append(np.array(self.loose.get(channel.id, ()), np.uint64).astype(np.int64).reshape(-1, 3))
        topics = []
        for (topic, encoding, schema), arrays in sorted(parts.items()):
            places = np.concatenate(arrays)
            places = places[np.argsort(places[:, 0], kind="stable")]
            topics.append(TopicMessages(self.path, topic, encoding, schema, *places.T.copy()))
        return tuple(topics)

    def _summary_records(self) -> Iterator[tuple[int, bytes]]:
        end = self.size - len(MAGIC) - _FOOTER_BYTES
        self.stream.seek(max(end, 0))
        tail = self.stream.read()
        if end < 0 or tail[_FOOTER_BYTES:] != MAGIC or tail[0] != Opcode.FOOTER:
            raise EOFError
        footer = Footer.read(_stream(tail[_RECORD_HEADER.size :]))
        if not 0 < footer.summary_start < end:
            raise EOFError
        self.stream.seek(footer.summary_start)
        yield from _records(self.stream.read(end - footer.summary_start))

    def _definition(self, op: int, data: bytes) -> None:
        """Take in a schema or channel; one that is damaged is as good as none."""
        try:
            if op == Opcode.SCHEMA:
                schema = Schema.read(_stream(data))
                self.schemas[schema.id] = schema
            elif op == Opcode.CHANNEL:
                channel = Channel.read(_stream(data))
                self.channels[channel.id] = channel
        except _DAMAGE:
            self._say("a topic's description is damaged, and its messages are left out")

    def _message_index(self, data: bytes, chunk: int) -> int:
        """Take in one MessageIndex record of a chunk; the channel's id."""
        channel, length = struct.unpack_from("<HI", data)
        entries = data[6 : 6 + length]
        if len(entries) % _INDEX_ENTRY_BYTES:
            raise ValueError("an index breaks off")
        if entries:
            self.entries.setdefault(channel, []).append((chunk, entries))
        return channel

    def _message(self, header: bytes, chunk: int, offset: int) -> None:
        channel, _, log_time, _ = _MESSAGE_HEADER.unpack(header)
        self.loose.setdefault(channel, array("Q")).extend((log_time, chunk & _UNSIGNED, offset))

    def _walk_chunk(self, position: int, end: int) -> int:
        """Take in the messages of a chunk, from the index behind it where there is one; where to go on."""
        self.stream.seek(position)
        try:
            header = _read_chunk_header(self.stream)
        except _DAMAGE:
            self._say(f"the chunk at byte {position} is damaged and skipped")
            return end
        next_record, channels = self._message_indexes_behind(end, position)
        if channels and channels <= set(self.channels):
            last = max(int(_places(self.entries[one][-1:])[:, 2].max()) for one in channels if one in self.entries)
            self.listed.setdefault(position, last + _MESSAGE_START)
            self._judge_size(position)
            return next_record
        self.stream.seek(header.start)
        try:
            data = _decompress(self.stream.read(max(0, min(header.stored, end - header.start))), header)
        except _RefusedError as error:
            self._say(f"the chunk at byte {position} is left out: {error}")
            return next_record
        except Exception:
            self._say(f"the chunk at byte {position} is damaged and skipped")
            return next_record
        # A chunk at the end of a cut file is reported as the cut; of others the two lengths must agree.
        if end < self.size and (len(data) < header.size or header.start + header.stored != end):
            self._say(f"the chunk at byte {position} is damaged and used as far as it goes")
        elif len(data) > header.size:
            self._say_larger(position)
        for offset, op, begin, stop in _record_places(data):
            if op == Opcode.MESSAGE and not channels and stop - begin >= _MESSAGE_HEADER.size:
                self._message(data[begin : begin + _MESSAGE_HEADER.size], position, offset)
            elif op in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._definition(op, data[begin:stop])
        return next_record

    def _judge_size(self, position: int) -> None:
        """Say where messages of an indexed chunk will be left out since it claims another size than it has."""
        self.stream.seek(position)
        try:
            header = _read_chunk_header(self.stream)
        except _DAMAGE:
            self._say(f"the chunk at byte {position} is damaged and skipped")
            return
        # What is not compressed is read in its place.
        if not header.compression:
            return
        if refused := too_many_bytes(header.size):
            self._say(f"the chunk at byte {position} is left out: it unfolds to more than is read: {refused}")
        elif header.size < self.listed.get(position, 0):
            self._say_larger(position)

    def _say_larger(self, position: int) -> None:
        self._say(f"the chunk at byte {position} claims to be smaller than it is, and is used as far as it claims")

    def _message_indexes_behind(self, end: int, chunk: int) -> tuple[int, set[int]]:
        channels: set[int] = set()
        while True:
            self.stream.seek(end)
            header = self.stream.read(_RECORD_HEADER.size)
            if len(header) < _RECORD_HEADER.size or header[0] != Opcode.MESSAGE_INDEX:
                return end, channels
            length = _RECORD_HEADER.unpack(header)[1]
            try:
                if end + _RECORD_HEADER.size + length > self.size:
                    raise EOFError
                channels.add(self._message_index(self.stream.read(length), chunk))
            except _DAMAGE:
                # The rest of the index is lost, but the chunk is whole: its own records say what is in it.
                for parts in self.entries.values():
                    parts[:] = [part for part in parts if part[0] != chunk]
                return end, set()
            end += _RECORD_HEADER.size + length

    def _cut_off(self, position: int) -> None:
        self._say(f"the file was cut off at byte {self.size} (the last whole record ends at byte {position})")

    def _say(self, sentence: str) -> None:
        self.remarks.append(sentence)

    def note(self) -> str:
        """What was damaged: the first of it in words, for there may be thousands."""
        more = len(self.remarks) - _MOST_REMARKS
        return "; ".join([*self.remarks[:_MOST_REMARKS], *([f"and {more} more such places"] if more > 0 else [])])


def _message_length(header: bytes, left: int, limit: int | None) -> int:
    """How many bytes to read of the data of the message with this header, behind which so many are left."""
    if len(header) < _MESSAGE_START or header[0] != Opcode.MESSAGE:
        raise ValueError("no message where the index has one")
    length = _RECORD_HEADER.unpack_from(header)[1] - _MESSAGE_HEADER.size
    wanted = length if limit is None else min(limit, length)
    if not 0 <= wanted <= left:
        raise ValueError("the message breaks off")
    return wanted


def _read_chunk_index(data: bytes) -> tuple[int, int, int, int]:
    """Where the chunk begins, where the message indexes behind it begin, their length, and the chunk's unfolded."""
    _, _, start, length, offsets = _CHUNK_INDEX.unpack_from(data)
    (index_length,) = struct.unpack_from("<Q", data, _CHUNK_INDEX.size + offsets)
    return start, start + length, index_length, struct.unpack_from("<Q", data, len(data) - 8)[0]


def _places(entries: list[tuple[int, bytes]]) -> Ints:
    """Log time, chunk and offset (N, 3) int64 of the messages of these index entries."""
    flat = np.frombuffer(b"".join(data for _, data in entries), "<u8").reshape(-1, 2).astype(np.int64)
    counts = [len(data) // _INDEX_ENTRY_BYTES for _, data in entries]
    chunks = np.repeat(np.array([chunk for chunk, _ in entries], np.int64), counts)
    return np.column_stack([flat[:, 0], chunks, flat[:, 1]])


def _stream(data: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(data))


class _RefusedError(ValueError):
    """A chunk that is not decompressed; the message says why."""


@dataclass(frozen=True)
class _ChunkHeader:
    """start: file offset of the chunk's data; stored: its bytes there; size: uncompressed; crc: of those."""

    start: int
    stored: int
    size: int
    crc: int
    compression: str


def _read_chunk_header(stream: BinaryIO) -> _ChunkHeader:
    """From the start of a Chunk record."""
    stream.seek(_RECORD_HEADER.size, 1)
    _, _, uncompressed, crc, name_length = _CHUNK_HEADER.unpack(stream.read(_CHUNK_HEADER.size))
    if name_length > _LONGEST_NAME:
        raise ValueError("the name of the compression is damaged")
    compression = stream.read(name_length).decode()
    (stored,) = struct.unpack("<Q", stream.read(8))
    return _ChunkHeader(stream.tell(), stored, uncompressed, crc, compression)


def _decompress(data: bytes, header: _ChunkHeader) -> bytes:
    """The chunk's records, a byte more than it claims where it has more; of data that breaks off what can be had.

    Raises _RefusedError where it claims too much, or is compressed in another way.
    """
    if not header.compression:
        return data
    if refused := too_many_bytes(header.size):
        raise _RefusedError(f"it unfolds to more than is read: {refused}")
    if header.compression == "zstd":
        return from_zstd(data, header.size + 1)
    if header.compression == "lz4":
        import lz4.frame

        return lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=header.size + 1)
    raise _RefusedError(f"it is compressed with {header.compression!r}; convert the recording to lz4 or zstd")


def from_zstd(data: bytes, size: int) -> bytes:
    """The first `size` bytes of what these unfold to; of damaged data as much as can be had."""
    import zstandard

    parts: list[bytes] = []
    left = size
    with zstandard.ZstdDecompressor().stream_reader(BytesIO(data)) as reader:
        while left > 0:
            try:
                part = reader.read(min(left, _PIECE))
            except zstandard.ZstdError:
                break
            if not part:
                break
            parts.append(part)
            left -= len(part)
    return b"".join(parts)


def _record_places(data: bytes) -> Iterator[tuple[int, int, int, int]]:
    """Offset, opcode, begin and end of the content of each whole record in these bytes."""
    offset = 0
    while offset + _RECORD_HEADER.size <= len(data):
        op, length = _RECORD_HEADER.unpack_from(data, offset)
        begin = offset + _RECORD_HEADER.size
        # Zeros are no records: walked through one by one, those of a bomb would take minutes.
        if op == _NO_RECORD or begin + length > len(data):
            return
        yield offset, op, begin, begin + length
        offset = begin + length


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    for _, op, begin, end in _record_places(data):
        yield op, data[begin:end]
