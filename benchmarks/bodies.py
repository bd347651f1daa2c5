"""How near to the truth rigs come that are found from bodies, in the worlds of benchmarks/body_worlds.py.

Errors of rotation (degrees) and position (mm) of each camera but the first, in its frame, beside their sigmas: the
median over rigs, and how often the 95 % region of the pose holds the truth.

    python benchmarks/bodies.py [RIGS [WORLD]] [--lenses ../shared/data/lenses/lenses.csv]
"""

import argparse
import time
from pathlib import Path

import numpy as np
from body_worlds import WORLDS, Carried
from coverage import quantile
from rich.console import Console
from rich.table import Table
from worlds import Lens, lenses_of, table_lens

from quadrig.rig.calibration import calibrate
from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError


def solved(task: tuple[str, int, Lens]) -> tuple[list[tuple[float, float, float, float, float]], str]:
    """Of each camera but the first: errors of rotation (deg) and position (mm), their sigmas, and the quantile at
    which the truth lies; and what is weak."""
    name, seed, lens = task
    world = WORLDS[name](np.random.default_rng([seed, list(WORLDS).index(name)]), lens)
    begin = time.perf_counter()
    try:
        rig = calibrate(world.made.inputs, world.made.rectangles, world.made.views, "cam0")
    except QuadrigError as error:
        return [], str(error)
    took = time.perf_counter() - begin
    said = "; ".join((*rig.missing.values(), *rig.weak))
    return [errors_of(world, rig, camera.name) for camera in rig.cameras[1:]], f"{took:.0f} s; {said}"


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
    columns = ("world", "rigs", "cameras", "rotation deg", "sigma", "position mm", "sigma", "95 % regions hold")
    table = Table(*columns, title=f"bodies, {given.rigs} rigs each, medians")
    for name in [given.world] if given.world else list(WORLDS):
        results = [solved((name, seed, lens)) for seed in range(given.rigs)]
        rows = np.array([row for found, _ in results for row in found]).reshape(-1, 5)
        for found, said in results:
            for row in found:
                console.print(name, *(f"{value:.4g}" for value in row))
            console.print(name, said)
        if len(rows):
            turned, moved, turn_sigma, move_sigma, _ = np.median(rows, axis=0)
            held = f"{100 * (rows[:, 4] < 0.95).mean():.0f} %"
            cells = (f"{turned:.4f}", f"{turn_sigma:.4f}", f"{moved:.2f}", f"{move_sigma:.2f}")
            table.add_row(name, str(given.rigs), str(len(rows)), *cells, held)
    console.print(table)


if __name__ == "__main__":
    main()
