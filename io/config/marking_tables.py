"""Markings in rig.toml: the keys of a kind are the fields of its dataclass, whatever kinds there are."""

import math
from collections.abc import Sequence
from dataclasses import MISSING, fields
from functools import cache
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import msgspec

from quadrig.rig.problem.camera_input import check_line_time
from quadrig.rig.words import read_coordinate, read_time
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.registry import marking_kinds
from quadrig.single.rectangle import Marking, Metres

# A square needs ten pixels, so that a picture of a hundred megapixels shows no more of them.
_MOST_SQUARES = 10**6
# Metres: farther than any camera sees a sheet.
_LONGEST = 1e6


def marking_table(kinds: Sequence[type[Marking]]) -> Any:
    """The type of a marking's table in rig.toml: one of those of these kinds."""
    return Union[tuple(_table(kind) for kind in kinds)]  # noqa: UP007 - known only as the program runs


class Length(float):
    """Metres in rig.toml: a bare number, or a text with a unit such as "80mm"."""


class LineTime(float):
    """Seconds a row in rig.toml: a bare number, or a text with a unit such as "20us"."""


def read_quantities(wanted: type, value: Any) -> Any:
    """The dec_hook of msgspec that reads a Length or a LineTime. Raises ValueError where it is none."""
    if wanted is LineTime:
        return _line_time(value)
    if wanted is not Length:
        raise NotImplementedError
    if isinstance(value, str):
        try:
            return Length(read_coordinate(value, bare_below=0.0))
        except QuadrigError as error:
            raise ValueError(str(error)) from error
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError('expected a length: metres, or a text with a unit such as "80mm"')
    if math.isfinite(value) and abs(value) > _LONGEST:
        raise ValueError(f"{value} m is no length of this world; give metres")
    return Length(value)


def _line_time(value: Any) -> LineTime:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise ValueError('expected a time: seconds a row, or a text with a unit such as "20us"')
    try:
        seconds = read_time(value) if isinstance(value, str) else float(value)
        check_line_time(seconds)
    except QuadrigError as error:
        raise ValueError(str(error)) from error
    return LineTime(seconds)


def _written(hint: Any) -> Any:
    """The type of a marking's field in rig.toml."""
    if hint == Metres:
        return Length
    members = get_args(hint)
    if Metres in members:
        return Union[tuple(Length if one == Metres else one for one in members)]  # noqa: UP007 - as marking_table
    return members[0] if get_origin(hint) is Annotated else hint


@cache
def _table(kind: type[Marking]) -> type[msgspec.Struct]:
    types = {name: _written(hint) for name, hint in get_type_hints(kind, include_extras=True).items()}
    keys: list[str | tuple[str, Any] | tuple[str, Any, Any]] = []
    for key in fields(kind):
        if key.default is not MISSING:
            keys.append((key.name, types[key.name], key.default))
        elif key.default_factory is not MISSING:
            keys.append((key.name, types[key.name], msgspec.field(default_factory=key.default_factory)))
        else:
            keys.append((key.name, types[key.name]))
    return msgspec.defstruct(kind.__name__, keys, tag=kind.kind, tag_field="kind", forbid_unknown_fields=True)


def marking_of(table: msgspec.Struct) -> Marking:
    """The marking of a table. Raises QuadrigError where there can be no such marking."""
    values = msgspec.to_builtins(table, enc_hook=float)
    if values.get("columns", 0) * values.get("rows", 0) > _MOST_SQUARES:
        raise QuadrigError(f"{values['columns']} x {values['rows']} squares fit on no sheet; give their true number")
    return marking_kinds()[values.pop("kind")](**values)


def marking_keys(marking: Marking) -> dict[str, object]:
    """What rig.toml says of a marking: its kind, and what is not as usual."""
    keys: dict[str, object] = {"kind": marking.kind}
    for key in fields(marking):
        value = getattr(marking, key.name)
        if key.default is MISSING or value != key.default:
            keys[key.name] = value
    return keys
