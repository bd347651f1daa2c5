"""A made-up rig for tests of what is written and drawn, and numbered pictures for tests of recordings."""

import pytest

from quadrig.rig.result import Camera, PlacedRectangle, Rig


@pytest.fixture(scope="session")
def example(load_script) -> tuple[Rig, list[Camera], list[PlacedRectangle]]:
    """A made-up Rig, with the true cameras and rectangles it was drawn around."""
    return load_script("tests/io/made_up_rig.py").make_rig()


@pytest.fixture(scope="session")
def example_rig(example) -> Rig:
    """A made-up Rig."""
    return example[0]


@pytest.fixture(scope="session")
def carried_rig(load_script, example_rig) -> Rig:
    """The same cameras, carried through a hall."""
    return load_script("tests/io/made_up_rig.py").carried(example_rig)


@pytest.fixture(scope="session")
def example_config() -> str:
    """The rig.toml of the made-up Rig."""
    return 'reference = "cam0"\n\n[[rectangle]]\nname = "board"\nwidth = 0.3\nheight = 0.24\nmoving = true\n'


@pytest.fixture(scope="session")
def pictures(load_script):
    """picture(k), number(image), colour_error(image), WIDTH, HEIGHT."""
    return load_script("tests/io/numbered_pictures.py")


@pytest.fixture(scope="session")
def room(load_script):
    """A room with a sheet in the hand before three cameras: TAG, picture(camera, pose), held_poses()..."""
    return load_script("tests/io/sheet_room.py")
