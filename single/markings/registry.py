"""The kinds of marking by name: those that rig.toml and results may speak of."""

from collections.abc import Mapping
from dataclasses import asdict
from types import MappingProxyType
from typing import Any, TypeVar

from quadrig.single.errors import QuadrigError
from quadrig.single.markings.april_grid import AprilGridMarking
from quadrig.single.markings.blank_sheet import PlainMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.circle_grid import CircleGridMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Marking, PointsMarking

Kind = TypeVar("Kind", bound=type[Marking])

_KINDS: dict[str, type[Marking]] = {}


def register(kind: Kind) -> Kind:
    """Make a kind of marking known by its name, as a decorator or a call.

    Raises QuadrigError where another kind bears the name.
    """
    if _KINDS.setdefault(kind.kind, kind) is not kind:
        raise QuadrigError(f"there is a kind of marking {kind.kind!r} already; give this one another name")
    return kind


for _kind in (
    TagMarking,
    CharucoMarking,
    AprilGridMarking,
    ChessboardMarking,
    CircleGridMarking,
    PlainMarking,
    PointsMarking,
):
    register(_kind)


def marking_kinds() -> Mapping[str, type[Marking]]:
    """Every kind of marking by its name."""
    return MappingProxyType(_KINDS)


def marking_values(marking: Marking) -> dict[str, Any]:
    """A marking as plain values: those of its keys, and its kind."""
    return {**asdict(marking), "kind": marking.kind}
