"""Which sources a command reads: those of its command line, else those of rig.toml."""

import re
from pathlib import Path

from quadrig.io.config.rig_toml import RigConfig
from quadrig.io.live.capture.source_spec import SourceSpec, parse_source
from quadrig.single.errors import QuadrigError


def named_sources(texts: list[str], config: RigConfig, folder: Path) -> dict[str, SourceSpec]:
    """Sources by camera name: those of the command line, else those of rig.toml, whose paths begin at `folder`.

    Raises QuadrigError where there is none, or two of one name.
    """
    if not texts:
        given = {c.name: parse_source(c.source, folder) for c in config.cameras if c.source is not None}
        if not given:
            raise QuadrigError(
                "no cameras: name sources (rig setup 0 1), or give each [[camera]] of rig.toml a source"
            )
        return given
    sources: dict[str, SourceSpec] = {}
    for index, text in enumerate(texts):
        name, source = _named(text, index)
        if name in sources:
            raise QuadrigError(f"two sources are called {name!r}; name them with NAME=SOURCE")
        sources[name] = parse_source(source)
    return sources


def is_live(text: str) -> bool:
    """Whether a source of the command line is a live one, and not a file or folder."""
    source = re.sub(r"^[A-Za-z0-9_.-]+=", "", text)
    return source.isdigit() or source.startswith(("/dev/", "watch:")) or "://" in source


def _named(text: str, index: int) -> tuple[str, str]:
    """A name and a source; the name of a file or folder is its own, of anything else cam and its number."""
    match = re.fullmatch(r"([A-Za-z0-9_.-]+)=(.+)", text)
    if match is not None:
        return match[1], match[2]
    path = Path(text.removeprefix("watch:"))
    if "://" not in text and not text.startswith("/dev/") and path.exists():
        return path.stem, text
    return f"cam{index}", text
