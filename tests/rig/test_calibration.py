"""From Views to a Rig: near the truth, the same in any order and frame, with what is given kept."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics
from quadrig.single.rectangle import WORLD
from quadrig.single.rotation import vector_from_rotation


def solved(made, **given):
    return calibrate(made.inputs, made.rectangles, made.views, **given)


def in_sigmas(made, rig):
    """Mahalanobis distance of each camera's pose from the truth, as a multiple of what six numbers have by chance."""
    found = []
    for camera in rig.cameras:
        if camera.name != rig.reference:
            step = camera.rig_from_camera.step_to(made.rig_from_camera(rig.reference, camera.name))
            covariance = rig.pose_covariance(camera.name)
            found.append(np.sqrt(step @ np.linalg.solve(covariance, step) / 6))
    return np.array(found)


def same_rig(a, b, atol):
    assert {c.name for c in a.cameras} == {c.name for c in b.cameras}
    for camera in a.cameras:
        other = b.camera(camera.name)
        np.testing.assert_allclose(camera.intrinsics.parameters, other.intrinsics.parameters, rtol=atol, atol=atol)
        np.testing.assert_allclose(camera.rig_from_camera.rotation, other.rig_from_camera.rotation, atol=atol)
        np.testing.assert_allclose(camera.rig_from_camera.translation, other.rig_from_camera.translation, atol=atol)


def test_the_truth_is_within_the_doubt(board_rig):
    made, rig = board_rig
    assert len(rig.cameras) == 3
    assert not rig.missing
    # 2.2 of six numbers is passed by chance once in ten thousand.
    assert (in_sigmas(made, rig) < 2.2).all()
    for camera in rig.cameras:
        error = camera.intrinsics.focal - made.lenses[made.index(camera.name), 0]
        assert abs(error) < 4.5 * rig.focal_sigma(camera.name)
    assert rig.noise == pytest.approx(made.noise, rel=0.1)
    assert rig.rms < rig.held_out_rms < 1.2 * rig.rms


def test_rectangles_stand_where_they_stood(board_rig):
    made, rig = board_rig
    rig_from_world = made.world_from_camera[made.index(rig.reference)].inverse()
    for placed in rig.rectangles:
        world_from_rect = made.world_from_rect[placed.name]
        true = rig_from_world @ (world_from_rect[placed.framesets] if placed.rectangle.moving else world_from_rect)
        step = placed.rig_from_rect.step_to(true)
        sigma = np.sqrt(np.diagonal(placed.covariance, axis1=-2, axis2=-1))
        assert (np.abs(step) < 6 * sigma).all()


def test_quads_alone_make_a_rig(simulated):
    made = simulated.simulate(5, simulated.Scene(board=False, distortion=False, framesets=30, noise=0.2))
    rig = solved(made)
    assert len(rig.cameras) == 4
    assert (in_sigmas(made, rig) < 2.2).all()


def test_with_hardly_any_noise_the_rig_is_exact(simulated):
    made = simulated.simulate(6, simulated.Scene(cameras=3, framesets=10, noise=1e-4, principal=0.01))
    # So little noise is not expected of any detector: it is given.
    made = replace(made, views=tuple(replace(view, sigma=made.noise) for view in made.views))
    found = simulated.errors(made, solved(made))
    assert found.focal < 1e-3
    assert found.rotation < 1e-3
    # Shapes of sheets and what lenses leave over are unknowns too, and may be ten times so little noise: a
    # fifty-thousandth of the rig's size.
    assert found.centre < 0.05


def test_the_order_of_cameras_rectangles_and_views_does_not_matter(board_rig):
    made, rig = board_rig
    rng = np.random.default_rng(0)

    def shuffled(things):
        return [things[i] for i in rng.permutation(len(things))]

    other = calibrate(shuffled(made.inputs), shuffled(made.rectangles), shuffled(made.views), reference=rig.reference)
    same_rig(rig, other, 1e-9)
    assert other.rms == pytest.approx(rig.rms, abs=1e-9)
    assert other.working_accuracy == pytest.approx(rig.working_accuracy, rel=1e-9)
    order = [rig.camera_index(c.name) for c in other.cameras]
    index = (np.array(order)[:, None] * 15 + np.arange(15)).ravel()
    np.testing.assert_allclose(other.covariance, rig.covariance[np.ix_(index, index)], rtol=1e-6, atol=1e-15)


