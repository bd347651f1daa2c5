"""The lens that is handed out comes as near as its model can to the lens with what it leaves over."""

from collections import defaultdict

import numpy as np
import pytest

from quadrig.rig.joint.delivered_lens import delivered_lenses
from quadrig.single.lens import project, project_with_derivatives


def test_what_is_left_over_is_what_the_model_cannot_follow(jointly, simulated):
    problem, joint = jointly(simulated.simulate(44, simulated.Scene(cameras=1, framesets=14)))
    lenses, state = delivered_lenses(joint), joint.adjustment.state
    seen, chained = problem.observations(), state.camera_from_rect(joint.observations)
    left, alone, poses, total = defaultdict(list), [], defaultdict(list), 0.0
    for group, corrected in zip(seen.groups, joint.observations.groups, strict=True):
        for row, node in enumerate(group.node.tolist()):
            counts, pose = np.sqrt(np.repeat(corrected.weights[row], 2)), chained[group.view[row]]
            located = pose.transform(corrected.points[row])
            pixels, _, by_point = project_with_derivatives(state.lens[0], located)
            field = group.pixels[row] - corrected.pixels[row]
            left[node].append(counts * (field - project(lenses.lens[0], located) + pixels).ravel())
            alone.append(counts * field.ravel())
            turned = np.cross((located - pose.translation)[:, None], by_point)
            poses[node].append(np.concatenate([turned, by_point], axis=2).reshape(-1, 6) * counts[:, None])
            total += (counts**2).sum()
    over = []
    for node, parts in left.items():
        # The rectangles' poses give way, since no other camera holds them.
        by_pose, own = np.concatenate(poses[node]), np.concatenate(parts)
        over.append(own - by_pose @ np.linalg.lstsq(by_pose, own)[0])
    rms = [np.sqrt((np.concatenate(part) ** 2).sum() / total) for part in (over, alone)]
    assert lenses.remainder[0] == pytest.approx(rms[0], rel=0.02)
    assert rms[0] < rms[1]
