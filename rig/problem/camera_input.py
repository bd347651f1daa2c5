"""What is known of a camera before a rig is calibrated."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import LENS_PARAMETERS, Intrinsics
from quadrig.single.lens_prior import LensEvidence

LensChoice = Literal["auto", "f", "f k1", "f k1 k2", "f c k1 k2", "full", "fisheye"]

# s a row: a picture of a thousand rows that takes a second is no video's; who writes 20 meant microseconds.
_SLOWEST_LINE = 1e-3
# In sizes of the picture: a telescope's focal length, and one as much too short.
_LONGEST_FOCAL = 1e4
_LARGEST_ASPECT = 100.0
# Of k3, which grows with the sixth power of the focal: barrel distortion of 10 % at a telescope's rim has a million.
_LARGEST_TERM = 1e12


@dataclass(frozen=True, eq=False)
class CameraInput:
    """A camera of a recording: its name, image size, and what is given of its lens.

    intrinsics: a first guess or, where fixed, the truth that stays. lens_covariance (9, 9), in the order of
    LENS_PARAMETERS: how sure they are, which makes them what is known of this lens before its Views, in place of the
    priors of real lenses; parameters of no variance stay as they are. lens_evidence: of the Views that they come from
    (Camera.lens_evidence), which count then as if they were here. lens: which parameters are estimated; "auto"
    estimates all that the lens model has. line_time: s from one row of a picture to the next, 0 where all are taken
    at once; estimated where None.
    Raises QuadrigError where the image has no size, or what is known is not of the lens that is given.
    """

    name: str
    width: int
    height: int
    intrinsics: Intrinsics | None = None
    fixed: bool = False
    lens: LensChoice = "auto"
    lens_covariance: Floats | None = None
    lens_evidence: LensEvidence | None = None
    line_time: float | None = None

    @property
    def first_lens(self) -> Intrinsics:
        """The lens that is given, or one in the middle of the picture, of no focal yet (1 px)."""
        model = "fisheye" if self.lens == "fisheye" else "pinhole"
        return self.intrinsics or Intrinsics.centred(self.width, self.height, 1.0, model)

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0:
            raise QuadrigError(
                f"camera {self.name!r}: image size {self.width}x{self.height}; give the size of its pictures"
            )
        if self.line_time is not None:
            try:
                check_line_time(self.line_time)
            except QuadrigError as error:
                raise QuadrigError(f"camera {self.name!r}: {error}") from error
        if self.intrinsics is not None and not _is_a_lens(self.intrinsics):
            raise QuadrigError(f"camera {self.name!r}: the lens given is that of no camera; mend its numbers")
        doubts = [known for known in (self.lens_covariance, self.lens_evidence) if known is not None]
        if doubts and self.intrinsics is None:
            raise QuadrigError(f"camera {self.name!r}: doubt of a lens without intrinsics; give its lens")
        if len(doubts) > 1:
            raise QuadrigError(f"camera {self.name!r}: lens_covariance and lens_evidence say the same; give one")
        if self.lens_covariance is not None:
            self._check_covariance(self.lens_covariance)

    def _check_covariance(self, covariance: Floats) -> None:
        size = len(LENS_PARAMETERS)
        if covariance.shape != (size, size) or not np.isfinite(covariance).all():
            raise QuadrigError(
                f"camera {self.name!r}: lens_covariance is no matrix of {size} x {size} finite numbers; leave it out "
                "where it is not known"
            )
        scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
        # Rounding leaves eigenvalues of what is perfectly correlated a little below zero.
        if np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() < -1e-6:
            raise QuadrigError(f"camera {self.name!r}: lens_covariance has negative variances; compute it again")


def check_line_time(seconds: float) -> None:
    """Raises QuadrigError where that is no camera's line time."""
    if not abs(seconds) <= _SLOWEST_LINE:
        raise QuadrigError(
            f"a line time of {seconds:g} s is no camera's; give the time from one row of a picture to the next, such "
            "as 20us, or 0 where all rows are taken at once"
        )


def _is_a_lens(lens: Intrinsics) -> bool:
    """Whether its numbers are those of some camera."""
    size = max(lens.width, lens.height)
    return bool(
        size / _LONGEST_FOCAL < lens.focal < size * _LONGEST_FOCAL
        and 1 / _LARGEST_ASPECT < lens.aspect < _LARGEST_ASPECT
        and np.abs(lens.principal_point).max() < size * _LONGEST_FOCAL
        and np.abs(lens.distortion).max() < _LARGEST_TERM
    )