def test_every_run_is_the_same_to_the_last_bit(board_rig):
    made, rig = board_rig
    again = solved(made)
    same_rig(rig, again, 0)
    np.testing.assert_array_equal(rig.covariance, again.covariance)


def test_where_the_rig_frame_stands_changes_no_relative_figure(board_rig):
    made, rig = board_rig
    for reference in ("cam2", "tag0"):
        other = solved(made, reference=reference)
        assert other.reference == reference
        # The adjustment stops a thousandth of a sigma from the minimum, wherever it comes from, and what it expects
        # of noise and lenses is learned to a thousandth: of that a tenth.
        assert other.working_accuracy == pytest.approx(rig.working_accuracy, rel=1e-4)
        # At a minimum the residuals go with the square of that.
        assert other.rms == pytest.approx(rig.rms, rel=1e-6)
        assert other.held_out_rms == pytest.approx(rig.held_out_rms, rel=1e-5)
        assert other.noise == pytest.approx(rig.noise, rel=1e-6)
        world = rig.cameras[0].name
        for camera in rig.cameras[1:]:
            there = other.camera(world).rig_from_camera.inverse() @ other.camera(camera.name).rig_from_camera
            step, sigma = (
                camera.rig_from_camera.step_to(there),
                np.sqrt(np.diagonal(rig.pose_covariance(camera.name))),
            )
            assert (np.abs(step) < 2e-3 * sigma).all()
            # How sure two cameras are of one another is the same in every frame.
            told, here = (r.relative_covariance(world, camera.name) for r in (rig, other))
            np.testing.assert_allclose(here, told, atol=1e-4 * np.abs(told).max())
            np.testing.assert_allclose(told, rig.pose_covariance(camera.name), atol=1e-12)
            assert other.focal_sigma(camera.name) == pytest.approx(rig.focal_sigma(camera.name), rel=1e-4)


def test_the_reference_is_the_rig_frame(board_rig):
    made, rig = board_rig
    reference = rig.camera(rig.reference)
    np.testing.assert_allclose(reference.rig_from_camera.matrix(), np.eye(4), atol=1e-12)
    np.testing.assert_array_equal(rig.pose_covariance(rig.reference), 0)
    tag = next(r for r in solved(made, reference="tag1").rectangles if r.name == "tag1")
    np.testing.assert_allclose(tag.rig_from_rect.matrix(), np.eye(4), atol=1e-12)
    np.testing.assert_allclose(tag.covariance, 0, atol=1e-15)


def test_surveyed_rectangles_put_the_rig_into_the_world(simulated):
    made = simulated.simulate(12, simulated.Scene(cameras=3, framesets=12, tags=3))
    rectangles = [
        r if r.moving else replace(r, body=WORLD, body_from_rect=made.world_from_rect[r.name])
        for r in made.rectangles
    ]
    rig = calibrate(made.inputs, rectangles, made.views, reference="tag1")
    for camera in rig.cameras:
        true = made.world_from_camera[made.index(camera.name)]
        step, covariance = camera.rig_from_camera.step_to(true), rig.pose_covariance(camera.name)
        assert np.sqrt(step @ np.linalg.solve(covariance, step) / 6) < 2.2
    for placed in rig.rectangles:
        if not placed.rectangle.moving:
            world = made.world_from_rect[placed.name]
            np.testing.assert_allclose(placed.rig_from_rect.matrix(), world.matrix(), atol=1e-12)
    # Three tags whose places are known tell more than three that are not.
    unsurveyed = solved(made, reference="tag1")
    assert sum(rig.position_sigma(c.name) for c in rig.cameras) < sum(
        unsurveyed.position_sigma(c.name) for c in rig.cameras
    )


def test_a_fixed_lens_stays_to_the_last_bit_and_has_no_doubt(board_rig):
    made, _ = board_rig
    given = Intrinsics.centred(1280, 720, 1.0).with_parameters(made.lenses[1])
    inputs = list(made.inputs)
    inputs[1] = CameraInput("cam1", 1280, 720, given, fixed=True)
    rig = calibrate(inputs, made.rectangles, made.views)
    np.testing.assert_array_equal(rig.camera("cam1").intrinsics.parameters, given.parameters)
    np.testing.assert_array_equal(rig.lens_covariance("cam1"), 0)
    assert rig.camera("cam1").free_lens == ()
    assert (in_sigmas(made, rig) < 2.2).all()


