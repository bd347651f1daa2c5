"""`rig pick`: a page in the browser to point at corners of rectangles in pictures."""

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from quadrig.io.config.corners_toml import corners_beside
from quadrig.io.config.rig_toml import read_config
from quadrig.io.local_page import LocalPage
from quadrig.io.recording.framesets import build_framesets
from quadrig.io.search.whole_recording import open_described
from quadrig.io.verbosity import note, say
from quadrig.single.errors import QuadrigError


def pick(
    recording: Annotated[
        list[Path],
        typer.Argument(help="MCAP files, videos, folders, or a picture of each camera.", metavar="RECORDING"),
    ],
    config: Annotated[Path, typer.Option("--config", "-c", help="What stands in the room.")] = Path("rig.toml"),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Of 127.0.0.1; else a free one.")] = 0,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Only print the page's address; open it yourself.")
    ] = False,
) -> None:
    """Point at the corners of rectangles in pictures, in the browser.

    For the rectangles of rig.toml with marking = { kind = "points" }: a court, a pitch, a window, a table. The page
    shows all pictures with a magnifier; a click goes to the nearest crossing of edges, at most 5 px off, and U takes
    that back. Every corner is kept at once in corners.toml beside rig.toml, which `rig calibrate` reads; Ctrl-C ends
    it. The page is served on this machine alone, to whoever has its address.

    Example: rig pick left.jpg middle.jpg right.jpg --config rig.toml; then
    rig calibrate left.jpg middle.jpg right.jpg --config rig.toml
    """
    from quadrig.io.pick.answers import answers
    from quadrig.io.pick.session import PickSession

    described = read_config(config)
    if not any(rectangle.marking.by_hand for rectangle in described.rectangles):
        raise QuadrigError(
            f'{config}: no rectangle has marking = {{ kind = "points" }}; give that to one whose corners you point at'
        )
    opened = open_described(recording, described)
    for remark in opened.notes:
        note(remark)
    session = PickSession(opened, build_framesets(opened), described, corners_beside(config))
    session.corners()
    with LocalPage(answers(session), port) as page:
        print(page.url, flush=True)
        say("Ctrl-C ends it; every corner is kept as soon as it is placed")
        if not no_browser:
            webbrowser.open(page.url)
        try:
            page.serve()
        except KeyboardInterrupt:
            kept = f"kept in {session.path}" if session.path.exists() else "no corner was placed"
            say(f"\n{kept}")
