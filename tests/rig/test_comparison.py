"""Two rigs compared: frames do not matter, sigmas do, and one camera that moved does not smear over the others."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.comparison import compare, renamed
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
    assert found.chance(found.worst) == pytest.approx(1)
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
    assert found.chance(found.worst) > 1e-3
    there, back = compare(*halves), compare(*halves[::-1])
    for one, other in zip(there.cameras, back.cameras, strict=True):
        assert one.focal == pytest.approx(-other.focal)
        assert one.shift == pytest.approx(other.shift, rel=0.2)


def drawn(rig, rng):
    """A rig as sure as this one, and as far from the truth as that allows, where this one is the truth."""
    sizes, axes = np.linalg.eigh(rig.covariance)
    steps = (axes @ (np.sqrt(np.maximum(sizes, 0)) * rng.standard_normal(len(sizes)))).reshape(-1, CAMERA_PARAMETERS)
    cameras = tuple(
        replace(
            camera,
            intrinsics=camera.intrinsics.with_parameters(camera.intrinsics.parameters + step[:9]),
            rig_from_camera=camera.rig_from_camera.retract(step[9:]),
        )
        for camera, step in zip(rig.cameras, steps, strict=True)
    )
    return replace(rig, cameras=cameras)


def test_sound_rigs_are_seldom_called_different(rig):
    rng = np.random.default_rng(5)
    every = [compare(drawn(rig, rng), drawn(rig, rng)) for _ in range(50)]
    # One in a hundred by its level: more than four of fifty by chance once in five thousand such tests.
    assert sum(any(one.differs for one in found.cameras) for found in every) <= 4


@pytest.mark.parametrize("part", ["rotation", "position"])
def test_who_moved_is_called_different_and_nobody_else(rig, part):
    rng = np.random.default_rng(9)
    known = compare(rig, rig)
    called = []
    for _ in range(12):
        one, way = known.cameras[int(rng.integers(3))], rng.standard_normal(3)
        way *= 24 / np.linalg.norm(way)
        turn, shift = (way * one.rotation_sigma, 0 * way) if part == "rotation" else (0 * way, way * one.shift_sigma)
        found = compare(drawn(rig, rng), nudged(drawn(rig, rng), one.name, np.concatenate([turn, shift])))
        called.append([(other.name == one.name, *other.differs) for other in found.cameras if other.differs])
    # In its longest direction the doubt is some times its mean.
    assert sum(any(own and part in differs for own, *differs in each) for each in called) >= 11
    assert sum(not own for each in called for own, *_ in each) <= 1


def test_the_sigma_beside_a_difference_is_what_it_is_judged_by(rig):
    from scipy.stats import chi2

    rng = np.random.default_rng(2)
    for one in compare(drawn(rig, rng), drawn(rig, rng)).cameras:
        assert one.apart["rotation"].chance == pytest.approx(chi2.sf((one.rotation / one.rotation_sigma) ** 2, 3))
        assert one.apart["position"].chance == pytest.approx(chi2.sf((one.shift / one.shift_sigma) ** 2, 3))
        assert one.apart["focal"].chance == pytest.approx(chi2.sf((one.focal / one.focal_sigma) ** 2, 1))


def test_a_lens_that_changed_is_called_so(rig):
    cameras = list(rig.cameras)
    lens = cameras[1].intrinsics
    cameras[1] = replace(cameras[1], intrinsics=replace(lens, focal=lens.focal + 12 * rig.focal_sigma("cam1")))
    found = compare(rig, replace(rig, cameras=tuple(cameras)))
    assert {one.name: one.differs for one in found.cameras} == {"cam0": (), "cam1": ("focal",), "cam2": ()}


def test_given_lenses_that_are_not_the_same_differ(rig):
    covariance = rig.covariance.copy()
    covariance[:9] = covariance[:, :9] = 0
    fixed = replace(rig, covariance=covariance)
    lens = fixed.cameras[0].intrinsics
    other = replace(fixed.cameras[0], intrinsics=replace(lens, focal=lens.focal + 1))
    found = compare(fixed, replace(fixed, cameras=(other, *fixed.cameras[1:])))
    assert found.cameras[0].differs == ("focal",)
    assert compare(fixed, fixed).cameras[0].differs == ()


def test_single_cameras_are_compared_by_their_lens(rig):
    alone = replace(rig, cameras=rig.cameras[1:2], covariance=rig.covariance[15:30, 15:30])
    found = compare(alone, alone)
    assert np.isfinite(found.cameras[0].apart["focal"].chance)
    assert np.isnan([found.cameras[0].apart[part].chance for part in ("position", "rotation", "pose")]).all()


def test_cameras_of_other_names_are_renamed(rig):
    other = renamed(rig, {"cam0": "left", "cam1": "right"})
    with pytest.raises(QuadrigError, match="the first has cam0, cam1; the second left, right"):
        compare(
            replace(rig, cameras=rig.cameras[:2], covariance=rig.covariance[:30, :30]),
            replace(other, cameras=other.cameras[:2], covariance=other.covariance[:30, :30]),
        )
    assert compare(rig, other).only_second == ("left", "right")
    back = renamed(other, {"right": "cam1", "left": "cam0"})
    assert compare(rig, back).only_first == ()
    # Names that are swapped are no clash.
    assert [camera.name for camera in renamed(rig, {"cam0": "cam1", "cam1": "cam0"}).cameras] == [
        "cam1",
        "cam0",
        "cam2",
    ]
    with pytest.raises(QuadrigError, match="no camera 'cam7' to rename; the second rig has cam0, cam1, cam2"):
        renamed(rig, {"cam7": "cam0"})
    with pytest.raises(QuadrigError, match="would be called 'cam0'"):
        renamed(rig, {"cam2": "cam0"})


def test_cameras_without_partner_are_named(rig):
    less = replace(rig, cameras=rig.cameras[:2], covariance=rig.covariance[:30, :30])
    found = compare(rig, less)
    assert found.only_first == ("cam2",)
    assert found.only_second == ()
