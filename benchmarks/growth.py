"""How time and memory grow: rings of 4 to 256 cameras that share only with their neighbours, 100 framesets.

    python benchmarks/growth.py [MOST CAMERAS]      up to 1000
    python benchmarks/growth.py wall [FRAMESETS]    64 cameras that all see one board, 1000 framesets

Each rig is solved in a process of its own, so that its peak of memory is its own. Beside the errors of positions
along a ring stands the least that any estimator could have (Cramer-Rao): of these corners, lenses unknown, sheets
exact.
"""

import json
import resource
import subprocess
import sys
import time
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from simulated import Simulated, errors, ring, wall

from quadrig.rig.adjustment.levenberg_marquardt import FreeParameters, at_state, undamped
from quadrig.rig.adjustment.normal_equations import linearise
from quadrig.rig.adjustment.priors import estimated_lenses, first_priors
from quadrig.rig.adjustment.schur import unit_covariances
from quadrig.rig.adjustment.state import State
from quadrig.rig.adjustment.tables import tables_of
from quadrig.rig.calibration import calibrate
from quadrig.rig.problem.build import build_problem
from quadrig.single.pose import stacked, step_by_camera_twist

FRAMESETS = 100
CAMERAS = (4, 8, 16, 32, 64, 128, 256, 512, 1000)
_USUAL_MOST = 256
WALL = 64, 1000
# Of the way round a ring, from the camera that is the frame.
_ROUND = (1 / 8, 1 / 4, 1 / 2)
# Below this many Views the fixed costs of a call show in its time, not its growth.
_LARGE = 1000


def one(made: Simulated) -> dict[str, Any]:
    """Processor time, memory and errors of one rig."""
    # A first small rig: imports are not what grows.
    warm = ring(3, 2)
    calibrate(warm.inputs, warm.rectangles, warm.views)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.process_time()
    rig = calibrate(made.inputs, made.rectangles, made.views)
    seconds = time.process_time() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    found = errors(made, rig)
    true = [made.rig_from_camera(rig.reference, camera.name).translation for camera in rig.cameras]
    off = [np.linalg.norm(c.rig_from_camera.translation - t) for c, t in zip(rig.cameras, true, strict=True)]
    return {
        "cameras": len(made.inputs),
        "views": len(made.views),
        "seconds": seconds,
        "simulated": before / 2**20,
        "peak": peak / 2**20,
        "thrown_out": sum(bool(fit.rejected) for fit in rig.fits),
        "steps": len(rig.costs),
        "focal": found.focal,
        "rotation": found.rotation,
        "centre": found.centre,
        "noise": rig.noise / made.noise,
        "along": _along(np.array(off), position_bounds(made)),
    }


def position_bounds(made: Simulated) -> np.ndarray:
    """The least root mean square errors (C,), m, of the cameras' positions from the first of them."""
    problem = build_problem(made.inputs, made.rectangles, made.views)
    observations, order = problem.observations(), [made.index(camera.name) for camera in problem.cameras]
    world_from_camera = made.world_from_camera[np.array(order)]
    nodes = stacked([made.world_from_rect[node.body][node.frameset] for node in problem.nodes])
    state = State(made.lenses[order], world_from_camera.inverse(), nodes)
    every, others = np.ones(observations.nodes, bool), np.array(order) > 0
    information = first_priors(problem, state.lens[:, 0]).information
    free = FreeParameters(estimated_lenses(problem), others, every, state.lens, information)
    there = linearise(observations, state, free.columns, made.noise)
    found = at_state(observations, state, free, made.noise, tables_of(observations), there)
    twist = len(free.columns) + np.arange(6)
    covariance = unit_covariances(undamped(found, free))[:, twist[:, None], twist]
    by_twist = step_by_camera_twist(world_from_camera)[:, 3:]
    bounds = np.empty(len(order))
    bounds[order] = np.sqrt(np.trace(by_twist @ covariance @ np.swapaxes(by_twist, 1, 2), axis1=1, axis2=2))
    return bounds


def _along(off: np.ndarray, bound: np.ndarray) -> list[tuple[float, float]]:
    """Root mean squares, mm, of errors (C,) and bounds (C,) of positions, m, some way round a ring from its frame."""
    way = np.arange(len(off)) / len(off)
    way = np.minimum(way, 1 - way)
    near = [np.abs(way - part) <= 1 / 16 for part in _ROUND]
    squares = [(np.mean(off[rows] ** 2), np.mean(bound[rows] ** 2)) for rows in near]
    return [(1000 * float(np.sqrt(error)), 1000 * float(np.sqrt(least))) for error, least in squares]


def main() -> None:
    """Print one table and the power."""
    arguments = sys.argv[1:]
    if arguments[:1] == ["wall"]:
        kinds = [("wall", WALL[0], int(arguments[1]) if len(arguments) > 1 else WALL[1])]
    else:
        most = int(arguments[0]) if arguments else _USUAL_MOST
        kinds = [("ring", cameras, FRAMESETS) for cameras in CAMERAS if cameras <= most]
    rows = []
    for kind in kinds:
        command = [sys.executable, __file__, "--one", *map(str, kind)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{kind} failed: {done.stderr.strip().splitlines()[-1]}")
        rows.append(json.loads(done.stdout))
        print(*kind, f"{rows[-1]['seconds']:.0f} s", file=sys.stderr)
    table = Table(title=f"{kinds[0][0]} of cameras, {kinds[0][2]} framesets")
    columns = (
        "cameras",
        "Views",
        "s",
        "ms/View",
        "peak GiB",
        "thrown out",
        "steps",
        "focal %",
        "deg",
        "mm",
        "noise/true",
        "mm, error/bound, 1/8, 1/4, 1/2 round",
    )
    for column in columns:
        table.add_column(column, justify="right")
    for row in rows:
        table.add_row(
            str(row["cameras"]),
            str(row["views"]),
            f"{row['seconds']:.2f}",
            f"{1000 * row['seconds'] / row['views']:.2f}",
            f"{row['peak']:.2f} ({row['simulated']:.2f} before)",
            str(row["thrown_out"]),
            str(row["steps"]),
            f"{row['focal']:.3f}",
            f"{row['rotation']:.3f}",
            f"{row['centre']:.1f}",
            f"{row['noise']:.4f}",
            ", ".join(f"{off:.2g}/{bound:.2g}" for off, bound in row["along"]),
        )
    console = Console(width=180)
    console.print(table)
    large = [row for row in rows if row["views"] >= _LARGE] or rows
    if len(large) > 1:
        views, seconds = (np.log([row[key] for row in large]) for key in ("views", "seconds"))
        power = np.polyfit(views, seconds, 1)[0]
        console.print(f"time ~ Views^{power:.2f} from {large[0]['views']} Views on; aims: at most 1.2, 60 s, 4 GiB")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        print(json.dumps(one({"ring": ring, "wall": wall}[sys.argv[2]](*map(int, sys.argv[3:])))))
    else:
        main()
