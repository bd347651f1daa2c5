"""Framesets left out: one Newton step says what a fit without them would have said."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.adjustment.levenberg_marquardt import adjust
from quadrig.rig.adjustment.normal_equations import linearise
from quadrig.rig.calibration import calibrate
from quadrig.rig.joint.cross_validation import cross_validate


def folds(problem, count=5):
    """The fold of each node, by its own rule: a fifth of the Views of moving rectangles in a row, others in turn."""
    views = np.bincount(problem.node, minlength=len(problem.nodes))
    framesets = sorted({node.frameset for node in problem.nodes if node.frameset >= 0})
    total = {f: sum(views[i] for i, node in enumerate(problem.nodes) if node.frameset == f) for f in framesets}
    before, number = 0, {}
    for frameset in framesets:
        number[frameset] = int(count * (before + total[frameset] / 2) / sum(total.values()))
        before += total[frameset]
    order = {key: index for index, key in enumerate(sorted(set(number.values())))}
    still = [i for i, node in enumerate(problem.nodes) if node.frameset < 0]
    return np.array(
        [
            still.index(i) % count if node.frameset < 0 else order[number[node.frameset]]
            for i, node in enumerate(problem.nodes)
        ]
    )


def refitted_squares(problem, joint):
    """Squared residuals (V,) px^2 of each View, for cameras fitted anew without its fold and a rectangle pose fitted
    to those cameras."""
    observations, free, state = joint.observations, joint.free, joint.adjustment.state
    fold, result = folds(problem)[observations.node], np.zeros(len(problem.views))
    for number in range(5):
        out = fold == number
        kept = [np.where(out[g.view][:, None], 0.0, g.weights) for g in observations.groups]
        cameras = adjust(observations.with_weights(kept), state, free, joint.noise).state
        held = replace(
            free,
            lens=np.zeros_like(free.lens),
            pose=np.zeros_like(free.pose),
            node=np.ones_like(free.node),
        )
        left = [np.where(out[g.view][:, None], g.weights, 0.0) for g in observations.groups]
        placed = adjust(observations.with_weights(left), cameras, held, joint.noise)
        squares = linearise(observations, placed.state, np.zeros(0, int), 1.0).squares
        for group, square in zip(observations.groups, squares, strict=True):
            sums = np.where(group.weights > 0, square, 0.0).sum(axis=1)
            result[group.view] = np.where(out[group.view], sums, result[group.view])
    return result


@pytest.mark.parametrize("board", [True, False])
def test_one_step_says_what_real_refits_say(simulated, board, jointly):
    made = simulated.simulate(41, simulated.Scene(cameras=3, framesets=30, board=board, distortion=board))
    problem, joint = jointly(made)
    quick, real = cross_validate(problem, joint).squares, refitted_squares(problem, joint)
    assert np.isfinite(quick).all()
    # Equal to second order: the fits with and without a fold are some tenths of a sigma apart.
    assert np.sqrt(quick.sum() / real.sum()) == pytest.approx(1, abs=0.004 if board else 0.01)
    # And View by View, so that no lucky sum is at work.
    assert np.corrcoef(quick, real)[0, 1] > 0.995


def test_what_was_not_seen_fits_worse_and_more_so_the_less_was_seen(simulated):
    made = simulated.simulate(42, simulated.Scene(cameras=3, framesets=40, board=False, distortion=False, tags=1))
    many = calibrate(made.inputs, made.rectangles, made.views)
    few = calibrate(made.inputs, made.rectangles, [v for v in made.views if v.frameset < 15])
    assert many.held_out_rms > many.rms
    assert few.held_out_rms / few.rms > many.held_out_rms / many.rms


def test_every_camera_has_its_own_figure(board_rig):
    _, rig = board_rig
    for camera in rig.cameras:
        assert np.isfinite(camera.held_out_rms)
        assert 0.8 * rig.rms < camera.held_out_rms < 1.5 * rig.held_out_rms


def test_a_lens_too_simple_shows_in_what_it_leaves_over(simulated):
    made = simulated.simulate(43, simulated.Scene(cameras=3, framesets=16))
    simple = calibrate([replace(c, lens="f") for c in made.inputs], made.rectangles, made.views)
    chosen = calibrate(made.inputs, made.rectangles, made.views)
    for camera in simple.cameras:
        assert camera.remainder > 5 * chosen.camera(camera.name).remainder
        assert any(camera.name in sentence and "lens model" in sentence for sentence in simple.weak)
    assert not any("lens model" in sentence for sentence in chosen.weak)


def test_one_frameset_cannot_be_left_out(simulated):
    made = simulated.simulate(44, simulated.Scene(cameras=3, framesets=20, board=False, distortion=False, tags=0))
    together = [[v for v in made.views if v.frameset == f] for f in range(20)]
    rig = calibrate(made.inputs, made.rectangles, max(together, key=len))
    assert np.isnan(rig.held_out_rms)


def test_the_folds_of_clean_rigs_disagree_as_noise_explains(simulated, jointly):
    """A mean of 1 over rigs of all kinds, and no camera widened by much."""
    found = []
    for seed in range(12):
        scene = simulated.usual_scene(np.random.default_rng(seed), board=seed % 3 < 2, distortion=seed % 3 == 0)
        found.append(cross_validate(*jointly(simulated.simulate(seed, scene))))
    every = np.concatenate([one.dispersion for one in found])
    assert np.mean(every) == pytest.approx(1, abs=4 * 0.15 / np.sqrt(len(found)))
    assert every.max() < 1.5


def test_a_board_that_bends_widens_the_doubt(simulated):
    """Halfway through the recording the board is bent by a millimetre: errors that no noise makes alike."""
    made = simulated.simulate(46, simulated.Scene(cameras=3, framesets=40, tags=0))
    middle = np.median([view.frameset for view in made.views])
    worse = []
    for view in made.views:
        across = view.points[:, 0] / np.abs(view.points[:, 0]).max()
        bend = 1.5 * across[:, None] ** 2 * [1.0, 0.0] if view.frameset > middle else 0.0
        worse.append(replace(view, pixels=view.pixels + bend))
    clean, bent = (calibrate(made.inputs, made.rectangles, views) for views in (made.views, worse))
    assert clean.dispersion < 1.2
    assert bent.dispersion > 1.5
    assert any("disagree" in sentence for sentence in bent.weak)
    assert bent.focal_sigma("cam1") > clean.focal_sigma("cam1") * np.sqrt(bent.dispersion)


def test_how_many_numbers_are_held_at_a_time_changes_nothing(simulated, jointly, monkeypatch):
    problem, joint = jointly(simulated.simulate(43, simulated.Scene(cameras=3, framesets=12, tags=1)))
    at_once = cross_validate(problem, joint).dispersion
    monkeypatch.setattr("quadrig.rig.joint.cross_validation._AT_ONCE", 1)
    # Sums in another order: rounding is all that may differ.
    assert cross_validate(problem, joint).dispersion == pytest.approx(at_once, rel=1e-8)
