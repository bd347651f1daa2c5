"""What mkdocs does beside turning docs/ into pages: sections from the code, formulas, and that nothing is fetched.

A page asks for a section with `<!-- made: NAME -->`.
"""

import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path.insert(0, str(HERE))

import api  # noqa: E402
import commands  # noqa: E402
import mathematics  # noqa: E402
import rig_toml  # noqa: E402
import troubleshooting  # noqa: E402
from mkdocs.exceptions import PluginError  # noqa: E402

_MADE: dict[str, Callable[[], str]] = {
    "rig.toml": rig_toml.page,
    "commands": commands.page,
    "coverage": lambda: (ROOT / "docs" / "figures" / "coverage.md").read_text(),
    "house": lambda: house(),
    "changes": lambda: (ROOT / "CHANGELOG.md").read_text().partition("\n")[2],
    **{f"api {room}": (lambda room=room: api.page(room)) for room in api.ROOMS},
}
_FORMULAS: dict[str, list[str]] = {}
# What a browser would fetch by itself while a page is read.
_FETCHED = re.compile(r"""<(?:script|img|iframe|link)\b[^>]*?\b(?:src|href)=["']?(?:https?:)?//[^>]*>""")
_POINTED = re.compile(r"""<link\b[^>]*\brel=["']?(?:canonical|next|prev)""")


def on_config(config: Any) -> Any:
    """Lay the rooms out as folders, as they are installed: where mkdocstrings looks for them."""
    place = ROOT / "build" / "rooms" / "quadrig"
    shutil.rmtree(place, ignore_errors=True)
    for room in api.ROOMS:
        shutil.copytree(ROOT / room, place / room, ignore=shutil.ignore_patterns("__pycache__"))
    return config


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Sections from the code, and formulas."""
    markdown = re.sub(r"<!-- made: (.+?) -->", lambda asked: _MADE[asked[1]](), markdown)
    if page.file.src_uri == "troubleshooting.md":
        markdown = troubleshooting.filled(markdown)
    markdown, _FORMULAS[page.file.src_uri] = mathematics.set_aside(markdown)
    return markdown


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """The formulas, now that nothing reads their signs as Markdown."""
    return mathematics.put_back(html, _FORMULAS[page.file.src_uri])


def on_post_build(config: Any) -> None:
    """Fail where a page would fetch something: they are read without a network too."""
    for path in Path(config["site_dir"]).rglob("*.html"):
        fetched = [tag for tag in _FETCHED.findall(path.read_text()) if not _POINTED.match(tag)]
        if fetched:
            raise PluginError(f"{path.name} fetches {fetched[0]}; the pages are to be read without a network")


def house() -> str:
    """CONTRIBUTING.md as a page."""
    text = (ROOT / "CONTRIBUTING.md").read_text().partition("\n")[2]
    return re.sub(r"\]\((?:\.\./)?docs/", "](", text)
