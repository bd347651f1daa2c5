"""A rectangle of the wrong size is named where others say so, and only there."""

from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate


def resized(made, name, factor):
    """What calibrate gets where a rectangle was given too large by a factor."""
    rectangles = [
        replace(r, width=r.width * factor, height=r.height * factor) if r.name == name else r for r in made.rectangles
    ]
    views = [replace(v, points=v.points * factor) if v.rectangle == name else v for v in made.views]
    return calibrate(made.inputs, rectangles, views)


def sizes(rig):
    return [sentence for sentence in rig.weak if "size that was given" in sentence]


def centre_errors(made, rig):
    first = rig.cameras[0].name
    return np.array(
        [
            np.linalg.norm(c.rig_from_camera.translation - made.rig_from_camera(first, c.name).translation)
            for c in rig.cameras
        ]
    )


@pytest.fixture(scope="module")
def three(simulated):
    return simulated.simulate(5, simulated.Scene(cameras=4, framesets=8, tags=2))


@pytest.mark.parametrize("factor", [1.05, 0.95])
def test_one_of_several_is_named_with_its_size(three, factor):
    rig = resized(three, "tag0", factor)
    [sentence] = sizes(rig)
    assert sentence.startswith("'tag0'")
    seen = float(sentence.split(" it is ")[1].split(" ")[0])
    assert seen == pytest.approx(100 * abs(1 / factor - 1), abs=0.7)
    assert ("smaller" in sentence) == (factor > 1)
    # Its Views hold the rig all the same.
    assert not any(fit.rejected for fit in rig.fits)
    assert centre_errors(three, rig).max() < 0.03


def test_of_two_nobody_knows_which_and_all_lengths_are_unsure(simulated):
    made = simulated.simulate(6, simulated.Scene(cameras=3, framesets=8, tags=1))
    rig, right = resized(made, "tag0", 1.05), calibrate(made.inputs, made.rectangles, made.views)
    [sentence] = sizes(rig)
    assert "'tag0'" in sentence
    assert "'sheet'" in sentence
    assert not sizes(right)
    assert rig.scale_sigma > 0.02 > 10 * right.scale_sigma


def test_the_only_one_is_not_accused(simulated):
    made = simulated.simulate(6, simulated.Scene(cameras=3, framesets=8, tags=0))
    assert not sizes(resized(made, "sheet", 1.05))


def test_misprints_are_no_wrong_sizes(three):
    assert not sizes(resized(three, "tag0", 1.003))
