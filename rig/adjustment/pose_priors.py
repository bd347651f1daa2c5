"""What is known beforehand of poses: layouts that are given, and positions that the motion leaves open."""

from dataclasses import dataclass, field

import numpy as np

from quadrig.rig.adjustment.state import State
from quadrig.rig.adjustment.twist_jacobians import step_by_left_twist
from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose, stacked


@dataclass(frozen=True, eq=False)
class LayoutPrior:
    """What is known beforehand of the rectangles' poses on their bodies that are to be found: body_from_rect, a batch
    (F,), and 1/variance (F, 6) of its step."""

    mean: Pose = field(default_factory=lambda: stacked([]))
    information: Floats = field(default_factory=lambda: np.zeros((0, 6)))

    def steps(self, state: State) -> Floats:
        """The steps (F, 6) that lead from the prior's poses to the state's."""
        return self.mean.step_to(state.body_from_rect[: len(self.information)])

    def cost(self, state: State) -> float:
        """Chi-square of the state's poses."""
        return float((self.information * self.steps(state) ** 2).sum())

    def on_twists(self, state: State) -> tuple[Floats, Floats]:
        """Information (F, 6, 6) on the twists of the state's poses, and the gradient (F, 6) down the cost."""
        by_twist = step_by_left_twist(state.body_from_rect[: len(self.information)])
        weighed = np.swapaxes(by_twist, -1, -2) * self.information[:, None]
        return weighed @ by_twist, -(weighed @ self.steps(state)[..., None])[..., 0]


@dataclass(frozen=True, eq=False)
class PositionPrior:
    """A camera (an index) is held where it is, at a position (3,) m, along an axis (3,), both in the rig frame.
    information: 1/m^2."""

    camera: int
    axis: Floats
    position: Floats
    information: float

    def by_twist(self, state: State) -> Floats:
        """Derivative (6,) of the position along the axis by the twist of camera_from_rig @ exp(twist)."""
        here = state.camera_from_rig[self.camera].inverse().translation
        return -np.concatenate([np.cross(here, self.axis), self.axis])

    def away(self, state: State) -> float:
        """How far along the axis the camera is from where it is held, m."""
        return float(self.axis @ (state.camera_from_rig[self.camera].inverse().translation - self.position))

    def cost(self, state: State) -> float:
        """Chi-square of the state."""
        return self.information * self.away(state) ** 2

    def on_twist(self, state: State) -> tuple[Floats, Floats]:
        """Information (6, 6) on the camera's twist, and the gradient (6,) down the cost."""
        row = self.by_twist(state)
        return self.information * np.outer(row, row), -self.information * self.away(state) * row
