"""How near to the truth rigs come that are found from bodies, in the worlds of benchmarks/body_worlds.py.

Errors of rotation (degrees) and position (mm) of each camera but the first, in its frame, beside their sigmas and the
least that any estimator can have (benchmarks/body_bounds.py), which is also given for exact sheets and for lenses
that are known: medians over rigs, and how often the 95 % region of the pose holds the truth. Where cameras are out of
step, the errors of offsets (ms) and line times (per cent) follow.

    python benchmarks/bodies.py [RIGS [WORLD]] [--lenses ../shared/data/lenses/lenses.csv]
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from body_bounds import least_errors
from body_worlds import WORLDS, Carried
from coverage import quantile
from rich.console import Console
from rich.table import Table
from worlds import Lens, lenses_of, table_lens

from quadrig.rig.calibration import calibrate
from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError

# Asked of rigs that are carried: degrees, mm.
_ASKED = {"carried": (0.02, 0.5)}


@dataclass(frozen=True, eq=False)
class Outcome:
    """Of one rig: rows (C - 1, 5) of errors_of, the least errors (3, C - 1, 2) with sheets and lenses as they are,
    with exact sheets, and with known lenses; clocks (C, 2), errors of offsets (ms) and line times (per cent); what
    is said."""

    rows: Floats
    least: Floats
    clocks: Floats
    said: str


def solved(name: str, seed: int, lens: Lens) -> Outcome:
    """One rig of a world. Worlds of the same cameras and rooms begin with the same draws."""
    drawn = "carried" if name == "rolling" else name
    world = WORLDS[name](np.random.default_rng([seed, list(WORLDS).index(drawn)]), lens)
    nothing = np.zeros((0, 5)), np.zeros((3, 0, 2)), np.zeros((0, 2))
    begin = time.process_time()
    try:
        rig = calibrate(world.made.inputs, world.made.rectangles, world.made.views, "cam0")
    except QuadrigError as error:
        return Outcome(*nothing, str(error))
    took = time.process_time() - begin
    said = "; ".join((*rig.missing.values(), *rig.weak))
    placed = [int(camera.name.removeprefix("cam")) for camera in rig.cameras[1:]]
    rows = np.array([errors_of(world, rig, f"cam{camera}") for camera in placed]).reshape(-1, 5)
    least = [least_errors(world), least_errors(world, exact=True), least_errors(world, lenses=False)]
    own = np.array(least)[:, np.array(placed, int) - 1]
    return Outcome(rows, own, clock_errors(world, rig), f"{took:.0f} s of processor; {said}")


def clock_errors(world: Carried, rig: Rig) -> Floats:
    """Errors (C, 2) of offsets, ms, and of line times, per cent; none where cameras are in step."""
    if not world.clocks.any() or len(rig.cameras) < len(world.clocks):
        return np.zeros((0, 2))
    clocks = world.clocks - [world.clocks[:, 0].mean(), 0]
    found = np.array([(camera.clock_offset, camera.line_time) for camera in rig.cameras])
    return np.stack([1e3 * (found - clocks)[:, 0], 100 * (found[:, 1] / clocks[:, 1] - 1)], axis=1)


def errors_of(world: Carried, rig: Rig, name: str) -> tuple[float, float, float, float, float]:
    """Errors of the pose of a camera in the frame of cam0, their sigmas, and the truth's quantile."""
    step = rig.camera(name).rig_from_camera.step_to(world.true(0, int(name.removeprefix("cam"))))
    turned, moved = np.degrees(np.linalg.norm(step[:3])), 1e3 * np.linalg.norm(step[3:])
    sigma = np.degrees(np.sqrt(3) * rig.rotation_sigma(name)), 1e3 * np.sqrt(3) * rig.position_sigma(name)
    return float(turned), float(moved), float(sigma[0]), float(sigma[1]), quantile(step, rig.pose_covariance(name))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rigs", nargs="?", type=int, default=4)
    parser.add_argument("world", nargs="?", choices=list(WORLDS))
    parser.add_argument("--lenses", type=Path)
    given = parser.parse_args()
    lens = table_lens if given.lenses is None else lenses_of(given.lenses)
    console = Console()
    columns = ("world", "rigs", "cameras", "rotation deg", "sigma", "least", "exact sheets", "known lenses")
    columns += ("position mm", "sigma", "least", "95 % regions hold", "offset ms", "line time %")
    table = Table(*columns, title=f"bodies, {given.rigs} rigs each, medians")
    for name in [given.world] if given.world else list(WORLDS):
        results = [solved(name, seed, lens) for seed in range(given.rigs)]
        for one in results:
            for row in one.rows:
                console.print(name, *(f"{value:.4g}" for value in row))
            console.print(name, one.said)
        rows = np.concatenate([one.rows for one in results])
        if len(rows):
            turned, moved, turn_sigma, move_sigma, _ = np.median(rows, axis=0)
            least = np.median(np.concatenate([one.least for one in results], axis=1), axis=1)
            clocks = np.concatenate([one.clocks for one in results])
            late, line = np.median(np.abs(clocks), axis=0) if len(clocks) else (np.nan, np.nan)
            cells = [f"{turned:.4f}", f"{turn_sigma:.4f}", *(f"{one:.4f}" for one in least[:, 0])]
            cells += [f"{moved:.2f}", f"{move_sigma:.2f}", f"{least[0, 1]:.2f}"]
            cells += [f"{100 * (rows[:, 4] < 0.95).mean():.0f} %", f"{late:.3f}", f"{line:.2f}"]
            table.add_row(name, str(given.rigs), str(len(rows)), *cells)
            if name in _ASKED and (least[0] > _ASKED[name]).any():
                console.print(
                    f"{name}: asked are {_ASKED[name][0]} deg and {_ASKED[name][1]} mm, but no estimator is better "
                    f"than {least[0, 0]:.4f} deg and {least[0, 1]:.2f} mm"
                )
    console.print(table)


if __name__ == "__main__":
    main()
