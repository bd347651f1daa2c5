"""The kinds of marking by name: those that rig.toml and results may speak of."""

from collections.abc import Mapping
from dataclasses import asdict
from importlib import import_module
from types import MappingProxyType
from typing import Any, TypeVar

from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Marking

Kind = TypeVar("Kind", bound=type[Marking])

# Each with its module, loaded when a rig or a rig.toml speaks of it: most speak of one, and each brings its detector.
_OWN = {
    "tag": ("markings.tag", "TagMarking"),
    "charuco": ("markings.charuco", "CharucoMarking"),
    "aprilgrid": ("markings.april_grid", "AprilGridMarking"),
    "chessboard": ("markings.chessboard", "ChessboardMarking"),
    "circles": ("markings.circle_grid", "CircleGridMarking"),
    "plain": ("markings.blank_sheet", "PlainMarking"),
    "points": ("rectangle", "PointsMarking"),
}
_KINDS: dict[str, type[Marking]] = {}


def register(kind: Kind) -> Kind:
    """Make a kind of marking known by its name, as a decorator or a call.

    Raises QuadrigError where another kind bears the name.
    """
    if marking_kind(kind.kind) not in (None, kind):
        raise QuadrigError(f"there is a kind of marking {kind.kind!r} already; give this one another name")
    _KINDS[kind.kind] = kind
    return kind


def marking_kind(name: str) -> type[Marking] | None:
    """The kind of marking of that name; None where there is none."""
    if name not in _KINDS and name in _OWN:
        module, own = _OWN[name]
        _KINDS[name] = getattr(import_module(f"quadrig.single.{module}"), own)
    return _KINDS.get(name)


def marking_kinds() -> Mapping[str, type[Marking]]:
    """Every kind of marking by its name."""
    found = {name: marking_kind(name) for name in (*_OWN, *_KINDS)}
    return MappingProxyType({name: kind for name, kind in found.items() if kind is not None})


def marking_values(marking: Marking) -> dict[str, Any]:
    """A marking as plain values: those of its keys, and its kind."""
    return {**asdict(marking), "kind": marking.kind}
