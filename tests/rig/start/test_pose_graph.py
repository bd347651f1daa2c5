"""The pose graph: components, the vote among candidates, chains, and loops that close."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.rig.joint.stages import Joint, solve_jointly
from quadrig.rig.problem.build import build_problem
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.problem.connectivity import components
from quadrig.rig.start.lenses_and_poses import Candidates, first_cameras
from quadrig.rig.start.pose_graph import first_rig
from quadrig.rig.start.relative_poses import Sightings, relative_poses, sigmas
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.rotation import rotation_from_vector
from quadrig.single.view import View


def first_of(made, views=None, reference=0):
    problem = build_problem(made.inputs, made.rectangles, made.views if views is None else views)
    return problem, first_rig(problem, first_cameras(problem).candidates, reference)


def voted(problem, candidates):
    """The relative poses of cameras, by everything that two of them saw."""
    view = candidates.view
    camera, node = problem.camera[view], problem.node[view]
    return relative_poses(
        Sightings(camera, node, view, candidates.camera_from_rect, *sigmas(candidates), candidates.cost)
    )


def test_components_are_those_that_share(board_rig):
    made, _ = board_rig
    problem = build_problem(made.inputs, made.rectangles, made.views)
    assert components(problem) == [[0, 1, 2]]
    # The last camera keeps only framesets and rectangles that nobody else sees.
    views = [replace(v, frameset=v.frameset + 500) if v.camera == "cam2" else v for v in made.views]
    views = [v for v in views if v.camera != "cam2" or v.rectangle == "sheet"]
    problem = build_problem(made.inputs, made.rectangles, views)
    assert components(problem) == [[0, 1], [2]]


def test_from_clean_views_the_first_rig_is_near_the_truth_already(simulated):
    made = simulated.simulate(4, simulated.Scene(noise=0.01, distortion=False, principal=0.0))
    problem, first = first_of(made)
    assert first.connected.all()
    assert first.agrees.all()
    for index, camera in enumerate(problem.cameras):
        true = made.rig_from_camera("cam0", camera.name).inverse()
        step = first.camera_from_rig[index].step_to(true)
        assert np.linalg.norm(step[:3]) < 0.01
        assert np.linalg.norm(step[3:]) < 0.03


def test_the_vote_outweighs_wrong_edges(simulated):
    """A third of one camera's Views are another sheet's: the first rig is as if they were not there."""
    made = simulated.simulate(9, simulated.Scene(framesets=30, tags=0))
    rng = np.random.default_rng(0)
    own = [i for i, v in enumerate(made.views) if v.camera == "cam1"]
    wrong = {int(i) for i in rng.choice(own, len(own) // 3, replace=False)}
    views = list(made.views)
    for i in wrong:
        turn = rotation_from_vector(np.array([0, 0, rng.uniform(0.5, 3)]))[:2, :2]
        middle = views[i].pixels.mean(axis=0)
        views[i] = replace(views[i], pixels=(views[i].pixels - middle) @ turn.T + rng.uniform([300, 200], [900, 500]))
    problem, first = first_of(made, views)
    key = {(views[i].camera, views[i].frameset) for i in wrong}
    for index, view in enumerate(problem.views):
        alone = sum(v.frameset == view.frameset for v in problem.views) < 3
        if (view.camera, view.frameset) in key and not alone:
            assert not first.agrees[index]
    for index, camera in enumerate(problem.cameras):
        step = first.camera_from_rig[index].step_to(made.rig_from_camera("cam0", camera.name).inverse())
        assert np.linalg.norm(step[:3]) < 0.1


def test_any_camera_may_be_the_first(board_rig):
    made, _ = board_rig
    for reference in range(3):
        problem, first = first_of(made, reference=reference)
        name = problem.cameras[reference].name
        np.testing.assert_allclose(first.camera_from_rig[reference].matrix(), np.eye(4), atol=1e-12)
        for index, camera in enumerate(problem.cameras):
            step = first.camera_from_rig[index].step_to(made.rig_from_camera(name, camera.name).inverse())
            # Principal points are off by 25 px of a thousand, and that is all that is.
            assert np.linalg.norm(step[:3]) < 0.1


def test_relatives_tell_how_many_support_them(board_rig):
    made, _ = board_rig
    problem = build_problem(made.inputs, made.rectangles, made.views)
    found = voted(problem, first_cameras(problem).candidates)
    assert {(r.left, r.right) for r in found} == {(0, 1), (0, 2), (1, 2)}
    for relative in found:
        assert 0 < relative.support <= relative.voters
        assert relative.sigma > 0


def test_a_large_ring_closes(simulated):
    """Chains round both sides meet opposite the reference: the Views there hold the ring together, none is thrown
    out."""
    made = simulated.ring(32, 12)
    rig = calibrate(made.inputs, made.rectangles, made.views)
    assert not [fit for fit in rig.fits if fit.rejected]
    opposite = rig.camera("cam16")
    step = opposite.rig_from_camera.step_to(made.rig_from_camera("cam0", "cam16"))
    covariance = rig.pose_covariance("cam16")
    assert np.sqrt(step @ np.linalg.solve(covariance, step) / 6) < 2.2
    assert rig.noise == pytest.approx(made.noise, rel=0.05)


def test_views_that_the_first_lenses_belied_are_taken_back(simulated):
    """Right Views that the vote left out, here all of one tag and all at one camera's left, are in the end used."""
    made = simulated.simulate(47, simulated.Scene(cameras=3, framesets=20))
    problem, first = first_of(made)
    belied = [v.rectangle == "tag0" or (v.camera == "cam1" and v.pixels[:, 0].max() < 500) for v in problem.views]
    assert np.any(belied)
    standing = np.arange(len(problem.cameras)) == 0
    joint = solve_jointly(
        problem, first_cameras(problem), replace(first, agrees=first.agrees & ~np.array(belied)), standing
    )
    assert isinstance(joint, Joint)
    assert not joint.inliers.rejected.any()


