"""Two rigs compared: frames do not matter, sigmas do, and one camera that moved does not smear over the others."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.comparison import compare
from quadrig.rig.result import CAMERA_PARAMETERS
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose


def seen_from_elsewhere(rig, frame_from_rig):
    """The same rig with its poses and covariance in another frame."""
    turn = np.eye(CAMERA_PARAMETERS)
    turn[9:12, 9:12] = turn[12:, 12:] = frame_from_rig.rotation
    turn = np.kron(np.eye(len(rig.cameras)), turn)
    cameras = tuple(replace(c, rig_from_camera=frame_from_rig @ c.rig_from_camera) for c in rig.cameras)
    return replace(rig, cameras=cameras, covariance=turn @ rig.covariance @ turn.T)


def nudged(rig, name, step):
    cameras = tuple(
        replace(c, rig_from_camera=c.rig_from_camera.retract(step)) if c.name == name else c for c in rig.cameras
    )
    return replace(rig, cameras=cameras)


@pytest.fixture(scope="module")
def rig(board_rig):
    return board_rig[1]


def test_a_rig_equals_itself_in_any_frame(rig):
    elsewhere = Pose.from_vectors(np.array([0.4, -1.2, 0.7]), np.array([3.0, -2.0, 1.0]))
    found = compare(rig, seen_from_elsewhere(rig, elsewhere))
    assert found.chance == pytest.approx(1)
    for one in found.cameras:
        assert one.shift < 1e-9
        assert one.rotation < 1e-9
        assert one.shift_sigma > 0
    np.testing.assert_allclose((found.first_from_second @ elsewhere).matrix(), np.eye(4), atol=1e-9)


def test_one_camera_that_moved_stands_out(simulated):
    from quadrig.rig.calibration import calibrate

    made = simulated.simulate(3, simulated.Scene(cameras=5, framesets=15, tags=0))
    rig = calibrate(made.inputs, made.rectangles, made.views)
    step = np.array([0.02, 0, 0.01, 0.1, -0.05, 0.05])
    found = compare(rig, nudged(rig, "cam2", step))
    shifts = {one.name: one.shift for one in found.cameras}
    assert max(shifts, key=lambda name: shifts[name]) == "cam2"
    assert shifts["cam2"] > 3 * max(shift for name, shift in shifts.items() if name != "cam2")


def test_calibrations_of_other_views_agree_within_sigmas(simulated):
    from quadrig.rig.calibration import calibrate

    made = simulated.simulate(8, simulated.Scene(cameras=3, framesets=24, tags=0))
    halves = [
        calibrate(made.inputs, made.rectangles, [view for view in made.views if view.frameset % 2 == part])
        for part in (0, 1)
    ]
    found = compare(*halves)
    # Once in a thousand such tests a true rig would fail this.
    assert found.chance > 1e-3
    there, back = compare(*halves), compare(*halves[::-1])
    for one, other in zip(there.cameras, back.cameras, strict=True):
        assert one.focal == pytest.approx(-other.focal)
        assert one.shift == pytest.approx(other.shift, rel=0.2)


def test_cameras_without_partner_are_named(rig):
    less = replace(rig, cameras=rig.cameras[:2], covariance=rig.covariance[:30, :30])
    found = compare(rig, less)
    assert found.only_first == ("cam2",)
    assert found.only_second == ()
    with pytest.raises(QuadrigError, match="fewer than two"):
        compare(rig, replace(rig, cameras=rig.cameras[:1], covariance=rig.covariance[:15, :15]))
