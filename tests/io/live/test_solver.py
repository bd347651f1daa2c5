"""What a live solution uses."""

import multiprocessing
import os
import sys

import pytest

from quadrig.io.live.solver import LiveSolver, SolveRequest, thinned
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single.view import View


def test_thinning_leaves_framesets_that_follow_on_one_another_together(room):
    corners = room.TAG.corners
    times = {10 * burst + k: burst + 0.1 * k for burst in range(60) for k in range(3)}
    views = [
        View("sheet", corners, corners[:, :2], camera, k, time=time) for k, time in times.items() for camera in "ab"
    ]
    kept = {view.frameset for view in thinned(views, 100)}
    assert 97 <= len(kept) <= 100
    assert len({frameset // 10 for frameset in kept}) == 33


def test_thinning_keeps_what_cameras_share(room):
    corners = room.TAG.corners
    alone = [View("sheet", corners, corners[:, :2], "a", k) for k in range(300)]
    shared = [View("sheet", corners, corners[:, :2], camera, 1000 + k) for k in range(40) for camera in "ab"]
    kept = {view.frameset for view in thinned([*alone, *shared], 100)}
    assert set(range(1000, 1040)) <= kept
    assert len(kept) <= 100


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_solver_that_is_killed_is_started_again_and_one_that_is_closed_stays_no_longer(room):
    before = set(multiprocessing.active_children())
    request = SolveRequest((CameraInput("a", 320, 240),), (room.TAG,), (), None)
    solver = LiveSolver()
    try:
        for process in set(multiprocessing.active_children()) - before:
            os.kill(process.pid or 0, 9)
            process.join()
        solution = None
        for _ in range(3):
            if solution is None:
                solver.begin(request)
                solution = solver.take(wait=True)
        assert solution is not None
        assert "no rectangle" in solution.trouble
        solver.begin(request)
    finally:
        solver.close()
    assert not [one for one in set(multiprocessing.active_children()) - before if one.is_alive()]
