"""Fixtures that every room's tests share."""

import importlib.util
import os
import signal
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]

# A shell starts background jobs with Ctrl-C ignored, and what they start inherits that: tests that interrupt a
# command would then wait for ever.
signal.signal(signal.SIGINT, signal.default_int_handler)
# Tests side by side take all cores, and no matrix here is quicker on several. Read when numpy is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Rerun reads this once, when it is first imported: a test of what is said must not hang on which test came before.
os.environ.setdefault("RUST_LOG", "off")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real pictures that stands beside a checkout; a test that needs it skips where it is absent."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the real pictures of ../shared/data are not here")
    return folder


@pytest.fixture(scope="session")
def load_script() -> Callable[[str], ModuleType]:
    """load_script("benchmarks/simulated.py"): a file of this repository as a module; the same one each time."""

    @cache
    def load(path: str) -> ModuleType:
        name = path.removesuffix(".py").replace("/", ".")
        spec = importlib.util.spec_from_file_location(name, ROOT / path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        # Dataclasses look their own module up by name.
        sys.modules[name] = module
        spec.loader.exec_module(module)
        return module

    return load
