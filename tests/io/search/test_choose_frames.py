"""A quick look at a recording chooses what is searched."""

import cv2
import numpy as np

from quadrig.io.recording.framesets import NO_FRAME, build_framesets
from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.io.search.choose_frames import choose_frames, look_at
from quadrig.io.search.effort import Effort


def test_still_and_sharp_images_are_chosen(tmp_path):
    """A sheet that is held for ten images, then carried for ten, blurred by it; two cameras, one image broken."""
    rng = np.random.default_rng(1)
    wall = cv2.GaussianBlur(rng.uniform(60, 140, (180, 320)), (0, 0), 3)
    for camera in range(2):
        (tmp_path / f"cam{camera}").mkdir()
        for k in range(200):
            share = max(0, k % 20 - 9)
            x = 10 + 25 * (k // 20) + 2.5 * share
            image = wall.copy()
            image[60:120, round(x) : round(x) + 40 : 1] = 230
            image[60:120:6, round(x) : round(x) + 40] = 20
            if share:
                image = cv2.blur(image, (9, 9))
            image = np.clip(image + rng.normal(0, 3, image.shape), 0, 255)
            cv2.imwrite(str(tmp_path / f"cam{camera}" / f"{k:03}.jpg"), image.astype(np.uint8))
    (tmp_path / "cam1" / "004.jpg").write_bytes(b"broken")
    recording = open_recording([tmp_path])
    framesets = build_framesets(recording)
    looks = look_at(recording, framesets, Effort(workers=1))
    assert looks.thumbnails.shape == (200, 2, 18, 32)
    assert np.argwhere(np.isnan(looks.sharpness)).tolist() == [[4, 1]]
    chosen = choose_frames(recording, framesets, Effort(share=0.1, workers=1))
    assert len(chosen) == len(framesets)
    kept = np.flatnonzero(np.all(chosen.frames != NO_FRAME, axis=1))
    assert len(kept) == 20
    assert np.array_equal(chosen.frames[kept], framesets.frames[kept])
    assert np.mean(kept % 20 < 10) >= 0.9
    assert len(set(kept // 20)) == 10
    every = choose_frames(recording, framesets, Effort(share=1.0, workers=1))
    assert np.array_equal(every.frames, framesets.frames)
