"""`rig import`: a rig.mcap out of the files of another program."""

import re
from pathlib import Path
from typing import Annotated

import typer

from quadrig.io.formats.any_file import read_any_rig
from quadrig.io.rig_file.rig_mcap import write_rig
from quadrig.io.verbosity import note
from quadrig.rig.words import counted, read_length


def import_(
    files: Annotated[list[Path], typer.Argument(help="Files of one rig, or a folder of COLMAP's.", metavar="FILE")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The rig to write.")] = Path("rig.mcap"),
    size: Annotated[str | None, typer.Option(help="The pictures' size where no file says it: 1920x1080.")] = None,
    unit: Annotated[
        str | None, typer.Option(help="The unit of lengths where the files do not say it: m, cm, mm, or 0.37m.")
    ] = None,
) -> None:
    """Make a rig.mcap of the files of another program: any that `rig export --list` calls "in".

    What the files do not say, such as how sure the poses are, stays unknown.

    Examples: rig import camchain.yaml; rig import left.yaml right.yaml rig.urdf -o rig.mcap
    """
    metres = None if unit is None else read_length(unit if unit[:1].isdigit() else f"1{unit}")
    rig = read_any_rig(*files, unit=metres, size=None if size is None else _size(size))
    write_rig(output, rig, recordings=files)
    print(f"{output}: {counted(len(rig.cameras), 'camera')} in the frame of {rig.reference}")
    if not rig.is_doubt_known:
        note("what they say of how sure they are is not all; `rig info` shows what is known")


def _size(words: str) -> tuple[int, int]:
    found = re.fullmatch(r"([1-9]\d*)x([1-9]\d*)", words)
    if found is None:
        raise typer.BadParameter(f"{words!r} is no size; give one such as 1920x1080", param_hint="--size")
    return int(found[1]), int(found[2])
