"""What a live session shows in space: where to hold a box, and the room around a rig that is carried."""

from dataclasses import replace

import numpy as np
import rerun as rr
from rerun.chunk import RrdReader

from quadrig.io.live.state import SetupState
from quadrig.io.viewer.setup.moments import MomentLog
from quadrig.rig.coach.advice import Advice
from quadrig.single.pose import Pose

GHOST = Pose.from_vectors(np.array([0.1, 0.4, 0.0]), np.array([0.2, 0.0, 1.5]))


def strips_of(rig, path):
    """Line strips by entity, of a moment with a ghost of the rectangle "east"."""
    rectangles = tuple(placed.rectangle for placed in rig.rectangles)
    stream = rr.RecordingStream("quadrig test")
    stream.save(str(path))
    advice = Advice("tilt", "turn it", ("cam0",), "east", GHOST)
    log = MomentLog(stream, tuple(camera.name for camera in rig.cameras), rectangles)
    log.log(SetupState("turn it", frameset=0, rig=rig, advice=advice))
    stream.flush()
    stream.disconnect()
    held = {}
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        if "LineStrips3D:strips" in batch.schema.names:
            held[str(chunk.entity_path)] = batch.column("LineStrips3D:strips").to_pylist()[-1]
    return held


def test_the_ghost_of_a_box_is_all_of_it(carried_rig, tmp_path):
    (hall,) = carried_rig.bodies
    turned = hall.body_from_rect @ Pose.from_vectors(np.array([0.0, np.pi, 0.0]), np.zeros(3))
    box = replace(carried_rig, bodies=(replace(hall, name="box", body_from_rect=turned),))
    rings = np.array(strips_of(box, tmp_path / "box.rrd")["/ghost/outline"])
    assert len(rings) == 4
    east = next(placed.rectangle for placed in box.rectangles if placed.name == "east")
    np.testing.assert_allclose(rings[1, :4], GHOST.transform(east.corners), atol=1e-6)
    # What is fixed to it stands to it as on the box.
    north = (GHOST @ turned[1].inverse() @ turned[0]).transform(east.corners)
    np.testing.assert_allclose(rings[0, :4], north, atol=1e-6)


def test_walls_are_shown_where_the_rig_saw_them_last_and_not_to_be_held(carried_rig, tmp_path):
    strips = strips_of(carried_rig, tmp_path / "room.rrd")
    assert "/ghost/outline" not in strips
    last = [placed.rig_from_rect[-1].transform(placed.rectangle.corners) for placed in carried_rig.rectangles]
    np.testing.assert_allclose(np.array(strips["/sheets"])[:, :4], last, atol=1e-6)
