"""The lens that is handed out comes as near as its model can to the lens with what it leaves over."""

from collections import defaultdict

import numpy as np
import pytest

from quadrig.rig.joint.delivered_lens import delivered_lenses
from quadrig.single.lens import project, project_with_derivatives


def test_what_is_left_over_is_what_the_model_cannot_follow(jointly, simulated):
    problem, joint = jointly(simulated.simulate(44, simulated.Scene(cameras=3, framesets=14)))
    lenses, state = delivered_lenses(joint), joint.adjustment.state
    seen, chained = problem.observations(), state.camera_from_rect(joint.observations)
    held = {n for n in problem.node if len(set(problem.camera[problem.node == n])) > 1}
    for camera in range(3):
        left, alone, poses, total = defaultdict(list), [], defaultdict(list), 0.0
        for group, corrected in zip(seen.groups, joint.observations.groups, strict=True):
            for row in np.flatnonzero(group.camera == camera):
                counts, node = np.sqrt(np.repeat(corrected.weights[row], 2)), int(group.node[row])
                pose = chained[group.view[row]]
                located = pose.transform(corrected.points[row])
                pixels, _, by_point = project_with_derivatives(state.lens[camera], located)
                followed = project(lenses.lens[camera], located) - pixels
                field = (group.pixels[row] - corrected.pixels[row]).ravel()
                left[node].append(counts * (field - followed.ravel()))
                alone.append(counts * field)
                total += (counts**2).sum()
                turned = np.cross((located - pose.translation)[:, None], by_point)
                poses[node].append(np.concatenate([turned, by_point], axis=2).reshape(-1, 6) * counts[:, None])
        over = {node: np.concatenate(parts) for node, parts in left.items()}
        for node in over.keys() - held:
            # Its pose gives way, since no other camera holds it.
            by_pose = np.concatenate(poses[node])
            over[node] -= by_pose @ np.linalg.lstsq(by_pose, over[node])[0]
        left = list(over.values())
        rms = [np.sqrt((np.concatenate(part) ** 2).sum() / total) for part in (left, alone)]
        assert lenses.remainder[camera] == pytest.approx(rms[0], rel=0.02)
        assert rms[0] < rms[1]
