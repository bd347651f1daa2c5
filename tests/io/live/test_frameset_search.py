"""A camera keeps the size of its first picture: another size is another lens, and is not mixed with it."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.capture.framesets import LiveFrameset
from quadrig.io.live.frameset_search import FramesetSearch
from quadrig.io.live.search import LiveSearch
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Rectangle

DESK = Rectangle("desk", 0.2, 0.2, TagMarking("apriltag_36h11", 1))


def frameset(number: int, **sizes: tuple[int, int]) -> LiveFrameset:
    frames = {
        name: Frame(name, number, 0.0, picture=np.full((height, width), 128, np.uint8))
        for name, (width, height) in sizes.items()
    }
    return LiveFrameset(number, number, frames)


def test_pictures_of_another_size_are_left_out_and_named_until_they_are_back():
    with ThreadPoolExecutor(1) as pool:
        search = FramesetSearch(LiveSearch([DESK]), pool, {})
        assert [one.camera for one in search.search(frameset(0, left=(160, 120), right=(160, 120)))] == [
            "left",
            "right",
        ]
        assert search.fault() is None
        assert [one.camera for one in search.search(frameset(1, left=(160, 120), right=(80, 60)))] == ["left"]
        fault = search.fault()
        assert fault is not None
        assert "right gives pictures of 80x60 and gave 160x120" in fault.sentence
        assert search.sizes["right"] == (160, 120)
        assert len(search.search(frameset(2, left=(160, 120), right=(160, 120)))) == 2
        assert search.fault() is None
