"""Whether a source that was gone for a while shows what its camera showed before.

Devices are numbered anew when they are plugged in, addresses are handed out anew, cameras are knocked: pictures of
another place or another size under the old name would be solved as if they were of the old lens and pose. What
stands still before a camera is known by its edges, whose directions hardly change with the light.
"""

import cv2
import numpy as np

from quadrig.io.live.capture.frame import Frame
from quadrig.single.arrays import Floats, Picture
from quadrig.single.errors import QuadrigError

_WIDTH = 96
# s: hands and sheets have moved on from one look to the next, and are forgotten after some looks more.
_LOOK_EVERY, _LOOKS = 1.0, 20
# Before so many looks what moves cannot be told from what stands still.
_FEWEST_LOOKS = 4
# Grey levels from pixel to pixel: an edge beyond the noise of small pictures.
_EDGE = 6.0
# Edges that stood still in most looks; with fewer pixels of them than this nothing can be said.
_STANDS_STILL, _FEWEST_PIXELS = 0.5, 80
# Of edges that stood still, four webcams before which people carry a board show 0.46 to 0.75 again, and a pair of
# cameras of which the board hides half 0.31 to 0.56; of each other's, 0.19 at most, and of their own turned by a
# twentieth of the picture 0.2.
SAME = 0.3
"""The least agreement at which a scene is the one from before."""


class SceneMemory:
    """The edges of what stands still before one camera, as directions (H, W, 2) whose length says how surely."""

    def __init__(self) -> None:
        self._mean: Floats | None = None
        self._looks = 0

    def learn(self, picture: Picture) -> None:
        """Take in a grey picture of the camera."""
        edges = _edges(picture)
        self._looks += 1
        self._mean = edges if self._mean is None else self._mean + (edges - self._mean) / min(self._looks, _LOOKS)

    def agreement(self, picture: Picture) -> float:
        """The share of the edges that stood still that a grey picture shows, in their directions.

        nan where too little stood still, or was seen too briefly.
        """
        if self._mean is None or self._looks < _FEWEST_LOOKS:
            return float("nan")
        length = np.linalg.norm(self._mean, axis=-1)
        still = length > _STANDS_STILL
        if np.count_nonzero(still) < _FEWEST_PIXELS:
            return float("nan")
        along = np.einsum("nk,nk->n", self._mean[still], _edges(picture)[still])
        return float(along.sum() / length[still].sum())


class SameCamera:
    """Lets frames through while they are of one camera. trouble: what else they are, in words, or "".

    After every interruption a frame has to show the scene from before; those that do not are left out.
    """

    def __init__(self) -> None:
        self.trouble = ""
        self.left_out = 0
        self._size: tuple[int, int] | None = None
        self._scene = SceneMemory()
        self._looked = -np.inf
        self._doubted = False

    def doubt(self) -> None:
        """From now on frames may be another camera's."""
        self._doubted = True

    def admits(self, frame: Frame) -> bool:
        """Whether the frame is this camera's. One that is damaged is let through: it is counted where it is read."""
        try:
            self.trouble = self._judge(frame)
        except QuadrigError:
            return not self._doubted
        self.left_out += bool(self.trouble)
        return not self.trouble

    def _judge(self, frame: Frame) -> str:
        size, self._size = frame.size, self._size or frame.size
        if size != self._size:
            self._doubted = True
            return (
                f"gives pictures of {size[0]}x{size[1]} and gave {self._size[0]}x{self._size[1]}: another size is "
                "another lens; set it back, or begin again"
            )
        if self._doubted and self._scene.agreement(frame.grey) < SAME:
            return (
                "came back with another scene: it was moved, or these are another camera's pictures; put it back, or "
                "begin again"
            )
        self._doubted = False
        if frame.arrived - self._looked >= _LOOK_EVERY:
            self._looked = frame.arrived
            self._scene.learn(frame.grey)
        return ""


def _edges(picture: Picture) -> Floats:
    """Directions of the edges of a picture made small, of length near 1 where they are clear (H, W, 2)."""
    height, width = picture.shape
    small = cv2.resize(picture, (_WIDTH, max(2, round(_WIDTH * height / width))), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small.astype(np.float32), (0, 0), 1.0)
    step = np.stack([cv2.Scharr(small, cv2.CV_32F, 1, 0), cv2.Scharr(small, cv2.CV_32F, 0, 1)], axis=-1) / 32
    return np.asarray(step / (np.linalg.norm(step, axis=-1, keepdims=True) + _EDGE / 2), np.float64)
