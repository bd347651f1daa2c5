"""A release knows where its project lives: addresses go into pyproject.toml, and links of README.md become whole.

PyPI shows README.md by itself, where a path of the repository leads nowhere. A clone needs none of this, and the
address stands in no file of it: whoever releases says it.

    python packaging/at_home.py https://github.com/OWNER/quadrig https://OWNER.github.io/quadrig v0.1.0 [CHECKOUT]
"""

import re
import sys
from pathlib import Path

_PICTURES = (".jpg", ".png", ".svg")


def whole_links(text: str, home: str, tag: str) -> str:
    """The text with every link into the repository as an address at `home`, as the repository was at the tag."""

    def whole(link: re.Match[str]) -> str:
        kind = "raw" if link[1].endswith(_PICTURES) else "blob"
        return f"]({home}/{kind}/{tag}/{link[1]})"

    return re.sub(r"\]\((?!https?://|#)([^)]+)\)", whole, text)


def with_addresses(project: str, home: str, pages: str) -> str:
    """pyproject.toml with the addresses that package indexes show."""
    addresses = {
        "Homepage": home,
        "Documentation": pages,
        "Source": home,
        "Issues": f"{home}/issues",
        "Changelog": f"{home}/blob/main/CHANGELOG.md",
    }
    table = "".join(f'{name} = "{address}"\n' for name, address in addresses.items())
    return project.replace("[project.scripts]\n", f"[project.urls]\n{table}\n[project.scripts]\n", 1)


def main(home: str, pages: str, tag: str, checkout: str = ".") -> None:
    """Write both into a checkout that is then built."""
    readme, project = Path(checkout, "README.md"), Path(checkout, "pyproject.toml")
    readme.write_text(whole_links(readme.read_text(), home, tag))
    project.write_text(with_addresses(project.read_text(), home, pages))


if __name__ == "__main__":
    main(*sys.argv[1:])
