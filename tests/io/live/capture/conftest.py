"""A stream of pictures served on this machine."""

import pytest


@pytest.fixture(scope="session")
def jpeg_stream(load_script):
    """served(pictures, lengths): the address of a motion-JPEG stream."""
    return load_script("tests/io/live/capture/jpeg_stream.py")
