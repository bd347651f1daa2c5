"""Views that a session kept."""

import numpy as np

from quadrig.io.live.record.kept_views import encode_views, read_kept_views
from quadrig.io.live.record.recorder import LiveRecorder
from quadrig.single.view import View


def test_kept_views_come_back_to_the_last_bit(tmp_path, room):
    rng = np.random.default_rng(0)
    view = View(
        "sheet",
        room.TAG.corners,
        rng.uniform(0, 600, (4, 2)),
        "cam1",
        7,
        (room.TAG.corners[::-1],),
        0.123,
        1.7e9 + 1 / 3,
    )
    recorder = LiveRecorder(tmp_path / "r.mcap")
    recorder.note(5, encode_views(7, [view], {"cam1": (640, 360)}))
    recorder.close()
    views, sizes = read_kept_views(tmp_path / "r.mcap")
    assert sizes == {"cam1": (640, 360)}
    assert len(views) == 1
    assert (views[0].camera, views[0].rectangle, views[0].frameset, views[0].sigma) == ("cam1", "sheet", 7, 0.123)
    assert views[0].time == view.time
    np.testing.assert_array_equal(views[0].pixels, view.pixels)
    np.testing.assert_array_equal(views[0].alternatives[0], view.alternatives[0])
