"""What README.md says holds: its rig.toml is read, its commands and files exist, the quick start has two blocks."""

import ast
import re
from importlib import import_module
from pathlib import Path

from quadrig.io.commands.main import COMMANDS
from quadrig.io.config.rig_toml import parse_config

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()


def test_the_rig_toml_is_read() -> None:
    (block,) = re.findall(r"```toml\n(.*?)```", README, re.S)
    assert len(parse_config(block).rectangles) == 2


def test_the_commands_exist() -> None:
    blocks = re.findall(r"```(?:sh|console)\n(.*?)```", README, re.S)
    called = {name for block in blocks for name in re.findall(r"^\s*rig (\w+)", block, re.M)}
    assert called
    assert called <= set(COMMANDS)


def test_what_is_linked_exists() -> None:
    linked = {*re.findall(r"\]\((?!http)([^)]+)\)", README), *re.findall(r"`(examples/[^`]+)`", README)}
    assert linked
    assert [target for target in linked if not _is_there(*target.partition("#")[::2])] == []


def _is_there(path: str, anchor: str) -> bool:
    """Whether a file is there, and in it the heading that a link names."""
    if not anchor:
        return (ROOT / path).exists()
    headings = re.findall(r"^#+ (.+)$", (ROOT / path).read_text(), re.M)
    return anchor in {re.sub(r"[^a-z0-9 -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_quick_start_has_two_blocks() -> None:
    section = README.split("## Quick start")[1].split("\n## ")[0]
    assert len(re.findall(r"```sh\n", section)) == 2


def test_what_its_python_imports_is_there() -> None:
    blocks = re.findall(r"```python\n(.*?)```", README, re.S)
    assert blocks
    for statement in (each for block in blocks for each in ast.walk(ast.parse(block))):
        if isinstance(statement, ast.ImportFrom) and statement.module is not None:
            for alias in statement.names:
                assert hasattr(import_module(statement.module), alias.name), alias.name