def test_fisheye_cameras_need_only_a_first_guess(simulated):
    made = simulated.simulate(2, simulated.Scene(cameras=3, model="fisheye", focals=(400, 500)))
    rig = solved(made)
    assert all(c.intrinsics.model == "fisheye" for c in rig.cameras)
    assert (in_sigmas(made, rig) < 2.2).all()
    assert rig.noise == pytest.approx(made.noise, rel=0.1)


def test_a_camera_that_has_two_views_of_a_still_tag_in_one_frameset_uses_both(board_rig):
    made, rig = board_rig
    tag = next(v for v in made.views if v.rectangle == "tag0")
    again = calibrate(made.inputs, made.rectangles, [*made.views, replace(tag, frameset=999)])
    assert sum(c.views for c in again.cameras) == sum(c.views for c in rig.cameras) + 1


def half_turned(view):
    """The same pixels, the points of a chessboard read from the other end."""
    other = view.points * [-1, -1, 1]
    return replace(view, points=other, alternatives=(view.points,))


def test_symmetric_boards_settle_by_the_vote_of_the_rig(board_rig):
    made, rig = board_rig
    rng = np.random.default_rng(1)
    views, turned = [], {}
    for view in made.views:
        if view.rectangle != "sheet":
            views.append(view)
            continue
        turned[view.camera, view.frameset] = bool(rng.integers(2))
        both = replace(view, alternatives=(view.points * [-1, -1, 1],))
        views.append(half_turned(view) if turned[view.camera, view.frameset] else both)
    found = calibrate(made.inputs, made.rectangles, views)
    same_rig(rig, found, 1e-5)
    # In each frameset all cameras read the board from one end, whichever it is.
    ends: dict[int, set[bool]] = {}
    for fit in found.fits:
        if fit.view.rectangle == "sheet":
            assert not fit.rejected
            end = turned[fit.view.camera, fit.view.frameset] ^ bool(fit.reading)
            ends.setdefault(fit.view.frameset, set()).add(end)
    assert all(len(found) == 1 for found in ends.values())


def test_mirror_twins_settle_by_the_vote_of_the_rig(simulated):
    """Small sheets far away: many a View's likelier tilt is the wrong one, yet all end the right way round."""
    from quadrig.rig.problem.build import build_problem
    from quadrig.rig.start.lenses_and_poses import first_cameras

    scene = simulated.Scene(board=False, distortion=False, framesets=30, noise=0.6, tags=3, principal=0.005)
    made = simulated.simulate(21, scene)
    problem = build_problem(made.inputs, made.rectangles, made.views)
    candidates = first_cameras(problem).candidates
    assert len(candidates.view) > 1.1 * len(problem.views)
    rig = solved(made)
    assert not [fit for fit in rig.fits if fit.rejected]
    rig_from_world = made.world_from_camera[made.index(rig.reference)].inverse()
    for placed in rig.rectangles:
        world = made.world_from_rect[placed.name]
        true = rig_from_world @ (world[placed.framesets] if placed.rectangle.moving else world)
        shared = np.array(
            [
                len({f.view.camera for f in rig.fits if f.view.rectangle == placed.name and f.view.frameset == k}) > 1
                for k in placed.framesets
            ]
        )
        turn = vector_from_rotation(placed.rig_from_rect.rotation @ np.swapaxes(true.rotation, -1, -2))
        angle = np.degrees(np.linalg.norm(turn, axis=-1))
        assert np.max(angle[shared] if placed.rectangle.moving else angle) < 10


def wrong_id(views):
    """The first sheet and tag that one camera sees at one instant change names."""
    for view in views:
        for other in views:
            same = (view.camera, view.frameset) == (other.camera, other.frameset)
            if same and view.rectangle == "tag0" and other.rectangle == "tag1":
                return view, other
    raise AssertionError("no camera sees both tags at once")


