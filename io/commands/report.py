"""`rig report`: a rig and its evidence as one HTML page."""

from pathlib import Path
from typing import Annotated

import typer

from quadrig.io.rig_file.rig_mcap import read_rig_file
from quadrig.io.whole_file import write_text


def report(
    rig: Annotated[Path, typer.Argument(help="The rig.mcap to report on.", metavar="RIG.mcap")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The page to write.")] = Path("report.html"),
) -> None:
    """Write a rig and its evidence as one HTML page: verdict, cameras, room, residuals. It needs no network.

    Example: rig report rig.mcap -o report.html
    """
    from quadrig.io.report.page import report_html

    write_text(output, report_html(read_rig_file(rig), rig.name))
    print(output)
