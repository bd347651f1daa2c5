"""YAML of other programs, read as plain values only."""

from typing import Any

import yaml

from quadrig.io.whole_file import LARGEST_OF_CAMERAS

SAFE_LOADER: type = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""Libyaml's where PyYAML was built with it: eight times as quick."""


def read_yaml(content: bytes, loader: type = SAFE_LOADER) -> dict[str, Any]:
    """The mapping of a YAML file. Raises ValueError where it is none, or larger than any file of cameras or targets,
    and yaml.YAMLError where it is no YAML."""
    if len(content) > LARGEST_OF_CAMERAS:
        raise ValueError(f"{len(content)} bytes of YAML are no file of cameras")
    # A few hundred bytes of names for names of names unfold to gigabytes; no file of cameras has any.
    if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(content, loader)):
        raise ValueError("it has aliases (*name), which no file of cameras or targets needs")
    values = yaml.load(content, loader)
    if not isinstance(values, dict):
        raise ValueError("it holds no mapping")
    return values
