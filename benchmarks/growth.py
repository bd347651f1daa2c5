"""How time and memory grow: rings of 4 to 256 cameras that share only with their neighbours, 100 framesets.

    python benchmarks/growth.py [MOST CAMERAS]

Each ring is solved in a process of its own, so that its peak of memory is its own.
"""

import json
import resource
import subprocess
import sys
import time

import numpy as np
from rich.console import Console
from rich.table import Table
from simulated import errors, ring

from quadrig.rig.calibration import calibrate

FRAMESETS = 100
CAMERAS = (4, 8, 16, 32, 64, 128, 256)
# Below this many Views the fixed costs of a call show in its time, not its growth.
_LARGE = 1000


def one(cameras: int) -> dict[str, float]:
    """Processor time, memory and errors of one ring."""
    made = ring(cameras, FRAMESETS)
    # A first small rig: imports are not what grows.
    warm = ring(3, 2)
    calibrate(warm.inputs, warm.rectangles, warm.views)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.process_time()
    rig = calibrate(made.inputs, made.rectangles, made.views)
    seconds = time.process_time() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    found = errors(made, rig)
    return {
        "cameras": cameras,
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
    }


def main() -> None:
    """Print one table and the power."""
    most = int(sys.argv[1]) if len(sys.argv) > 1 else CAMERAS[-1]
    rows = []
    for cameras in (c for c in CAMERAS if c <= most):
        done = subprocess.run([sys.executable, __file__, "--one", str(cameras)], capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{cameras} cameras failed: {done.stderr.strip().splitlines()[-1]}")
        rows.append(json.loads(done.stdout))
    table = Table(title=f"ring of cameras, {FRAMESETS} framesets")
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
        )
    console = Console(width=140)
    console.print(table)
    large = [row for row in rows if row["views"] >= _LARGE] or rows
    if len(large) > 1:
        views, seconds = (np.log([row[key] for row in large]) for key in ("views", "seconds"))
        power = np.polyfit(views, seconds, 1)[0]
        console.print(f"time ~ Views^{power:.2f} from {large[0]['views']} Views on; aims: at most 1.2, 60 s, 4 GiB")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        print(json.dumps(one(int(sys.argv[2]))))
    else:
        main()
