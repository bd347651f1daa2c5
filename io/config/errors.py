"""TOML as tables of a type; what is wrong with it is one sentence with file, line, key and what is allowed."""

import re
import types
import typing
from collections.abc import Callable
from typing import Any, TypeVar

import msgspec

from quadrig.io.config.toml_lines import line_of
from quadrig.single.errors import QuadrigError

_KINDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "a text in quotes",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
    "null": "nothing",
}


# Keys in keys: Python's reader takes gigabytes for some ten thousand, and the deepest table here is the third.
_DEEP_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')\s*+\.\s*+){64}""")

_Tables = TypeVar("_Tables")


def decoded(text: str, root: type[_Tables], name: str, dec_hook: Callable[[type, Any], Any] | None = None) -> _Tables:
    """The tables of a text, by msgspec. name: what errors call it. Raises QuadrigError, one sentence."""
    try:
        if _DEEP_KEY.search(text):
            raise RecursionError
        return msgspec.toml.decode(text, type=root, dec_hook=dec_hook)
    except msgspec.DecodeError as error:
        raise _decode_error(error, text, name, root) from error
    except RecursionError as error:
        raise QuadrigError(f"{name}: lists, tables or keys are nested too deep; it needs three levels") from error
    except ValueError as error:
        # What Python itself will not read as a number; of its limit of digits it speaks to those who write Python.
        what = "a number has thousands of digits" if "digits" in str(error) else str(error)
        raise QuadrigError(f"{name}: this is not TOML: {what}") from error


def locate(name: str, text: str, path: str, key: str = "") -> str:
    """ "rig.toml, line 7" for a value of the text, or the file's name alone where the line is unknown."""
    line = line_of(text, path, key)
    return name if line is None else f"{name}, line {line}"


def _decode_error(error: msgspec.DecodeError, text: str, name: str, root: type) -> QuadrigError:
    """The sentence for an error of msgspec.toml.decode(text, type=root)."""
    message = str(error)
    if not isinstance(error, msgspec.ValidationError):
        return QuadrigError(f"{name}: this is not TOML: {_lower(message)}")
    what, _, path = message.partition(" - at `")
    path = path.rstrip("`") or "$"
    if unknown := re.match(r"Object contains unknown field `(.*)`", what, re.DOTALL):
        key = unknown.group(1)
        allowed = ", ".join(_fields(_table_at(root, path, text)))
        return QuadrigError(
            f"{locate(name, text, path, key)}: {_place(path)} has no key {key!r}; allowed are {allowed}"
        )
    if missing := re.match(r"Object missing required field `(.*)`", what):
        key = missing.group(1)
        if path == "$":
            return QuadrigError(f"{name}: there is no [[{key}]]; describe at least one that several cameras see")
        return QuadrigError(f"{locate(name, text, path)}: {_place(path)} lacks the key {key!r}; add it")
    key = re.sub(r"\[\d+\]$", "", path).rpartition(".")[2]
    if invalid := re.match(r"Invalid (?:enum )?value '(.*)'", what):
        allowed = ", ".join(_choices(root, path))
        return QuadrigError(f"{locate(name, text, path)}: {key} is {invalid.group(1)!r}; allowed are {allowed}")
    return QuadrigError(f"{locate(name, text, path)}: {key} in {_place(_parent(path))}: {_plain(what)}")


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]


def _parent(path: str) -> str:
    return re.sub(r"(\[\d+\])?$", "", path).rpartition(".")[0] or "$"


def _place(path: str) -> str:
    """ "the second [[rectangle]]" in words a person can find: "rectangle 2", "marking of rectangle 2"."""
    words = []
    for step, index in re.findall(r"(\w+)(?:\[(\d+)\])?", path.removeprefix("$")):
        words.append(f"{step} {int(index) + 1}" if index else step)
    return " of ".join(reversed(words)) or "the file"


def _plain(what: str) -> str:
    """msgspec's expectation without its backticks and type names."""
    what = re.sub(r"`(\w+(?: \| \w+)*)`", lambda m: " or ".join(_kind(k) for k in m.group(1).split(" | ")), what)
    what = re.sub(r"`(\w+) (>=?|<=?) ([-\d.]+)`", lambda m: f"{_kind(m.group(1))} {m.group(2)} {m.group(3)}", what)
    what = re.sub(r"`(\w+) of length >= 1`", lambda m: f"{_kind(m.group(1))} that is not empty", what)
    what = re.sub(r"`(\w+) of length ([<>=]+ \d+)`", lambda m: f"{_kind(m.group(1))} of length {m.group(2)}", what)
    return _lower(what).replace(" or nothing", "")


def _kind(name: str) -> str:
    return _KINDS.get(name, name)


def _fields(table: type) -> list[str]:
    names = [f.encode_name for f in msgspec.structs.fields(table)]
    config = table.__struct_config__  # pyright: ignore[reportAttributeAccessIssue]
    return [config.tag_field, *names] if config.tag_field else names


def _type_at(root: object, path: str) -> list[object]:
    """The types a value at the path may have: follows fields, list items and the members of unions."""
    here: list[object] = [root]
    for step in re.findall(r"\w+(?![^\[]*\])|\[\d+\]", path.removeprefix("$")):
        here = [inner for one in here for inner in _step(one, step)]
    return here


def _step(one: object, step: str) -> list[object]:
    if step.startswith("["):
        return _members(typing.get_args(one)[0]) if typing.get_args(one) else []
    if not (isinstance(one, type) and issubclass(one, msgspec.Struct)):
        return []
    return [inner for f in msgspec.structs.fields(one) if f.encode_name == step for inner in _members(f.type)]


def _members(one: object) -> list[object]:
    if typing.get_origin(one) is typing.Annotated:
        return _members(typing.get_args(one)[0])
    if typing.get_origin(one) in (types.UnionType, typing.Union):
        return [inner for member in typing.get_args(one) for inner in _members(member)]
    return [one]


def _table_at(root: type, path: str, text: str) -> type:
    tables = [t for t in _type_at(root, path) if isinstance(t, type) and issubclass(t, msgspec.Struct)]
    if len(tables) == 1:
        return tables[0]
    kind = _value_at(text, path).get("kind")
    return next(t for t in tables if t.__struct_config__.tag == kind)  # pyright: ignore[reportAttributeAccessIssue]


def _value_at(text: str, path: str) -> dict:
    value = msgspec.toml.decode(text)
    for name, index in re.findall(r"(\w+)(?:\[(\d+)\])?", path.removeprefix("$")):
        value = value[name][int(index)] if index else value[name]
    return value


def _choices(root: type, path: str) -> list[str]:
    """What a Literal, or the kind of a tagged table, may be."""
    if path.endswith(".kind"):
        tables = _type_at(root, path.removesuffix(".kind"))
        return [str(t.__struct_config__.tag) for t in tables if isinstance(t, type) and issubclass(t, msgspec.Struct)]
    return [str(choice) for one in _type_at(root, path) for choice in typing.get_args(one)]
