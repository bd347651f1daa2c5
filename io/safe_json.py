"""JSON out of files: no deeper and of no more values than memory has room for."""

from typing import Any, TypeVar

import msgspec

Held = TypeVar("Held")

# The covariance of 256 cameras has 15 million numbers, of 32 bytes each in memory.
_MOST_VALUES = 1 << 24
# By what it costs beside a number: an empty list of three letters 64 bytes, an object of eight 300.
_LIST, _OBJECT = 2, 8


def read_json(data: bytes, type: type[Held] | Any = Any) -> Held:  # noqa: A002 - as msgspec calls it
    """The values of a JSON document, of this type. Raises ValueError, of which msgspec's errors are."""
    values = data.count(b",") + _LIST * data.count(b"[") + _OBJECT * data.count(b"{")
    if values > _MOST_VALUES:
        raise ValueError(f"JSON of {values} values is more than is read")
    try:
        return msgspec.json.decode(data, type=type)
    except RecursionError as error:
        raise ValueError("JSON is nested too deep") from error
