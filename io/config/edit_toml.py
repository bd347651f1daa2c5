"""Rectangles put into a rig.toml that a person wrote: all else stays, with its comments and its order."""

from collections.abc import Sequence

from quadrig.io.config.rig_toml import RigConfig, config_text
from quadrig.single.rectangle import Rectangle

# What a rectangle says of its sheet: a key of these that the new one has not goes. What it says of the room stays.
_OF_THE_SHEET = ("size", "target", "width", "height", "moving", "marking")


def with_rectangles(text: str, rectangles: Sequence[Rectangle]) -> str:
    """The text of a rig.toml, whole TOML, with these rectangles: in the place of those of their names, or behind."""
    import tomlkit

    document = tomlkit.parse(text)
    there = {table["name"]: table for table in document.get("rectangle", [])}
    new = []
    for rectangle in rectangles:
        table = there.get(rectangle.name)
        if table is None:
            new.append(rectangle)
            continue
        (values,) = tomlkit.parse(config_text(RigConfig((rectangle,))))["rectangle"].unwrap()  # pyright: ignore[reportAttributeAccessIssue]
        for key in _OF_THE_SHEET:
            if key not in values:
                table.pop(key, None)
        for key, value in values.items():
            if key not in table or table[key] != value:
                table[key] = _inline(value)
    edited = tomlkit.dumps(document)
    if not new:
        return edited
    behind, bodies = tomlkit.parse(config_text(RigConfig(tuple(new)))), [b["name"] for b in document.get("body", [])]
    if "body" in behind and set(bodies) & {body["name"] for body in behind["body"]}:
        del behind["body"]
    return f"{edited.rstrip()}\n\n{tomlkit.dumps(behind)}"


def _inline(value: object) -> object:
    """A table as it is written on one line."""
    import tomlkit

    if not isinstance(value, dict):
        return value
    table = tomlkit.inline_table()
    table.update(value)
    return table
