"""The rooms' public faces: what they promise is there, type checkers see the same, and nothing loads early."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOMS = ["quadrig.single", "quadrig.io"]
HEAVY = {"numpy", "cv2", "scipy", "networkx", "rerun"}


def seen_by_type_checkers(room: str) -> dict[str, str]:
    """Names imported under `if TYPE_CHECKING`, each with its module below the room."""
    source = importlib.import_module(room).__file__
    assert source is not None
    tree = ast.parse(Path(source).read_text())
    return {
        alias.name: str(statement.module).removeprefix(f"{room}.")
        for block in tree.body
        if isinstance(block, ast.If)
        for statement in block.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }


@pytest.mark.parametrize("room", ROOMS)
def test_type_checkers_see_the_names_that_are_loaded(room: str) -> None:
    seen = seen_by_type_checkers(room)
    face = importlib.import_module(room)
    assert set(seen) == set(face.__all__)
    for name, module in seen.items():
        assert getattr(face, name) is getattr(importlib.import_module(f"{room}.{module}"), name)
    assert set(face.__all__) <= set(dir(face))


@pytest.mark.parametrize("room", ROOMS)
def test_a_name_that_is_not_there_is_refused(room: str) -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        importlib.import_module(room).no_such_name  # noqa: B018 - reading the attribute is what is tried


@pytest.mark.parametrize("room", ROOMS)
def test_importing_a_room_loads_nothing_heavy(room: str) -> None:
    code = f"import sys, {room}; sys.exit(bool({HEAVY} & sys.modules.keys()))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
