"""How long the command line takes to start: processor time of --help of every command, and of rig info of files.

    python benchmarks/startup.py [FILE...]

Each is a process of its own, run in turn with an empty Python and one that imports numpy, which are the floor; the
quickest run of each counts, compiled files in place.
"""

import os
import resource
import subprocess
import sys
import tempfile

from rich.console import Console
from rich.table import Table

from quadrig.io.commands.main import COMMANDS

_RUNS = 5
_RIG = "from quadrig.io.commands.main import main; main()"
# Seconds of processor time that a start may take.
_AIMS = {"rig --help": 0.15, "rig info": 0.3, "rig calibrate --help": 0.3}


def seconds(code: str, arguments: list[str], compiled: str) -> float:
    """Processor time of a Python process; compiled: the folder of its compiled files."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPYCACHEPREFIX"] = compiled
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, env=environment)
    if done.returncode:
        raise SystemExit(f"rig {' '.join(arguments)} failed: {done.stderr.decode().strip()}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print one table."""
    starts: dict[str, tuple[str, list[str]]] = {
        "python": ("pass", []),
        "python, numpy": ("import numpy", []),
        "rig --help": (_RIG, ["--help"]),
    }
    starts |= {f"rig {name} --help": (_RIG, [name, "--help"]) for name in COMMANDS}
    starts |= {f"rig info {file}": (_RIG, ["info", file]) for file in sys.argv[1:]}
    table = Table(title=f"processor time of a start, least of {_RUNS} runs in turn")
    for column in ("start", "s", "aim"):
        table.add_column(column, justify="left" if column == "start" else "right")
    with tempfile.TemporaryDirectory() as compiled:
        runs = [
            {name: seconds(code, given, compiled) for name, (code, given) in starts.items()} for _ in range(_RUNS + 1)
        ]
    for name in starts:
        aim = next((aim for start, aim in _AIMS.items() if name.startswith(start)), None)
        table.add_row(name, f"{min(run[name] for run in runs):.3f}", "" if aim is None else f"{aim:.2f}")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
