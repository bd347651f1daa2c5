"""Pictures of a video that are wanted, without decoding those that are not."""

from pathlib import Path

import numpy as np
import pytest

from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.single.arrays import Ints, Picture


@pytest.fixture(scope="module")
def video(tmp_path_factory) -> Path:
    """Thirty frames of H.264 in which something moves, with pictures between that no other builds on."""
    av = pytest.importorskip("av")
    path = tmp_path_factory.mktemp("video") / "cam.mp4"
    noise = np.random.default_rng(0).integers(0, 255, (64, 96), np.uint8)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"g": "10", "bf": "3"})
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        for k in range(30):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.roll(noise, 2 * k, axis=1), format="gray")))
        container.mux(stream.encode(None))
    return path


def pictures(path: Path, indices: Ints) -> list[Picture | None]:
    """Those of a part of the video."""
    return list(open_recording([path]).cameras[0].source.part(indices).images())


@pytest.mark.parametrize("wanted", [range(0, 30, 2), range(1, 30, 2), range(3, 30, 10), [7], [29], [0, 1, 18]])
def test_a_picture_is_the_same_whatever_else_is_wanted(video, wanted):
    every = pictures(video, np.arange(30))
    some = pictures(video, np.array(wanted))
    assert len(every) == 30
    assert len(some) == len(wanted)
    for index, picture in zip(wanted, some, strict=True):
        assert picture is not None
        np.testing.assert_array_equal(picture, every[index])
