"""The layout of the rooms: every folder is installed, none is crowded, and no module hides a name of the package."""

import tomllib
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("single", "rig", "io")


def folders() -> list[Path]:
    """Every folder of the three rooms that holds a module."""
    return sorted({path.parent for room in ROOMS for path in (ROOT / room).rglob("*.py")})


def dotted(folder: Path) -> str:
    return ".".join(("quadrig", *folder.relative_to(ROOT).parts))


def modules(folder: Path) -> set[str]:
    return {path.stem for path in folder.glob("*.py")} - {"__init__"}


def public_names(folder: Path) -> set[str]:
    """What the package says is public; nothing where it says nothing."""
    return set(getattr(import_module(dotted(folder)), "__all__", ()))


def test_every_folder_is_a_package_that_is_installed() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert sorted(project["tool"]["setuptools"]["packages"]) == sorted(dotted(folder) for folder in folders())
    for folder in folders():
        assert (folder / "__init__.py").is_file(), folder


def test_no_folder_is_crowded() -> None:
    # As many names as one reads at a glance.
    assert {dotted(folder): len(modules(folder)) for folder in folders() if len(modules(folder)) > 14} == {}


def test_no_module_is_named_like_its_folder() -> None:
    assert [dotted(folder) for folder in folders() if folder.name in modules(folder)] == []


def test_no_module_hides_a_public_name_of_its_package() -> None:
    """`from quadrig.rig import calibrate` shall give the function, also after a module was imported."""
    assert {
        dotted(folder): hidden for folder in folders() if (hidden := public_names(folder) & modules(folder))
    } == {}
