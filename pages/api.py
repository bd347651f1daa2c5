"""The public names of the three rooms, for mkdocstrings: each from the module it lives in."""

from importlib import import_module
from inspect import isclass, isfunction

ROOMS = ("single", "rig", "io")


def page(room: str) -> str:
    """Functions, then classes, then what else is public, by name."""
    package = import_module(f"quadrig.{room}")
    names = sorted(package.__all__, key=lambda name: (_order(getattr(package, name)), name.lower()))
    shown = [name for name in names if _order(getattr(package, name)) < 2]
    others = [name for name in names if name not in shown]
    lines = [_section(getattr(package, name), name, room) for name in shown]
    if others:
        lines += ["## Also there", "", ", ".join(f"`{name}`" for name in others) + "."]
    return "\n".join(lines)


def _order(value: object) -> int:
    return 0 if isfunction(value) else 1 if isclass(value) else 2


def _section(value: object, name: str, room: str) -> str:
    home = getattr(value, "__module__", "")
    if not home.startswith(f"quadrig.{room}."):
        other = home.split(".")[1]
        return f"## {name}\n\nThat of [quadrig.{other}](api-{other}.md#{home}.{name}).\n"
    return f"::: {home}.{name}\n"
