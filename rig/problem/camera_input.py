"""What is known of a camera before a rig is calibrated."""

from dataclasses import dataclass
from typing import Literal

from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics

LensChoice = Literal["auto", "f", "f k1", "f k1 k2", "f c k1 k2", "full", "fisheye"]


@dataclass(frozen=True, eq=False)
class CameraInput:
    """A camera of a recording: its name, image size, and what is given of its lens.

    intrinsics: a first guess or, where fixed, the truth that stays. lens: which parameters are estimated;
    "auto" estimates all that the lens model has, under the priors of real lenses.
    Raises QuadrigError where the image has no size.
    """

    name: str
    width: int
    height: int
    intrinsics: Intrinsics | None = None
    fixed: bool = False
    lens: LensChoice = "auto"

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0:
            raise QuadrigError(
                f"camera {self.name!r}: image size {self.width}x{self.height}; give the size of its pictures"
            )
