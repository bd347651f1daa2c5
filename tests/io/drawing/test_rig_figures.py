"""Figures that pictures of a rig share."""

from quadrig.io.drawing.rig_figures import shared_counts
from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View


def test_the_graph_counts_moving_sheets_by_frameset_and_static_ones_at_all_times(room):
    corners = room.TAG.corners
    views = [View("sheet", corners, corners[:, :2], camera, k) for k, camera in enumerate("abab")]
    views += [View("sheet", corners, corners[:, :2], "b", 0), View("wall", corners, corners[:, :2], "c", 9)]
    views += [View("wall", corners, corners[:, :2], "a", 4)]
    wall = Rectangle("wall", 0.2, 0.2)
    assert shared_counts(views, {"sheet": room.TAG, "wall": wall}) == {("a", "b"): 1, ("a", "c"): 1}
