"""The lens that is handed out comes as near as its model can to the lens with what it leaves over."""

import numpy as np
import pytest

from quadrig.rig.joint.delivered_lens import delivered_lenses
from quadrig.single.lens import project


def test_what_is_left_over_is_what_the_model_cannot_follow(jointly, simulated):
    problem, joint = jointly(simulated.simulate(44, simulated.Scene(cameras=3, framesets=14)))
    lenses, state = delivered_lenses(joint), joint.adjustment.state
    seen = problem.observations()
    for camera in range(3):
        left, alone = [], []
        for group, corrected in zip(seen.groups, joint.observations.groups, strict=True):
            own = (group.camera == camera)[:, None] & (corrected.weights > 0)
            pose = state.camera_from_rect(joint.observations)[group.view]
            located = corrected.points @ np.swapaxes(pose.rotation, -1, -2) + pose.translation[:, None]
            followed = project(lenses.lens[camera], located) - project(state.lens[camera], located)
            field = group.pixels - corrected.pixels
            left.append((field - followed)[own])
            alone.append(field[own])
        rms = [np.sqrt(np.mean(np.concatenate(part) ** 2)) for part in (left, alone)]
        assert lenses.remainder[camera] == pytest.approx(rms[0], rel=0.02)
        assert rms[0] < rms[1]
