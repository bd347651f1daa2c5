"""An MCAP written by topic: channels and schemas are registered when the first message of their topic comes."""

from typing import Any, BinaryIO, Literal

_ANY_JSON = b'{"type": "object"}'


class TopicWriter:
    """Writes messages, each with one time stamp (ns), to a stream; `finish` writes the index."""

    def __init__(
        self,
        stream: BinaryIO,
        compression: Literal["none", "lz4", "zstd"] = "none",
        profile: str = "",
    ) -> None:
        from mcap.writer import CompressionType, Writer

        self._writer = Writer(stream, compression=CompressionType[compression.upper()])
        self._writer.start(profile=profile, library="quadrig")
        self._channels: dict[str, int] = {}

    def write_protobuf(self, topic: str, message: Any, stamp: int) -> None:
        """Write a protobuf message of a topic, whose messages are all of one class."""
        if topic not in self._channels:
            from mcap_protobuf.schema import register_schema

            schema = register_schema(self._writer, type(message))
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema)
        self._writer.add_message(self._channels[topic], stamp, message.SerializeToString(), stamp)

    def declare_json(self, topic: str, kind: str, schema: bytes = _ANY_JSON) -> None:
        """Declare what the JSON of a topic is: the name of its schema, and the schema."""
        schema_id = self._writer.register_schema(kind, "jsonschema", schema)
        self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)

    def write_json(self, topic: str, data: bytes, stamp: int, number: int = 0) -> None:
        """Write the JSON of a topic that was declared; number: of the message, where it counts."""
        self._writer.add_message(self._channels[topic], stamp, data, stamp, number)

    def attach(self, name: str, kind: str, data: bytes, stamp: int) -> None:
        """Attach a file of this media type."""
        self._writer.add_attachment(0, stamp, name, kind, data)

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Add words by name."""
        self._writer.add_metadata(name, values)

    def flush(self) -> None:
        """Hand what was written to the operating system, so that it stays when this process is killed."""
        self._writer.flush()

    def finish(self) -> None:
        """Write what is left, and the index."""
        self._writer.finish()
