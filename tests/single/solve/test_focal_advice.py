"""What is promised of a better View is what such a View gives, and only what is worth the trouble is said."""

import re

import numpy as np
import pytest

from quadrig.single.pose import Pose
from quadrig.single.rectangle import rectangle_corners
from quadrig.single.rotation import rotation_from_angles
from quadrig.single.solve.cramer_rao import cramer_rao
from quadrig.single.solve.focal_advice import focal_advice, percent, view_tilt
from quadrig.single.solve.maximum_likelihood import solve_rectangles

SIZE, CENTRE, FOCAL, NOISE = (1920, 1080), np.array([959.5, 539.5]), 1400.0, 0.5
CORNERS = rectangle_corners(0.297, 0.21)


def held(tilt, distance):
    return Pose(rotation_from_angles(np.radians(tilt), 0.0, 0.3), np.array([0.0, 0.0, distance]))


def solved(pose, draws, centre_sigma=0.0):
    """The sheet solved from draws of noise; the principal point strays with them."""
    rng = np.random.default_rng(1)
    located = pose.transform(CORNERS)
    pixels = (
        FOCAL * located[:, :2] / located[:, 2:]
        + CENTRE
        + draws[:, None, None] * rng.normal(0, NOISE, (len(draws), 4, 2))
    )
    pixels += draws[:, None, None] * centre_sigma * rng.normal(size=(len(draws), 1, 2))
    return solve_rectangles(pixels, 0.297, 0.21, CENTRE, sigma=NOISE, principal_point_sigma=centre_sigma)


def scatter(pose, centre_sigma=0.0):
    """The share of the focal by which 2000 solutions scatter; the interquartile range stands for the sigma."""
    focal = solved(pose, np.ones(2000), centre_sigma).focal
    return np.subtract(*np.percentile(focal, [75, 25])) / 1.349 / FOCAL


def known(pose, centre_sigma=0.0):
    """The sigma of the focal of such a sheet as a calibration states it, a share of the focal."""
    return solved(pose, np.zeros(1), centre_sigma).focal_sigma[0] / FOCAL


def advice(pose, relative_sigma, centre_sigma=0.0, lens=0.0):
    """lens: what the lens's own doubt adds, a share of the focal."""

    def expected(pose, *, centre_known=False, distortion_known=False):
        bound = cramer_rao(CORNERS, FOCAL, pose, CENTRE, NOISE, 0.0 if centre_known else centre_sigma)
        return float(np.hypot(np.sqrt(bound[0, 0]) / FOCAL, 0.0 if distortion_known else lens))

    return focal_advice(CORNERS, FOCAL, pose, expected, relative_sigma, centre_sigma, SIZE)


def figure(pattern, sentence):
    found = re.search(pattern, sentence)
    assert found is not None
    return float(found[1])


def promised(sentence):
    return figure(r"it would be ([\d.]+) %", sentence) / 100


def test_a_flat_sheet_is_to_be_tilted_by_as_much_as_is_promised():
    pose = held(15, 0.45)
    (sentence,) = advice(pose, known(pose))
    assert sentence.startswith("tilt the sheet more: at 15 degrees the focal is known to")
    assert "at 40 degrees" in sentence
    # 2000 draws know a sigma by quartiles to 2.5 %, and two figures are printed.
    assert promised(sentence) == pytest.approx(scatter(held(40, 0.45)), rel=0.1)


def test_a_far_sheet_is_to_be_brought_nearer():
    pose = held(40, 1.0)
    (sentence,) = advice(pose, known(pose))
    times = figure(r"at 1/([\d.]+) of the distance", sentence)
    assert promised(sentence) == pytest.approx(scatter(held(40, 1.0 / times)), rel=0.1)
    # As many times larger it fills 95 % of the picture, in the first order of its size.
    seen = FOCAL * pose.transform(CORNERS)[:, :2] / pose.transform(CORNERS)[:, 2:]
    assert times * (np.ptp(seen, axis=0) / SIZE).max() == pytest.approx(0.95, rel=0.02)


def test_a_principal_point_that_is_not_known_is_named():
    pose = held(40, 0.6)
    (sentence,) = [s for s in advice(pose, known(pose, 30.0), 30.0) if "principal" in s]
    assert sentence.startswith("the principal point is only known to 30 px")
    assert promised(sentence) == pytest.approx(scatter(pose), rel=0.1)


def test_what_the_lens_may_distort_is_named_and_counts_in_what_is_promised():
    pose = held(15, 0.45)
    # Three times what the corners' noise leaves: eight ninths of the variance are the lens's.
    sentences = advice(pose, 3 * known(pose), lens=np.sqrt(8) * known(pose))
    assert sentences[0].startswith("4 points cannot show all that the lens distorts")
    assert promised(sentences[0]) == pytest.approx(scatter(pose), rel=0.1)
    assert not [s for s in sentences if s.startswith("tilt")]


def test_the_most_useful_comes_first_and_what_helps_little_is_not_said():
    pose = held(15, 1.0)
    sentences = advice(pose, known(pose))
    assert [s.split()[0] for s in sentences] == ["bring", "tilt"]
    assert promised(sentences[0]) < promised(sentences[1]) < 2 / 3 * known(pose)
    # Tilted already, and with no room to come nearer: what could be gained is less than a third.
    pose = held(29, 0.42)
    assert 1.5 > known(pose) / known(held(40, 0.42)) > 1
    (sentence,) = advice(pose, known(pose))
    assert "take more points of the sheet, or several Views" in sentence


def test_a_good_focal_needs_no_advice():
    pose = held(15, 0.45)
    assert advice(pose, 0.0049) == []
    assert advice(pose, 0.0051) != []


def test_the_tilt_is_between_the_normal_and_the_line_of_sight():
    assert np.degrees(view_tilt(held(25, 0.8))) == pytest.approx(25)
    aside = Pose(np.eye(3), np.array([0.5, 0.0, 0.5]))
    assert np.degrees(view_tilt(aside)) == pytest.approx(45)


@pytest.mark.parametrize(
    ("share", "words"), [(0.0123, "1.2 %"), (0.35, "35 %"), (2.0, "no more"), (np.inf, "no more")]
)
def test_shares_are_read_in_per_cent(share, words):
    assert percent(share).startswith(words)
