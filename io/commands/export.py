"""`rig export`: a rig in the format of another program."""

from pathlib import Path
from typing import Annotated

import typer

from quadrig.io.formats.registry import FORMATS, export_files
from quadrig.io.rig_file.rig_mcap import read_rig
from quadrig.io.whole_file import write_text
from quadrig.single.errors import QuadrigError

_FORMATS = "; ".join(f"{name}: {form.what}" for name, form in FORMATS.items())


def export(
    rig: Annotated[Path, typer.Argument(help="The rig.mcap to export.", metavar="RIG.mcap")],
    form: Annotated[str, typer.Option("--format", "-f", metavar="FORMAT", help=_FORMATS)] = "json",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="A file, or a folder for formats of several files.")
    ] = None,
) -> None:
    """Write a rig in the format of another program; to standard output where it is one file and none is named.

    Examples: rig export rig.mcap --format json; rig export rig.mcap --format ros -o camera_info
    """
    if form not in FORMATS:
        raise typer.BadParameter(f"there is no {form!r}; there are {', '.join(FORMATS)}", param_hint="--format")
    files = export_files(read_rig(rig), form)
    if output is None:
        if len(files) > 1:
            raise QuadrigError(f"{form} is {len(files)} files ({', '.join(files)}); name a folder with -o")
        print(next(iter(files.values())), end="")
        return
    for path in _write(files, output, FORMATS[form].single):
        print(path)


def _write(files: dict[str, str], output: Path, single: bool) -> list[Path]:
    if single and not output.is_dir():
        write_text(output, next(iter(files.values())))
        return [output]
    output.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        write_text(output / name, text)
    return [output / name for name in files]
