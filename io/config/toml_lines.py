"""Lines of TOML: how a value is written, and where one stands, so that an error can name the line to mend."""

import re

import msgspec

_STEP = re.compile(r"(\w+)|\[(\d+)\]")


def line_of(text: str, path: str, key: str = "") -> int | None:
    """The line, from 1, of a value such as "$.rectangle[1].marking.id", or of `key` within it; None where unknown.

    Follows tables, arrays of tables and inline tables written on one line, which is all that rig.toml uses.
    """
    lines = text.splitlines()
    steps = [name or int(index) for name, index in _STEP.findall(path.removeprefix("$"))]
    first, last, found = 0, len(lines), None
    for position, step in enumerate([*steps, key] if key else steps):
        if isinstance(step, int):
            continue
        count = steps[position + 1] if position + 1 < len(steps) else 0
        header = _header(lines, step, count if isinstance(count, int) else 0)
        if position == 0 and header is not None:
            found, first = header, header + 1
            last = _next_header(lines, first)
            continue
        entry = _entry(lines, step, first, last)
        if entry is None:
            break
        found = entry
    return None if found is None else found + 1


def _header(lines: list[str], name: str, index: int) -> int | None:
    pattern = re.compile(rf"\s*\[\[?\s*{re.escape(name)}\s*\]")
    headers = [number for number, line in enumerate(lines) if pattern.match(line)]
    return headers[index] if index < len(headers) else None


def _next_header(lines: list[str], start: int) -> int:
    return next((n for n in range(start, len(lines)) if lines[n].lstrip().startswith("[")), len(lines))


def _entry(lines: list[str], name: str, first: int, last: int) -> int | None:
    pattern = re.compile(rf"(^|[{{,])\s*\"?{re.escape(name)}\"?\s*[=.]")
    return next((n for n in range(first, last) if pattern.search(lines[n].split("#")[0])), None)


def toml_line(key: str, value: object) -> str:
    """A key with its value: a bool, number, text, list or inline table."""
    return f"{key} = {_toml(value)}"


def _toml(value: object) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return msgspec.json.encode(value).decode()
        case dict():
            return "{ " + ", ".join(toml_line(k, v) for k, v in value.items()) + " }"
        case list() | tuple():
            return "[" + ", ".join(_toml(item) for item in value) + "]"
        case _:
            return repr(value)
