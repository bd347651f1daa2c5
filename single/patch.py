"""What is printed: patches of ink and paper, which stay exact at any size."""

from dataclasses import dataclass

INK, PAPER = 0.0, 1.0


@dataclass(frozen=True)
class Patch:
    """An upright rectangle of one tone, 0 ink to 1 paper, or the ellipse within where it is round; edges in metres in
    the frame of the marked rectangle."""

    left: float
    top: float
    right: float
    bottom: float
    tone: float
    round: bool = False
