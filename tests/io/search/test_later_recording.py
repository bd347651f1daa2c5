"""A recording made after the calibration is searched in runs."""

import numpy as np
import pytest

from quadrig.io.search.later_recording import spread_runs


@pytest.mark.parametrize(("count", "most"), [(10, 40), (111, 120), (1000, 120), (50, 7), (121, 120)])
def test_framesets_are_searched_in_runs(count, most):
    chosen = spread_runs(count, most)
    assert len(chosen) <= most
    assert len(chosen) >= min(count, most) / 2
    assert (np.diff(chosen) > 0).all()
    # Runs of twenty, as far as so many are allowed: in a run the paths of moving rectangles are determined.
    runs = np.split(chosen, np.flatnonzero(np.diff(chosen) > 1) + 1)
    assert min(len(run) for run in runs) >= min(20, most, count)
    assert chosen[0] == 0
    if most >= 40:
        assert chosen[-1] == count - 1