def test_wrong_views_are_named_and_cost_nothing(simulated):
    made = simulated.simulate(31, simulated.Scene(framesets=24, tags=2))
    clean = simulated.errors(made, solved(made))
    a, b = wrong_id(made.views)
    shifted = next(v for v in made.views if v.rectangle == "tag0" and v.camera != a.camera)
    pulled = next(v for v in made.views if v.rectangle == "sheet")
    far = pulled.pixels.copy()
    far[3] += [14, -14]
    changed = {
        id(a): replace(a, pixels=b.pixels),
        id(b): replace(b, pixels=a.pixels),
        id(shifted): replace(shifted, pixels=np.roll(shifted.pixels, 1, axis=0)),
        id(pulled): replace(pulled, pixels=far),
    }
    rig = calibrate(made.inputs, made.rectangles, [changed.get(id(v), v) for v in made.views])
    found = simulated.errors(made, rig)
    assert found.focal < 1.3 * clean.focal + 0.02
    assert found.centre < 1.3 * clean.centre + 0.5

    def key(view):
        return view.camera, view.rectangle, view.frameset

    thrown = {key(fit.view): fit.rejected for fit in rig.fits if fit.rejected}
    assert thrown.keys() == {key(a), key(b), key(shifted)}
    assert "order" in thrown[key(shifted)]
    (fit,) = [fit for fit in rig.fits if key(fit.view) == key(pulled)]
    assert np.flatnonzero(~fit.used).tolist() == [3]
    assert any("were rejected" in sentence for sentence in rig.weak)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda v: replace(v, camera="nobody"), "nobody"),
        (lambda v: replace(v, rectangle="nothing"), "nothing"),
        (lambda v: replace(v, pixels=v.pixels[:-1]), "do not match"),
        (lambda v: replace(v, pixels=v.pixels * np.nan), "not a number"),
        (lambda v: replace(v, sigma=0.0), "sigma"),
    ],
)
def test_a_broken_view_is_refused_by_name(board_rig, change, words):
    made, _ = board_rig
    views = [change(made.views[0]), *made.views[1:]]
    with pytest.raises(QuadrigError, match=words):
        calibrate(made.inputs, made.rectangles, views)


def test_names_that_repeat_are_refused(board_rig):
    made, _ = board_rig
    with pytest.raises(QuadrigError, match="cam0"):
        calibrate([*made.inputs, made.inputs[0]], made.rectangles, made.views)


def test_a_reference_that_cannot_be_one_is_refused(board_rig):
    made, _ = board_rig
    with pytest.raises(QuadrigError, match="neither a camera nor a rectangle"):
        solved(made, reference="door")
    with pytest.raises(QuadrigError, match="moves"):
        solved(made, reference="sheet")


@pytest.mark.parametrize("value", [1e200, -1e9])
def test_a_view_that_is_in_no_picture_is_left_out_and_named(board_rig, value):
    made, _ = board_rig
    broken, *others = made.views
    pixels = broken.pixels.copy()
    pixels[0, 0] = value
    rig = calibrate(made.inputs, made.rectangles, [replace(broken, pixels=pixels), *others])
    same_rig(rig, calibrate(made.inputs, made.rectangles, others), 1e-12)
    (said,) = [sentence for sentence in rig.weak if "is left out" in sentence]
    assert f"by {broken.camera!r} in frameset {broken.frameset} is left out: a coordinate is {abs(value):g}" in said


@pytest.mark.parametrize(("scale", "shift"), [(0.0, 0.0), (1e-200, 0.0), (0.0, 400.0)])
def test_a_view_all_in_one_pixel_is_left_out_and_named(board_rig, scale, shift):
    made, _ = board_rig
    broken, *others = made.views
    rig = calibrate(made.inputs, made.rectangles, [replace(broken, pixels=scale * broken.pixels + shift), *others])
    same_rig(rig, calibrate(made.inputs, made.rectangles, others), 1e-12)
    (said,) = [sentence for sentence in rig.weak if "is left out" in sentence]
    assert f"its {len(broken.pixels)} corners lie within 0.0 px" in said


def test_a_board_that_was_carried_and_is_said_to_stand_is_no_accident(board_rig):
    """More points than a first fit takes, of which most contradict it."""
    made, _ = board_rig
    still = [replace(one, moving=False) for one in made.rectangles]
    rig = calibrate(made.inputs, still, made.views)
    assert sum(bool(fit.rejected) for fit in rig.fits) > 0
    assert rig.weak
