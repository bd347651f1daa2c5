"""Does `rig check` keep its promise? Rigs calibrated and looked at again, with small recordings and usual ones.

False alarms: any camera of a rig that did not move is called moved (promised: 1 %). Power: a shift of one camera by
six of its own sigmas, in a random direction of its six, is found.

    python benchmarks/moved.py [RIGS]
"""

import sys
from multiprocessing import Pool

import numpy as np
from simulated import Scene, moved_poses, simulate, usual_scene, views_again

from quadrig.rig.calibration import calibrate
from quadrig.rig.moved import find_moved
from quadrig.single.errors import QuadrigError

# What is calibrated from, and with how many framesets it is looked at again.
KINDS = {
    "a board, 20 to 40 framesets; again 20": ({}, 20),
    "a board, 10 framesets; again 6": ({"cameras": 3, "framesets": 10, "tags": 0}, 6),
    "a board, 10 framesets; again 2": ({"cameras": 3, "framesets": 10, "tags": 0}, 2),
    "four corners, 20 framesets; again 6": ({"cameras": 3, "framesets": 20, "tags": 0, "board": False}, 6),
    "four corners, 10 framesets; again 4": ({"cameras": 3, "framesets": 10, "tags": 0, "board": False}, 4),
}
_SIGMAS = 6.0


def trial(task: tuple[str, int]) -> tuple[bool, bool] | None:
    """Whether a rig that stood was called moved, and whether a nudge was found; None where nothing is known."""
    kind, seed = task
    given, again = KINDS[kind]
    rng = np.random.default_rng(seed)
    made = simulate(rng, usual_scene(rng, **given))
    scene = Scene(len(made.inputs), again, made.noise, given.get("board", True))
    looked = int(rng.integers(2**31))
    try:
        rig = calibrate(made.inputs, made.rectangles, made.views)
        still = find_moved(rig, made.rectangles, views_again(made, scene, looked))
        known = [i for i, move in enumerate(still) if i and np.isfinite(move.chance)]
        if not known:
            return None
        index = int(rng.choice(known))
        direction = rng.normal(size=6)
        values, axes = np.linalg.eigh(still[index].covariance)
        step = _SIGMAS * axes @ (np.sqrt(np.maximum(values, 0)) * direction / np.linalg.norm(direction))
        poses = moved_poses(made, rig.reference, index, step)
        nudged = find_moved(rig, made.rectangles, views_again(made, scene, looked, poses))
    except QuadrigError:
        return None
    alarm = any(move.state == "moved" for move in still)
    return alarm, any(move.state == "moved" for move in nudged)


def main() -> None:
    """Both figures for each kind of recording."""
    rigs = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    print(f"{'calibrated from; looked at again with':42}{'known':>6}{'false alarms':>16}{'6 sigmas found':>18}")
    with Pool() as pool:
        for kind in KINDS:
            found = [one for one in pool.map(trial, [(kind, seed) for seed in range(rigs)]) if one is not None]
            alarms, finds = (np.array([one[k] for one in found]) for k in (0, 1))
            print(f"{kind:42}{len(found):>6}{_share(alarms):>16}{_share(finds):>18}", flush=True)


def _share(found: np.ndarray) -> str:
    """A share in per cent with its standard error."""
    share = found.mean()
    return f"{100 * share:.1f} ± {100 * np.sqrt(max(share * (1 - share), 0.5 / len(found)) / len(found)):.1f} %"


if __name__ == "__main__":
    main()
