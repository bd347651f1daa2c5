"""A share of the images does where cameras agree; where they are out of step, every image is searched."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from quadrig.io.config.rig_toml import parse_config
from quadrig.io.recording.framesets import NO_FRAME
from quadrig.io.search import whole_recording
from quadrig.io.search.detections import Detections
from quadrig.io.search.effort import Effort
from quadrig.io.search.whole_recording import calibrate_searched, search_recording

BOARD = (
    '[[rectangle]]\nname = "board"\nmoving = {moving}\nmarking = {{ kind = "chessboard", columns = 10, rows = 7, '
    "square = 0.025 }}"
)


@pytest.mark.parametrize(
    ("moving", "sigmas", "searched"), [("true", 20.0, [12, 40]), ("true", 0.0, [12]), ("false", 20.0, [12])]
)
def test_every_image_where_the_chosen_are_out_of_step(tmp_path, monkeypatch, example_rig, moving, sigmas, searched):
    for camera in ("left", "right"):
        (tmp_path / camera).mkdir()
        for k in range(40):
            cv2.imwrite(str(tmp_path / camera / f"{k:03}.png"), np.full((48, 64), 5 * k, np.uint8))
    counts = []

    def find(_recording, framesets, *_):
        counts.append(int(np.count_nonzero(framesets.frames[:, 0] != NO_FRAME)))
        view = replace(example_rig.fits[0].view, rectangle="board")
        return Detections([replace(view, camera=name) for name in ("left", "right")], 0, 0, {})

    monkeypatch.setattr(whole_recording, "find_detections", find)
    monkeypatch.setattr(whole_recording, "calibrate", lambda *_: example_rig)
    monkeypatch.setattr(whole_recording, "out_of_step", lambda _: sigmas)
    config = parse_config(BOARD.format(moving=moving))
    found = search_recording(tmp_path, config, Effort(share=0.1, workers=1, progress=False))
    assert counts == searched
    assert any("every image was searched" in note for note in found.notes) == (len(searched) > 1)
    assert calibrate_searched(found).cameras == example_rig.cameras
