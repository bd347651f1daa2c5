"""Motion averaging: loops close, single faults are cut off, and what is surer pulls more."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from quadrig.rig.start.motion_averaging import RelativePose, average
from quadrig.single.pose import Pose

CAMERAS = 8


def apart(first, second):
    """Rotation (rad) and distance (m) of each of two batches of poses."""
    step = first.step_to(second)
    return np.linalg.norm(step[:, :3], axis=1), np.linalg.norm(step[:, 3:], axis=1)


def relative(poses, left, right, step=None, sigma=0.01):
    """What is measured of two cameras: the truth, or a step away from it."""
    pose = poses[left] @ poses[right].inverse()
    return RelativePose(left, right, pose if step is None else pose.retract(np.asarray(step)), 5, 5, sigma)


@pytest.fixture
def poses():
    """camera_from_rig of eight cameras in a ring, the first of them the rig frame."""
    rng = np.random.default_rng(1)
    found = Pose.from_vectors(rng.normal(size=(CAMERAS, 3)), rng.uniform(-3, 3, (CAMERAS, 3)))
    return found @ found[0].inverse()


def ring(poses, **given):
    return [relative(poses, k, (k + 1) % CAMERAS, **given) for k in range(CAMERAS)]


def shaken(poses, size, seed=2):
    step = size * np.random.default_rng(seed).normal(size=(CAMERAS, 6))
    step[0] = 0
    return poses.retract(step)


def test_exact_relatives_give_the_truth_from_any_start_nearby(poses):
    more = [relative(poses, 0, 4), relative(poses, 2, 6)]
    found = average(shaken(poses, 0.2), [*ring(poses), *more], 0)
    # Rounds end where relatives agree to a share of their sigma of 0.01, and fall quadratically on the way.
    assert np.max(apart(found, poses)) < 1e-3
    np.testing.assert_allclose(found[0].matrix(), np.eye(4), atol=1e-9)


@pytest.mark.parametrize("reference", [0, 3])
def test_the_error_of_a_path_is_shared_out(poses, reference):
    """Each link is off by a little: a chain piles it up in the last one, an average finds the least squares."""
    links = ring(poses, step=[0, 0, 0.01, 0.02, 0, 0], sigma=0.01)
    chained = [np.eye(4)]
    for link in links[:-1]:
        chained.append(np.linalg.inv(link.left_from_right.matrix()) @ chained[-1])
    start = Pose.from_matrix(np.array(chained))
    start = start @ start[reference].inverse()

    def gaps(which):
        return np.stack([(which[k.left] @ which[k.right].inverse()).step_to(k.left_from_right) for k in links])

    def moved(step):
        return start.retract(np.insert(step, 6 * reference, np.zeros(6)).reshape(CAMERAS, 6))

    found = average(start, links, reference)
    least = least_squares(lambda step: gaps(moved(step)).ravel(), np.zeros(6 * (CAMERAS - 1))).cost
    # The gaps that are left are of two sigmas: Cauchy at five bends the squares by a few per cent.
    assert 0.5 * (gaps(found) ** 2).sum() == pytest.approx(least, rel=0.05)
    assert least < 0.3 * 0.5 * (gaps(start) ** 2).sum()
    np.testing.assert_allclose(found[reference].matrix(), np.eye(4), atol=1e-6)


def test_a_single_fault_is_cut_off(poses):
    links = [*ring(poses), *(relative(poses, k, (k + 2) % CAMERAS) for k in range(CAMERAS))]
    wrong = relative(poses, 2, 5, step=[0.5, -0.3, 0.4, 1.0, -0.5, 0.8])
    found = average(shaken(poses, 0.05), [*links, wrong], 0)
    # Cauchy's weight leaves the wrong one, a hundred sigmas off, a pull of a few hundredths of a sigma.
    assert np.max(apart(found, poses)) < 0.02


def test_surer_and_better_supported_links_pull_more(poses):
    """Twice the same pair, a centimetre apart: the middle lies where the weights have it."""
    there, here = np.array([0, 0, 0, 0.01, 0, 0]), np.zeros(6)
    links = ring(poses)
    pulls = {}
    for name, change in (("sure", {"sigma": 0.001}), ("supported", {"support": 1})):
        pair = [relative(poses, 0, 1, step=step, sigma=0.004) for step in (there, here)]
        pair[0 if name == "sure" else 1] = replace(pair[0 if name == "sure" else 1], **change)
        found = average(shaken(poses, 0.2), [*links[1:], *pair], 0)
        pulls[name] = np.linalg.norm((found[0] @ found[1].inverse()).step_to(pair[0].left_from_right)[3:])
    assert pulls["sure"] < 0.003
    assert pulls["supported"] < 0.003


def test_a_tree_has_nothing_to_average(poses):
    start = shaken(poses, 0.2)
    found = average(start, ring(poses)[:-1], 0)
    np.testing.assert_array_equal(found.translation, start.translation)
    np.testing.assert_array_equal(found.rotation, start.rotation)