SHEET, TAG = Rectangle("sheet", 0.3, 0.2, moving=True), Rectangle("tag", 0.2, 0.2)
# Where two cameras have one rectangle pose.
HERE = Pose.from_vectors(np.array([0.2, 0.1, -0.3]), np.array([0.1, 0.0, 1.5]))
THERE = Pose.from_vectors(np.array([-0.1, 0.4, 0.2]), np.array([-0.2, 0.1, 1.8]))


def told(rows, rectangles=(SHEET, TAG)):
    """A problem and the candidates of its Views.

    rows: (camera, rectangle, frameset, [(camera_from_rect, cost, sigma)]).
    """
    views = [View(r, SHEET.corners, 1e3 * SHEET.corners[:, :2], camera, frameset) for camera, r, frameset, _ in rows]
    names = sorted({camera for camera, *_ in rows})
    problem = build_problem([CameraInput(name, 640, 480) for name in names], rectangles, views)
    own = {(camera, rectangle, frameset): found for camera, rectangle, frameset, found in rows}
    every = [(k, *one) for k, v in enumerate(problem.views) for one in own[v.camera, v.rectangle, v.frameset]]
    view, poses, cost, sigma = zip(*every, strict=True)
    batch = Pose(np.stack([p.rotation for p in poses]), np.stack([p.translation for p in poses]))
    covariance = np.array(sigma)[:, None, None] ** 2 * np.eye(6)
    return problem, Candidates(np.array(view), np.zeros(len(view), int), batch, covariance, np.array(cost))


def turned(pose, angle):
    return pose.retract(np.array([0, angle, 0, 0, 0, 0]))


def test_of_one_rectangle_that_two_cameras_share_the_likeliest_candidates_of_both_decide():
    twins = [(turned(pose, 0.8), 6.0, 0.001) for pose in (HERE, THERE)]
    rows = [("a", "sheet", 0, [(HERE, 0.0, 0.001), twins[0]]), ("b", "sheet", 0, [(THERE, 0.0, 0.001), twins[1]])]
    (relative,) = voted(*told(rows))
    assert (relative.support, relative.voters) == (1, 1)
    assert np.abs((HERE @ THERE.inverse()).step_to(relative.left_from_right)).max() < 1e-12


