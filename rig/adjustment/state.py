"""What the joint adjustment estimates, and the chain of Eq. 50 with its derivatives:
camera_from_rect = camera_from_rig @ rig_from_body @ body_from_rect."""

from dataclasses import dataclass, field, replace

import numpy as np

from quadrig.rig.adjustment.motion import Motion
from quadrig.rig.problem.observations import Observations
from quadrig.single.arrays import Floats, Ints
from quadrig.single.lens import LENS_PARAMETERS
from quadrig.single.pose import Pose, stacked, step_by_inner_twist

LENS = len(LENS_PARAMETERS)


@dataclass(frozen=True, eq=False)
class State:
    """What is estimated: lenses (C, 9), camera_from_rig a batch (C,), rig_from_body a batch (N,) over the nodes, and
    body_from_rect a batch (L,) of the rectangles that are not the frame of their body.

    slack (V, 6): the step by which each View strays from the chain, where cameras are out of step; None for none.
    motion and clocks (C, 2): how moving bodies move between framesets, and each camera's offset, s, and line time, s
    a row; None where clocks are taken to agree and pictures to be of one instant.
    """

    lens: Floats
    camera_from_rig: Pose
    rig_from_body: Pose
    body_from_rect: Pose = field(default_factory=lambda: stacked([]))
    slack: Floats | None = None
    motion: Motion | None = None
    clocks: Floats | None = None

    def moved(self, lens: Floats, cameras: Floats, nodes: Floats, layouts: Floats | None = None) -> "State":
        """After steps of the lenses (C, 9), twists in the rig frame of cameras (C, 6) and nodes (N, 6), and in the
        body's frame of the first of the rectangles' poses, (L or fewer, 6)."""
        parts = [cameras, nodes, np.zeros((len(self.body_from_rect.translation), 6))]
        if layouts is not None:
            parts[2][: len(layouts)] = layouts
        step = Pose.from_twist(np.concatenate(parts))
        first, last = len(cameras), len(cameras) + len(nodes)
        return replace(
            self,
            lens=self.lens + lens,
            camera_from_rig=self.camera_from_rig @ step[:first],
            rig_from_body=step[first:last] @ self.rig_from_body,
            body_from_rect=step[last:] @ self.body_from_rect,
        )

    def rig_from_body_seen(self, observations: Observations) -> Pose:
        """Where the body of each View's rectangle stood when the View was taken: a batch (V,)."""
        pose = self.rig_from_body[observations.node]
        if self.motion is None or self.clocks is None:
            return pose
        return pose.retract(self.motion.step(self.clocks[observations.camera]))

    def rig_from_seen(self, observations: Observations) -> Pose:
        """Where each View's rectangle stood when the View was taken: a batch (V,)."""
        return self.on_body(self.rig_from_body_seen(observations), observations)

    def on_body(self, rig_from_body: Pose, observations: Observations) -> Pose:
        """The poses of the Views' rectangles (V,) from those of their bodies (V,)."""
        layout = observations.joins.layout
        rows = np.flatnonzero(layout >= 0)
        if not len(rows):
            return rig_from_body
        rotation, translation = rig_from_body.rotation.copy(), rig_from_body.translation.copy()
        seen = rig_from_body[rows] @ self.body_from_rect[layout[rows]]
        rotation[rows], translation[rows] = seen.rotation, seen.translation
        return Pose(rotation, translation)

    def camera_from_rect(self, observations: Observations) -> Pose:
        """Eq. 50 for every View, with its slack: a batch (V,)."""
        chained = self.camera_from_rig[observations.camera] @ self.rig_from_seen(observations)
        return chained if self.slack is None else chained.retract(self.slack)

    def readout(self, observations: Observations) -> "Readout | None":
        """What happens while the pictures of the Views are read out; None where they are taken to be of one
        instant."""
        if self.motion is None or self.clocks is None:
            return None
        body = self.rig_from_body_seen(observations)
        slope = self.motion.slope(self.clocks[observations.camera])
        arm = self.on_body(body, observations).translation - body.translation
        parts = slope[:, :3], slope[:, 3:] + np.cross(slope[:, :3], arm)
        rotation = self.camera_from_rig.rotation[observations.camera]
        rate = np.concatenate([(rotation @ part[..., None])[..., 0] for part in parts], axis=1)
        return Readout(rate, self.motion.row, self.clocks[observations.camera, 1])


@dataclass(frozen=True, eq=False)
class Readout:
    """What happens while the pictures of Views are read out. rate (V, 6): of the step of camera_from_rect, a second;
    row (V,): the one that camera_from_rect stands for; line (V,): line times, s a row.

    Within a View points go straight: of a board that fills a picture, turned by 1 rad/s, those at its rims are
    0.02 px off at 20 us a row.
    """

    rate: Floats
    row: Floats
    line: Floats

    def part(self, rows: Ints) -> "Readout":
        """That of some of the Views."""
        return Readout(self.rate[rows], self.row[rows], self.line[rows])

    def rows_below(self, pixels: Floats) -> Floats:
        """By how many rows pixels (V, P, 2) lie below the row of their View (V, P)."""
        return pixels[..., 1] - self.row[:, None]

    def velocity(self, turned: Floats) -> Floats:
        """m/s (V, P, 3) in the camera, of points that stand so (V, P, 3) from their rectangles' origins, along the
        camera's axes."""
        return np.cross(self.rate[:, None, :3], turned) + self.rate[:, None, 3:]

    def moved(self, turned: Floats, pixels: Floats) -> Floats:
        """Points (V, P, 3), as velocity has them, where they were when their rows were read out."""
        return turned + (self.line[:, None] * self.rows_below(pixels))[..., None] * self.velocity(turned)


@dataclass(frozen=True, eq=False)
class ChainDerivatives:
    """Derivatives of the step of camera_from_rect of every View: by its camera's twist, and offset and line time
    where they are estimated, (V, 6, 6 or 8); by its node's twist (V, 6, 6); by the twist of its rectangle on the body
    (V, 6, 6)."""

    by_camera: Floats
    by_node: Floats
    by_layout: Floats


def chain_derivatives(observations: Observations, state: State) -> ChainDerivatives:
    """The derivatives of the chain.

    Cameras and bodies are moved by twists in the rig frame: camera_from_rig @ exp(twist), exp(twist) @
    rig_from_body. A cluster of both that turns about a far point so follows its arc, and the twist of a camera is
    worth the same as that of the bodies it sees. A rectangle is moved by one in its body's frame: exp(twist) @
    body_from_rect.
    """
    rotation = state.camera_from_rig.rotation[observations.camera]
    body = state.rig_from_body_seen(observations)
    seen = state.on_body(body, observations)
    by_twist = step_by_inner_twist(rotation, seen.translation)
    by_layout = np.zeros((len(by_twist) if observations.joins.found else 0, 6, 6))
    if observations.joins.found:
        rows = np.flatnonzero(observations.joins.layout >= 0)
        on_body = state.body_from_rect.translation[observations.joins.layout[rows]]
        by_layout[rows] = step_by_inner_twist(rotation[rows] @ body.rotation[rows], on_body)
    readout = state.readout(observations)
    if state.motion is None or readout is None:
        return ChainDerivatives(by_twist, by_twist, by_layout)
    by_clock = readout.rate[:, :, None] * state.motion.by_clock[:, None]
    return ChainDerivatives(np.concatenate([by_twist, by_clock], axis=-1), by_twist, by_layout)
