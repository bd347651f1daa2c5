"""Figures that pictures of a rig share."""

import numpy as np

from quadrig.io.drawing.geometry import beside
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


def test_names_stand_beside_sheets_and_on_nothing():
    rng = np.random.default_rng(5)
    corners = rng.uniform(0, 600, (12, 2))
    boxes = np.concatenate([corners, corners + rng.uniform(20, 90, (12, 2))], axis=1)
    sizes = np.column_stack([rng.uniform(40, 120, 12), np.full(12, 20.0)])
    tops = beside(boxes, sizes, (640, 640), 4.0)
    named = np.isfinite(tops).all(axis=1)
    assert 4 <= named.sum() < 12
    own = np.column_stack([tops[:, 0] - sizes[:, 0] / 2, tops[:, 1], tops[:, 0] + sizes[:, 0] / 2, tops[:, 1] + 20])
    own = own[named]
    assert own.min() >= 0
    assert own.max() <= 640
    every = np.concatenate([boxes, own])
    over = (own[:, None, :2] < every[None, :, 2:]).all(axis=-1) & (every[None, :, :2] < own[:, None, 2:]).all(axis=-1)
    # Each name lies on itself alone.
    assert over.sum() == len(own)