def test_candidates_of_more_rectangles_outvote_the_likeliest_of_one():
    """In each frameset the wrong tilts are the likelier ones, but only the right ones agree with one another."""
    rows = []
    for frameset in range(3):
        moved = Pose.from_vectors(np.array([0.3, -0.2, 0.4]) * frameset, np.array([0.1, 0.2, 0.3]) * frameset)
        for camera, pose in (("a", HERE @ moved), ("b", THERE @ moved)):
            wrong = turned(pose, 0.5 + 0.2 * frameset)
            rows.append((camera, "sheet", frameset, [(wrong, 0.0, 0.001), (pose, 1.0, 0.001)]))
    problem, candidates = told(rows)
    (relative,) = voted(problem, candidates)
    assert (relative.support, relative.voters) == (3, 3)
    assert np.abs((HERE @ THERE.inverse()).step_to(relative.left_from_right)).max() < 1e-9
    first = first_rig(problem, candidates, 0)
    assert first.agrees.all()
    assert np.abs(first.camera_from_rig[1].step_to(THERE @ HERE.inverse())).max() < 1e-9


def test_surer_rectangles_pull_more():
    """Two framesets, a tenth of a radian apart, one ten times as sure: weights by inverse variance."""
    sigmas, angle = (0.02, 0.2), 0.1
    rows = [
        (camera, "sheet", k, [(turned(pose, angle * k) if camera == "a" else pose, 0.0, sigma)])
        for k, sigma in enumerate(sigmas)
        for camera, pose in (("a", HERE), ("b", THERE))
    ]
    (relative,) = voted(*told(rows))
    step = (HERE @ THERE.inverse()).step_to(relative.left_from_right)
    # Both cameras' three rotations.
    variance = [2 * 3 * sigma**2 for sigma in sigmas]
    assert np.linalg.norm(step[:3]) == pytest.approx(angle * variance[0] / sum(variance), rel=0.02)
    assert relative.support == 2
    one = voted(*told(rows[:2]))[0]
    assert relative.sigma < one.sigma < 1.02 * relative.sigma


def test_a_rectangle_that_one_camera_alone_sees_stands_where_most_of_its_views_have_it():
    """Another tilt that is a little likelier each time, but another each time."""
    rows = [
        ("a", "tag", k, [(turned(HERE, 0.4 + 0.3 * k), 0.0, 0.001)] if k == 2 else [(HERE, 0.0, 0.002)])
        for k in range(5)
    ]
    problem, candidates = told(rows)
    first = first_rig(problem, candidates, 0)
    assert np.abs(first.rig_from_body[0].step_to(HERE)).max() < 1e-9
    assert [view.frameset for view, agrees in zip(problem.views, first.agrees, strict=True) if not agrees] == [2]


def test_one_other_camera_says_more_than_many_views_of_the_same():
    """Camera a sees the tag's twin again and again; b sees it once, and the two are joined by the sheet."""
    camera_b = THERE @ HERE.inverse()
    twin = turned(HERE, 0.6)
    rows = [("a", "tag", k, [(twin, 0.0, 0.001), (HERE, 1.0, 0.001)]) for k in range(6)]
    rows += [("b", "tag", 0, [(camera_b @ HERE, 0.0, 0.001)])]
    for k in range(3):
        moved = Pose.from_vectors(np.array([0.3, -0.2, 0.4]) * k, np.array([0.1, 0.2, 0.3]) * k)
        rows += [(name, "sheet", 10 + k, [(p @ moved, 0.0, 0.001)]) for name, p in (("a", HERE), ("b", THERE))]
    problem, candidates = told(rows)
    first = first_rig(problem, candidates, 0)
    tag = next(index for index, node in enumerate(problem.nodes) if node.body == "tag")
    assert np.abs(first.rig_from_body[tag].step_to(HERE)).max() < 1e-6
    assert first.agrees.all()


