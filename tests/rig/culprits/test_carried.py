"""A camera that walks past what is said to stand still: taken for carried, and told how rig.toml says so."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.rig.doubt.verdict import weak_points


@pytest.fixture(scope="module")
def alone(bodies, table_lens):
    """One camera of a rig that was carried through a room, and its Views; the room's sheets said to stand still."""
    made = bodies.carried(np.random.default_rng(4), table_lens, 60)
    cameras = made.made.inputs[:1]
    views = [view for view in made.made.views if view.camera == cameras[0].name]
    return made, cameras, [replace(r, moving=False, body="") for r in made.made.rectangles], views


def test_one_camera_that_walks_past_still_sheets(alone):
    made, cameras, still, views = alone
    rig = calibrate(cameras, still, views)
    (said,) = [sentence for sentence in rig.weak if "moved past" in sentence]
    assert 'body = "room" in each' in said
    assert sum(bool(fit.rejected) for fit in rig.fits) < 0.1 * len(views)
    assert "room" in {body.name for body in rig.bodies}
    off = rig.cameras[0].intrinsics.focal - made.made.lenses[0][0]
    assert abs(off) < 4 * rig.focal_sigma(cameras[0].name)
    # What it is told is for one camera.
    assert not [s for s in weak_points(rig) if "clocks" in s or "all cameras" in s or "the cameras did" in s]


def test_what_is_said_of_a_room_is_not_said_again(alone):
    _, cameras, still, views = alone
    rig = calibrate(cameras, [replace(r, moving=True, body="room") for r in still], views)
    assert not [sentence for sentence in rig.weak if "moved past" in sentence]
