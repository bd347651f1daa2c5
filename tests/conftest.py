"""Fixtures that every room's tests share."""

import os
import signal
from pathlib import Path

import pytest

# A shell starts background jobs with Ctrl-C ignored, and what they start inherits that: tests that interrupt a
# command would then wait for ever.
signal.signal(signal.SIGINT, signal.default_int_handler)
# Rerun reads this once, when it is first imported: a test of what is said must not hang on which test came before.
os.environ.setdefault("RUST_LOG", "off")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real pictures that stands beside a checkout; a test that needs it skips where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the real pictures of ../shared/data are not here")
    return folder
