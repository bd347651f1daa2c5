"""What is drawn as one thing, and the map of a room."""

from dataclasses import replace

import numpy as np

from quadrig.io.drawing.geometry import RING, bounds, positions
from quadrig.io.drawing.things import room_map, things
from quadrig.single.pose import Pose


def box_of(carried_rig):
    """The sheets of the hall turned round: a box, seen from outside."""
    (hall,) = carried_rig.bodies
    turned = hall.body_from_rect @ Pose.from_vectors(np.array([0.0, np.pi, 0.0]), np.zeros(3))
    return replace(carried_rig, bodies=(replace(hall, name="box", body_from_rect=turned),))


def test_a_body_that_moves_is_one_thing_and_a_room_none(carried_rig, example_rig):
    assert [thing.name for thing in things(example_rig)] == ["board", "desk", "wall"]
    assert things(carried_rig) == []
    (box,) = things(box_of(carried_rig))
    assert box.name == "box"
    assert box.rings.shape == (12, 4, 5, 3)
    assert box.at(99) is None


def test_the_outlines_of_a_body_are_those_of_its_rectangles(carried_rig):
    (hall,) = carried_rig.bodies
    turned = replace(carried_rig, bodies=(replace(hall, name="box"),), rectangles=carried_rig.rectangles)
    room = room_map(turned, hall)
    for row, placed in enumerate(turned.rectangles):
        seen = hall.rig_from_body[:, None].transform(room.rings[row])
        np.testing.assert_allclose(seen, placed.rig_from_rect[:, None].transform(placed.rectangle.corners[RING]))


def test_a_room_is_known_by_its_walls(carried_rig):
    (hall,) = carried_rig.bodies
    assert carried_rig.room is hall
    assert hall.name != "room"
    assert box_of(carried_rig).room is None
    np.testing.assert_array_equal(bounds(carried_rig)[0], positions(carried_rig).min(axis=0))


def test_a_map_is_level_along_the_walls_and_has_the_path(carried_rig):
    (hall,) = carried_rig.bodies
    room = room_map(carried_rig, hall)
    np.testing.assert_allclose(room.axes @ room.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(room.axes) > 0
    assert room.axes[2, 1] < -0.95
    across = np.abs(hall.body_from_rect.rotation[:, :, 2] @ room.axes[:2].T)
    assert (across.max(axis=1) > 0.95).all()
    (path,) = room.stretches()
    np.testing.assert_allclose(path[[0, -1]], [[-1, 0, 0], [1, 0, 0]], atol=1e-12)
    # The rig's place in the room is as sure as the room's in the rig frame, but for what turning adds across.
    assert (room.sigmas >= 2e-3).all()
    assert (room.sigmas < 3e-3).all()
    parted = replace(hall, framesets=np.array([0, 1, 2, 3, 4, 5, 60, 61, 62, 63, 64, 65]))
    assert [len(part) for part in room_map(carried_rig, parted).stretches()] == [6, 6]
