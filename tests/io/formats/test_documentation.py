"""docs/formats.md and the published schema say what is there."""

import json
import re
from pathlib import Path
from typing import Any

from quadrig.io.formats.registry import FORMATS
from quadrig.io.formats.rig_json import json_schema

DOCS = Path(__file__).resolve().parents[3] / "docs"


def test_every_format_has_a_row_and_says_whether_it_is_read():
    rows = [line.split("|") for line in (DOCS / "formats.md").read_text().splitlines() if line.startswith("| `")]
    stated = {name: row[2].strip() == "yes" for row in rows for name in re.findall("`([a-z0-9-]+)`", row[1])}
    assert stated == {name: form.read is not None for name, form in FORMATS.items()}


def in_order(schema: Any) -> Any:
    """The same with the alternatives of each anyOf in one order: msgspec's versions have their own."""
    if isinstance(schema, dict):
        return {key: in_order(sorted(value, key=str) if key == "anyOf" else value) for key, value in schema.items()}
    return [in_order(one) for one in schema] if isinstance(schema, list) else schema


def test_the_published_schema_is_the_one_in_use():
    assert in_order(json.loads((DOCS / "rig.schema.json").read_text())) == in_order(json_schema())
