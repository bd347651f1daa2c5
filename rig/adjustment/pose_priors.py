"""What is known beforehand of poses: layouts that are given, and motions of cameras that nothing shows."""

from dataclasses import dataclass, field

import numpy as np

from quadrig.rig.adjustment.state import State
from quadrig.single.arrays import Floats
from quadrig.single.pose import Pose, stacked, step_by_left_twist


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
class MotionPrior:
    """A camera (an index) is held at a pose, rig_from_camera, against small motions of the rig frame: twists (6, K),
    orthonormal. information: 1/rad^2 and 1/m^2."""

    camera: int
    twists: Floats
    rig_from_camera: Pose
    information: float

    def _motion(self, state: State) -> Pose:
        """The motion that leads from the held pose to the state's."""
        return state.camera_from_rig[self.camera].inverse() @ self.rig_from_camera.inverse()

    def away(self, state: State) -> Floats:
        """How far (K,) along the twists the camera is from where it is held."""
        return self.twists.T @ Pose.identity().step_to(self._motion(state))

    def cost(self, state: State) -> float:
        """Chi-square of the state."""
        return float(self.information * (self.away(state) ** 2).sum())

    def on_twist(self, state: State) -> tuple[Floats, Floats]:
        """Information (6, 6) on the camera's twist, and the gradient (6,) down the cost."""
        rows = -self.twists.T @ step_by_left_twist(self._motion(state))
        return self.information * rows.T @ rows, -self.information * rows.T @ self.away(state)
