"""One camera of a recording: its name, the size of its pictures, and where they are."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from quadrig.io.plain_words import plain_name
from quadrig.io.recording.image_source import ImageSource
from quadrig.single.arrays import Ints
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics

_NAME_WORDS = ("image_raw", "image", "compressed", "camera_info")
FIRST_IMAGES = 5
"""A broken first image or two happen when a recording is started; more in a row are no stream of images."""


@dataclass(frozen=True, eq=False)
class RecordedCamera:
    """One camera of a recording.

    topic: of an MCAP recording, else the path of the video or folder. width, height: px, of most of its images.
    prior: the lens that the recording brings along, if any. frames: how many images it has.
    """

    name: str
    topic: str
    width: int
    height: int
    source: ImageSource
    prior: Intrinsics | None = None

    @property
    def frames(self) -> int:
        """How many images there are."""
        return len(self.source)

    @property
    def encoding(self) -> str:
        """How the images are stored: jpeg, png, bgr8, h264..."""
        return self.source.encoding

    @cached_property
    def stamps(self) -> Ints:
        """Time of each image (F,) int64 ns."""
        return self.source.stamps()


def camera_name(topic: str) -> str:
    """A camera's name: its topic without the trailing image_raw, image, compressed, camera_info words.

    /cam0/image_raw/compressed is cam0, in plain_name's letters; where nothing else is left the camera is called
    camera.
    """
    words = [word for word in topic.split("/") if word]
    while words and words[-1] in _NAME_WORDS:
        words.pop()
    return plain_name("/".join(words)) or "camera"


def camera_of_source(name: str, topic: str, source: ImageSource) -> RecordedCamera:
    """A camera from where its images are. Raises QuadrigError where none of the first can be read."""
    first = source.part(np.arange(min(FIRST_IMAGES, len(source))))
    image = next((image for image in first.images() if image is not None), None)
    if image is None:
        raise QuadrigError(f"{topic}: none of its first images can be read; is it a recording of images?")
    return RecordedCamera(name, topic, image.shape[1], image.shape[0], source)