def test_a_camera_that_nothing_joins_stays_apart():
    rows = [(name, "sheet", k, [(p, 0.0, 0.001)]) for name, k, p in (("a", 0, HERE), ("b", 0, THERE), ("c", 1, HERE))]
    first = first_rig(*told(rows), 1)
    assert first.connected.tolist() == [True, True, False]
    np.testing.assert_allclose(first.camera_from_rig[1].matrix(), np.eye(4), atol=1e-12)


# Of a candidate whose six numbers have a sigma of 0.02 each.
ROTATION_SIGMA = POSITION_SIGMA = np.sqrt(3 * 0.02**2)


def shifted(pose, metres):
    return pose.retract(np.array([0, 0, 0, 0, metres, 0]))


@pytest.mark.parametrize(("sigmas", "agree"), [(3.8, True), (4.2, False)])
@pytest.mark.parametrize("change", ["rotation", "position"])
def test_a_view_agrees_up_to_four_common_sigmas(change, sigmas, agree):
    """A tag that stands still, seen three times alike by a camera and once from elsewhere."""
    size = sigmas * np.sqrt(2) * (ROTATION_SIGMA if change == "rotation" else POSITION_SIGMA)
    off = turned(HERE, size) if change == "rotation" else shifted(HERE, size)
    problem, candidates = told([("a", "tag", k, [(off if k == 3 else HERE, 0.0, 0.02)]) for k in range(4)])
    first = first_rig(problem, candidates, 0)
    assert np.abs(first.rig_from_body[0].step_to(HERE)).max() < 1e-9
    assert first.agrees.tolist() == [view.frameset < 3 or agree for view in problem.views]


@pytest.mark.parametrize(("sigmas", "support"), [(3.8, 4), (4.2, 3)])
def test_rectangles_support_two_cameras_up_to_four_common_sigmas(sigmas, support):
    """In the last of four framesets one camera has the sheet where it shows the other turned in its place."""
    size = sigmas * np.sqrt(2) * np.sqrt(2) * ROTATION_SIGMA
    off = turned(HERE @ THERE.inverse(), size) @ THERE
    rows = [
        (name, "sheet", k, [(off if (name, k) == ("a", 3) else pose, 0.0, 0.02)])
        for k in range(4)
        for name, pose in (("a", HERE), ("b", THERE))
    ]
    (relative,) = voted(*told(rows))
    assert (relative.support, relative.voters) == (support, 4)


def test_an_edge_that_a_small_share_supports_is_taken_only_where_no_better_way_leads():
    """Of what a and c share a third agrees on a wrong tilt; what each shares with b agrees, though it is less."""
    rng = np.random.default_rng(1)
    still, camera_b, camera_c = Pose.identity(), THERE @ HERE.inverse(), turned(THERE, 0.3) @ HERE.inverse()

    def rows_of(pair, framesets, change):
        for k in framesets:
            place = HERE @ Pose.from_vectors(0.3 * rng.normal(size=3), 0.3 * rng.normal(size=3))
            for camera, pose in pair:
                yield camera, "sheet", k, [(change(k, camera, pose @ place), 0.0, 0.001)]

    def as_it_is(_, __, pose):
        return pose

    def wrong(k, camera, pose):
        if k % 3:
            return pose.retract(0.5 * rng.normal(size=6))
        return turned(still, 0.4) @ pose if camera == "c" else pose

    rows = [*rows_of([("a", still), ("b", camera_b)], range(4), as_it_is)]
    rows += [*rows_of([("b", camera_b), ("c", camera_c)], range(4, 8), as_it_is)]
    rows += [*rows_of([("a", still), ("c", camera_c)], range(9, 24), wrong)]
    problem, candidates = told(rows)
    supports = {(r.left, r.right): (r.support, r.voters) for r in voted(problem, candidates)}
    assert supports == {(0, 1): (4, 4), (1, 2): (4, 4), (0, 2): (5, 15)}
    first = first_rig(problem, candidates, 0)
    # The average of all three is drawn to the wrong one by less than a tenth of what that is off.
    assert np.abs(first.camera_from_rig[2].step_to(camera_c)).max() < 0.04
