"""Numbered pictures, as files and as streams served on this machine."""

import pytest


@pytest.fixture(scope="session")
def numbered(load_script):
    """numbered.stream(...), numbered.served(pictures), numbered.write_video(...): see numbered_pictures.py."""
    return load_script("tests/io/live/capture/numbered_pictures.py")
