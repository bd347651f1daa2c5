"""What is installed, released and cited agrees: imports and requirements, versions, recipes, addresses."""

import ast
import re
import sys
import tomllib
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution, packages_distributions
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement

from quadrig.io import __version__

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# Blender runs what `rig export --format blender` writes, in a Python of its own.
_INSIDE_BLENDER = {"bpy", "mathutils"}
# conda-forge's names where they are others.
_CONDA = {"opencv-python-headless": "py-opencv"}


def name_of(requirement: str) -> str:
    return re.split(r"[\s\[<>=~!;]", requirement, maxsplit=1)[0].lower().replace("_", "-")


def imported(tree: ast.AST) -> set[str]:
    """The top-level modules that a file imports."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module)
    return found


# Reading what is installed takes a third of a second.
_brought = cache(packages_distributions)


def distributions(module: str) -> set[str]:
    """Who brings a module. Those of google.* share their first name: the module itself says which one it is."""
    if module.startswith("google."):
        return {module.split(".")[1]}
    return {name_of(name) for name in _brought().get(module.split(".")[0], [])}


def test_what_is_imported_is_required_and_what_is_required_is_imported() -> None:
    files = [path for room in ("single", "rig", "io") for path in (ROOT / room).rglob("*.py")]
    modules = {module for path in files for module in imported(ast.parse(path.read_text()))}
    outside = {
        module
        for module in modules
        if module.split(".")[0] not in sys.stdlib_module_names | {"quadrig"} | _INSIDE_BLENDER
    }
    required = {name_of(one) for one in PROJECT["dependencies"]}
    optional = {name_of(one) for extra in ("usd", "bags", "dask") for one in PROJECT["optional-dependencies"][extra]}
    brought = {module: distributions(module) for module in outside}
    assert {module: by for module, by in brought.items() if by and not by & (required | optional)} == {}
    used = set().union(*brought.values())
    assert required - used == set()


def needed(requirements: list[str], extras: frozenset[str] = frozenset()) -> set[str]:
    """The distributions that these requirements bring, with all that those need in turn, where they are installed."""
    found: set[str] = set()
    left = [(Requirement(one), extras) for one in requirements]
    while left:
        one, asked = left.pop()
        applies = one.marker is None or any(one.marker.evaluate({"extra": extra}) for extra in (asked or {""}))
        name = name_of(one.name)
        if not applies or name in found:
            continue
        try:
            brings = distribution(name).requires or []
        except PackageNotFoundError:
            continue
        found.add(name)
        left += [(Requirement(brought), frozenset(one.extras)) for brought in brings]
    return found


def licence_of(name: str) -> str:
    """What a distribution says of its licence."""
    metadata = distribution(name).metadata
    classifiers = [line for line in metadata.get_all("Classifier", []) if line.startswith("License ::")]
    whole = [text.partition("\n")[0] for text in metadata.get_all("License", [])]
    return "; ".join([*metadata.get_all("License-Expression", []), *classifiers, *whole])


# Those that let anybody use, change and pass on, with notice alone: TOST is Apache-2.0 with another clause on
# trademarks, HPND and MIT-CMU are old forms of MIT; "any-OSI" is any of the licences that the OSI approved.
_PERMISSIVE = r"MIT|BSD|Apache|ISC|PSF|HPND|Zlib|CC0|Unlicense|TOST|any-OSI"
_BINDING = r"GPL|General Public|Affero|Proprietary|Non-?Commercial|SSPL|BUSL"


def test_all_that_is_installed_has_a_permissive_licence() -> None:
    optional = [one for extra in ("usd", "bags", "dask") for one in PROJECT["optional-dependencies"][extra]]
    licences = {name: licence_of(name) for name in needed([*PROJECT["dependencies"], *optional])}
    assert len(licences) > len(PROJECT["dependencies"])
    assert {k: v for k, v in licences.items() if not re.search(_PERMISSIVE, v) or re.search(_BINDING, v)} == {}


def versions(name: str) -> dict[str, str]:
    """The versions of a list of packaging/tested/."""
    lines = (ROOT / "packaging" / "tested" / f"{name}.txt").read_text().splitlines()
    return {name_of(line): line.partition("==")[2] for line in lines if line and not line.startswith("#")}


def test_the_lowest_versions_that_are_allowed_are_those_that_were_tested() -> None:
    lowest, newest = versions("lowest"), versions("newest")
    optional = [one for extra in ("usd", "bags", "dask") for one in PROJECT["optional-dependencies"][extra]]
    for requirement in map(Requirement, [*PROJECT["dependencies"], *optional]):
        name = name_of(requirement.name)
        bound = next(one.version for one in requirement.specifier if one.operator == ">=")
        assert f"{lowest[name]}.0.0".startswith(f"{bound}."), name
        assert requirement.specifier.contains(newest[name]), name


def test_every_file_that_says_the_version_says_the_same() -> None:
    assert __version__ == PROJECT["version"]
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == __version__
    assert f"## {__version__}" in (ROOT / "CHANGELOG.md").read_text()
    recipe = yaml.safe_load((ROOT / "packaging/conda-forge/recipe.yaml").read_text())
    assert recipe["context"]["version"] == __version__


def test_conda_forge_installs_what_pip_does() -> None:
    run = yaml.safe_load((ROOT / "packaging/conda-forge/recipe.yaml").read_text())["requirements"]["run"]
    for requirement in PROJECT["dependencies"]:
        name = name_of(requirement)
        assert f"{_CONDA.get(name, name)} {requirement[len(name) :]}" in run
    assert len(run) == len(PROJECT["dependencies"]) + 1  # and Python itself


def test_a_released_readme_has_whole_links(load_script) -> None:
    at_home = load_script("packaging/at_home.py")
    text = "![a room](docs/demo.jpg), [formats](docs/formats.md), [below](#figures), [rerun](https://rerun.io)"
    links = re.findall(r"\]\(([^)]+)\)", at_home.whole_links(text, "https://example.org/quadrig", "v1"))
    assert links == [
        "https://example.org/quadrig/raw/v1/docs/demo.jpg",
        "https://example.org/quadrig/blob/v1/docs/formats.md",
        "#figures",
        "https://rerun.io",
    ]


def test_a_released_project_has_addresses(load_script) -> None:
    at_home = load_script("packaging/at_home.py")
    text = at_home.with_addresses("[project.scripts]\n", "https://example.org/q", "https://pages.org")
    urls = tomllib.loads(text)["project"]["urls"]
    assert urls["Homepage"] == "https://example.org/q"
    assert urls["Documentation"] == "https://pages.org"
    assert "[project.scripts]\n" in (ROOT / "pyproject.toml").read_text()


def test_the_pythons_that_are_stated_begin_with_the_oldest_that_installs() -> None:
    versions = [line.rpartition(" ")[2] for line in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d+$", line)]
    assert PROJECT["requires-python"] == f">={versions[0]}"


@pytest.mark.parametrize("folder", ["tests", "examples", "docs", "benchmarks", "packaging"])
def test_the_source_archive_takes_whole_folders(folder: str) -> None:
    assert f"graft {folder}\n" in (ROOT / "MANIFEST.in").read_text()
