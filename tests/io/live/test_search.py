"""The live search beside the full one."""

from dataclasses import replace

import numpy as np

from quadrig.io.live.blind import BlindCameras
from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.capture.source_spec import parse_source
from quadrig.io.live.search import LiveSearch
from quadrig.single.detect.image_search import detect_views
from quadrig.single.lens import Intrinsics
from quadrig.single.pose import Pose
from quadrig.single.render.capture import Capture
from quadrig.single.render.picture import Sheet, render_image
from quadrig.single.rotation import rotation_from_vector


def test_search_finds_what_a_full_search_finds(room):
    lens = Intrinsics.centred(960, 540, 750.0)
    search = LiveSearch([room.TAG, room.BOARD])
    for step in range(6):
        shift = np.array([0.01 * step, 0, 0])
        sheets = [
            Sheet(
                room.TAG, Pose(rotation_from_vector(np.array([0.3, 0.2, 0.1])), np.array([-0.4, 0.1, 1.6]) + shift)
            ),
            Sheet(room.BOARD, Pose(rotation_from_vector(np.array([-0.3, 0.3, 0])), np.array([0.2, 0, 1.4]) - shift)),
        ]
        grey = render_image(
            lens, Pose.identity(), sheets, samples=2, capture=Capture(blur=0.6, noise=1.0), colour=False
        )
        found = search.search(Frame("cam0", step, 0.0, picture=grey), step)
        assert {view.rectangle for view in found.views} == {"sheet", "board"}
        exact = {view.rectangle: view for view in search.refine(found, {"sheet", "board"})}
        for view in detect_views(grey, [room.TAG, room.BOARD]):
            np.testing.assert_array_equal(exact[view.rectangle].points, view.points)
            # The fit begins at outlines found in a window instead of the picture: a twentieth of a pixel at most.
            np.testing.assert_allclose(exact[view.rectangle].pixels, view.pixels, atol=0.05)


def test_what_is_seen_from_behind_is_found_and_what_is_mirrored_is_said(room):
    lens, turned = Intrinsics.centred(960, 540, 750.0), np.array([0.2, np.pi - 0.2, 0.0])
    board = replace(room.BOARD, back=True)
    search, blind = LiveSearch([board]), BlindCameras([room.BOARD])
    said = []
    for step in range(4):
        pose = Pose(rotation_from_vector(turned), np.array([0.01 * step, 0, 1.2]))
        grey = render_image(
            lens, Pose.identity(), [Sheet(board, pose)], capture=Capture(blur=0.6, noise=1.0), colour=False
        )
        found = search.search(Frame("cam0", step, 0.0, picture=grey), step)
        (view,) = search.refine(found, {"board"})
        assert view.back
        assert np.abs(view.pixels - lens.project(pose.transform(view.points))).max() < 0.3
        front = LiveSearch([room.BOARD]).search(Frame("cam0", step, 0.0, picture=grey), step)
        assert front.views == ()
        said.append(blind.look([front], step + 1.0))
    # One look is not believed.
    assert said[0] is None
    assert said[1] is not None
    assert "cam0 sees 'board' mirrored" in said[1].sentence


def test_pictures_of_a_folder_say_nothing_of_when_they_were_taken(tmp_path, room):
    assert parse_source("0").timed
    assert not parse_source(str(tmp_path)).timed
    assert not parse_source(f"watch:{tmp_path}").timed
    assert np.isnan(Frame("cam0", 5, 0.0, timed=False).time)
    found = LiveSearch([room.TAG]).search(
        Frame("cam0", 5_500_000_000, 0.0, picture=room.picture(0, room.held_poses()[0])), 3
    )
    assert [(view.time, view.frameset) for view in found.views] == [(5.5, 3)]
