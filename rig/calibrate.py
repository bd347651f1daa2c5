"""From Views to a Rig: the one call that runs graph, chain and joint adjustment."""

from collections.abc import Sequence

from quadrig.single.rectangle import Rectangle
from quadrig.single.view import View

from .inputs import CameraInput
from .result import Rig


def calibrate(
    cameras: Sequence[CameraInput],
    rectangles: Sequence[Rectangle],
    views: Sequence[View],
    reference: str | None = None,
) -> Rig:
    """The rig that the Views of these cameras and rectangles show.

    reference: the camera, or the rectangle with a world pose, whose frame is the rig frame; the first camera that
    can be placed where None. Raises QuadrigError where no two cameras can be brought into one frame.
    """
    raise NotImplementedError
