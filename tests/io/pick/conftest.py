"""A session over three pictures of a court, its page, and a real browser to open it in."""

import shutil
import threading
from contextlib import contextmanager

import pytest

from quadrig.io.config.rig_toml import read_config
from quadrig.io.local_page import LocalPage
from quadrig.io.pick.answers import answers
from quadrig.io.pick.session import PickSession
from quadrig.io.recording.framesets import build_framesets
from quadrig.io.recording.recorded_cameras import open_recording


@pytest.fixture(scope="session")
def court(load_script):
    """Three cameras at a tennis court, with their truth."""
    return load_script("tests/io/court_room.py")


@pytest.fixture
def session(court, tmp_path) -> PickSession:
    """Nothing clicked yet."""
    return _open_session(tmp_path, court.write(tmp_path))


@pytest.fixture
def open_session():
    """open_session(folder, pictures)."""
    return _open_session


@pytest.fixture
def serving():
    """with serving(session) as page."""
    return _serving


def _open_session(folder, pictures) -> PickSession:
    """A session over pictures, with the rig.toml and corners.toml of a folder."""
    recording = open_recording(pictures)
    config = read_config(folder / "rig.toml")
    return PickSession(recording, build_framesets(recording), config, folder / "corners.toml")


@contextmanager
def _serving(session):
    """The page of a session, served as `rig pick` does; its LocalPage."""
    with LocalPage(answers(session)) as page:
        thread = threading.Thread(target=page.serve)
        thread.start()
        try:
            yield page
        finally:
            page.close()
            thread.join()


@pytest.fixture(scope="session")
def browser():
    """A headless Chromium, driven with mouse and keys."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright, which drives a browser, is not here")
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with playwright.sync_playwright() as driver:
        try:
            opened = driver.chromium.launch(executable_path=found, args=["--no-sandbox"])
        except playwright.Error as error:
            pytest.skip(f"there is no Chromium here to open the page in ({str(error).splitlines()[0]})")
        yield opened
        opened.close()
