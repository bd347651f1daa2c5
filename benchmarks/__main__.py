"""One benchmark by name, from the root of the repository: python -m benchmarks NAME [ARGUMENTS]; none: a list."""

import ast
import runpy
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
# What the benchmarks share: not to be run.
_SHARED = {"__main__", "attacked", "body_bounds", "body_worlds", "mutations", "peers", "processor_time", "simulated"}


def names() -> dict[str, str]:
    """Every benchmark, with the first line of what it says of itself."""
    files = sorted(file for file in HERE.glob("*.py") if file.stem not in _SHARED)
    docstrings = {file.stem: ast.get_docstring(ast.parse(file.read_text())) or "" for file in files}
    return {name: text.partition("\n")[0] for name, text in docstrings.items()}


def main() -> None:
    """Run the one that is named."""
    if len(sys.argv) < 2 or sys.argv[1] not in names():
        width = max(len(name) for name in names())
        raise SystemExit("python -m benchmarks NAME\n" + "\n".join(f"{n:{width}}  {t}" for n, t in names().items()))
    sys.path.insert(0, str(HERE))
    file = HERE / f"{sys.argv.pop(1)}.py"
    sys.argv[0] = str(file)
    runpy.run_path(str(file), run_name="__main__")


if __name__ == "__main__":
    main()
