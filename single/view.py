"""A View: one rectangle in one image."""

from dataclasses import dataclass
from math import isnan

from quadrig.single.arrays import Floats

# Corners of any origin, px: a detector's are better, a hand's worse.
_UNKNOWN_SIGMA = 1.0


@dataclass(frozen=True, eq=False)
class View:
    """One rectangle in one image: points of the rectangle and where they were seen.

    points (P, 3) metres in the rectangle's frame, pixels (P, 2) in the same order.
    alternatives: other readings of the same pixels, each (P, 3): where the marking looks the same after a rotation
    (a chessboard rotated by 180 degrees, a blank sheet) the pixels stay and the points change places.
    frameset: index of the instant; sigma: standard deviation of a pixel coordinate, px; nan where it is not known.
    time: when the image was taken by its camera's clock, s; nan where unknown.
    common (P, 2): px by which one standard deviation of an error that all pixels share moves each of them (a camera's
    tone curve makes a tag look larger), beside sigma, which is each pixel's own; None where there is none.
    back: seen from behind, so that its points appear mirrored.
    """

    rectangle: str
    points: Floats
    pixels: Floats
    camera: str = ""
    frameset: int = 0
    alternatives: tuple[Floats, ...] = ()
    sigma: float = float("nan")
    time: float = float("nan")
    common: Floats | None = None
    back: bool = False

    @property
    def expected_sigma(self) -> float:
        """Sigma (px) to reckon with: the View's own, else that of corners of which nothing is known."""
        return _UNKNOWN_SIGMA if isnan(self.sigma) else self.sigma

    @property
    def readings(self) -> tuple[Floats, ...]:
        """Every reading (P, 3) of the pixels, the likeliest first."""
        return (self.points, *self.alternatives)
