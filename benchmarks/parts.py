"""Parts of one real recording, calibrated apart: whether they differ by no more than their sigmas allow.

    python benchmarks/parts.py RIG.mcap [RIG.mcap ...]

RIG.mcap: as `rig calibrate` wrote it, with its Views. Halves, and alternating blocks of the recording. Differences of
lenses and of poses as multiples of what is claimed (root mean square: 0.7 to 1.3 wanted), and whether `rig check` of
one part against the other calls a camera moved.
"""

import sys
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from quadrig.io import read_rig
from quadrig.rig import CameraInput, Rig, View, calibrate, compare, find_moved
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError

# Blocks long enough that neighbours in time are in one part, and short enough that both parts see the same room.
_BLOCKS = 6


def parts(views: list[View], blocks: int) -> list[list[View]]:
    """Two parts of the framesets: alternate ones of so many blocks in a row."""
    framesets = sorted({view.frameset for view in views})
    part = {frameset: blocks * index // len(framesets) % 2 for index, frameset in enumerate(framesets)}
    return [[view for view in views if part[view.frameset] == side] for side in (0, 1)]


def solved(rig: Rig, views: list[View]) -> Rig:
    """The cameras of a rig calibrated anew, nothing given, from some of its Views."""
    inputs = [CameraInput(c.name, c.intrinsics.width, c.intrinsics.height) for c in rig.cameras]
    return calibrate(inputs, [placed.rectangle for placed in rig.rectangles], views)


def row(path: Path, name: str, blocks: int) -> list[str]:
    """One line of the table."""
    rig = read_rig(path)
    sides = parts([fit.view for fit in rig.fits], blocks)
    try:
        first, second = (solved(rig, side) for side in sides)
    except QuadrigError as error:
        return [path.stem, name, str(error), "", ""]
    every = [one.apart for one in compare(first, second).cameras]
    lens, pose = (
        np.array([one[part].sigmas / np.sqrt(one[part].freedoms) for one in every]) for part in ("lens", "pose")
    )
    moved = find_moved(first, [placed.rectangle for placed in rig.rectangles], sides[1])
    alarms = [move.name for move in moved if move.state == "moved"]
    return [path.stem, name, _figures(lens), _figures(pose), ", ".join(alarms) or "none"]


def _figures(sigmas: Floats) -> str:
    return f"{np.sqrt(np.mean(sigmas**2)):.2f} ({', '.join(f'{one:.1f}' for one in sigmas)})"


def main() -> None:
    """Print one table."""
    table = Table(title="parts of one recording: differences in their sigmas, rms (each camera)")
    for column in ("recording", "parts", "lenses", "poses", "called moved"):
        table.add_column(column)
    for argument in sys.argv[1:]:
        for name, blocks in (("halves", 2), ("blocks", _BLOCKS)):
            table.add_row(*row(Path(argument), name, blocks))
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
