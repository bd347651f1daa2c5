"""The pose graph: components, the vote among candidates, chains, and loops that close."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.rig.joint.stages import Joint, solve_jointly
from quadrig.rig.problem.build import build_problem
from quadrig.rig.problem.connectivity import components
from quadrig.rig.start.lenses_and_poses import first_cameras
from quadrig.rig.start.pose_graph import first_rig, relative_poses
from quadrig.single.rotation import rotation_from_vector


def first_of(made, views=None, reference=0):
    problem = build_problem(made.inputs, made.rectangles, made.views if views is None else views)
    return problem, first_rig(problem, first_cameras(problem).candidates, reference)


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
    found = relative_poses(problem, first_cameras(problem).candidates)
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
