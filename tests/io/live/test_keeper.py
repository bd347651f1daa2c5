"""Which framesets of a live stream are kept."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.keeper import Keeper
from quadrig.io.live.search import LiveSearch
from quadrig.rig.adjustment.motion import LONGEST_GAP

SECOND = 1_000_000_000
STEP = 0.05


@pytest.fixture
def kept_times(room):
    """kept_times(speed, cameras, seconds): when (s) framesets of a sheet of that speed (m/s) were kept."""

    def times(speed: float, cameras: tuple[int, ...], seconds: float) -> np.ndarray:
        search = LiveSearch([room.TAG])
        diagonals = {f"cam{camera}": float(np.hypot(room.WIDTH, room.HEIGHT)) for camera in cameras}
        with ThreadPoolExecutor(1) as pool:
            keeper = Keeper(search, [room.TAG], pool)
            for index in range(round(seconds / STEP)):
                stamp = round(index * STEP * SECOND)
                pose = room.moved(speed * index * STEP)
                frames = [Frame(f"cam{c}", stamp, 0.0, picture=room.picture(c, pose)) for c in cameras]
                keeper.consider(index, stamp, [search.search(frame, index) for frame in frames], diagonals)
                keeper.collect(wait=True)
        return np.array(sorted({view.time for view in keeper.views}))

    return times


def test_what_several_cameras_see_in_motion_is_kept_in_runs_of_three(kept_times):
    # 0.06 m/s are 20 px/s, and a new place is 11 px away: every half second or so.
    times = kept_times(0.06, (0, 1), 1.5)
    starts = [time for time in times if not np.any((times < time) & (times > time - LONGEST_GAP))]
    assert len(starts) >= 2
    # What begins in the last half second has no time to be whole.
    for start in [start for start in starts if start < 1.0]:
        assert np.count_nonzero((times >= start) & (times < start + 2 * LONGEST_GAP)) >= 3


def test_what_one_camera_sees_or_what_stands_still_shows_no_clock_and_is_kept_once(kept_times):
    alone = kept_times(0.06, (0,), 1.2)
    assert len(alone) >= 2
    assert np.diff(alone).min() > LONGEST_GAP
    assert len(kept_times(0.0, (0, 1), 0.6)) == 1
