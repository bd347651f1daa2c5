"""A measured place on a body that all others contradict is named, and drags nothing."""

import re
from dataclasses import replace

import numpy as np
import pytest

from quadrig.rig.calibration import calibrate
from quadrig.single.pose import Pose

SIGMA, BY = 0.002, 0.02


@pytest.fixture(scope="module")
def made(bodies, table_lens):
    return bodies.turntable(np.random.default_rng(3), table_lens, 25)


@pytest.fixture(scope="module")
def places(made):
    at = {r.name: made.made.world_from_rect[r.name][0] for r in made.made.rectangles}
    return {name: at["tag0"].inverse() @ place for name, place in at.items()}


def calibrated(made, places, wrong):
    """Each place as measured to its sigma, those of `wrong` with a shift more; the others where they were made."""
    rng, rectangles = np.random.default_rng(5), []
    for rectangle in made.made.rectangles:
        off = Pose.from_vectors(SIGMA * rng.normal(size=3), SIGMA * rng.normal(size=3))
        shift = Pose.from_vectors(np.zeros(3), np.array([wrong.get(rectangle.name, 0.0), 0, 0]))
        given = places[rectangle.name] @ off @ shift
        rectangles.append(replace(rectangle, body_from_rect=given, layout_sigma=(SIGMA, SIGMA)))
    return calibrate(made.made.inputs, rectangles, made.made.views, "cam0")


def test_a_place_measured_wrongly_is_named_and_found(made, places):
    rig = calibrated(made, places, {"tag1": BY})
    (said,) = [sentence for sentence in rig.weak if "is given" in sentence]
    assert said.startswith("'tag1' of body 'box' is given ")
    assert float(re.findall(r"given ([\d.]+) mm", said)[0]) == pytest.approx(1e3 * BY, abs=3 * 1e3 * SIGMA)
    (body,) = rig.bodies
    for row, name in enumerate(body.rectangles):
        rows = slice(6 * row, 6 * row + 6)
        off = body.body_from_rect[row].step_to(places[name]) / np.sqrt(np.diag(body.layout_covariance)[rows])
        assert np.abs(off).max() < 3.5, name


def test_of_places_that_hold_to_their_sigma_none_is_accused(made, places):
    rig = calibrated(made, places, {})
    assert not [sentence for sentence in rig.weak if "is given" in sentence]
