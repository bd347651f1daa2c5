"""`rig init`: a rig.toml out of what a recording, or live cameras, show in plain sight."""

import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated

import typer

from quadrig.io.config.rig_toml import CameraConfig, RigConfig, config_text, parse_config
from quadrig.io.verbosity import note, say
from quadrig.io.whole_file import refuse_no_place, write_text
from quadrig.rig.words import read_length
from quadrig.single.arrays import Picture
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Marking, Rectangle

# s that live cameras have to give their first pictures, and how many of each are looked at.
_PATIENCE, _PICTURES = 8.0, 3


def init(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            help="A recording: MCAP, videos, folders of pictures. Or live cameras: a number, /dev/video0, rtsp://... "
            "Asked for where none is given.",
            metavar="[NAME=]SOURCE...",
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH",
            help="Side of a square of the board, or of the black of a tag, as measured on paper. Else asked for.",
        ),
    ] = None,
    moving: Annotated[
        bool | None, typer.Option("--moving/--static", help="Carried about, or standing still; boards are carried.")
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="The rig.toml to write.")] = Path("rig.toml"),
    only_print: Annotated[bool, typer.Option("--print", help="Print it instead.")] = False,
    again: Annotated[bool, typer.Option("--again", help="Write over a rig.toml that is there.")] = False,
) -> None:
    """Look which tags and boards a recording shows, and write the rig.toml that describes them.

    What no picture shows is asked for: how large they are. Measure it on paper, after printing.

    Examples: rig init room.mcap --size 40mm; rig init left=0 right=1 --print
    """
    if not only_print:
        refuse_no_place(output)
        if output.exists() and not again:
            raise QuadrigError(f"{output} is there already; name another with -o, or write over it with --again")
    given = sources or _asked("the recording, or the cameras (room.mcap; left=0 right=1)", "SOURCE...").split()
    markings, cameras = _seen(given)
    if not markings:
        raise QuadrigError(
            f"{given[0]}: no tag and no board is in plain sight; show one whole and near, or describe what stands in "
            "the room by hand (rig target prints sheets and their lines)"
        )
    rectangles = [_rectangle(marking, markings, size, moving) for marking in markings]
    reference = cameras[0].name if cameras else None
    text = _HEAD.format(" ".join(given)) + config_text(RigConfig(tuple(rectangles), tuple(cameras), reference))
    parse_config(text)
    if only_print:
        print(text, end="")
        return
    write_text(output, text)
    print(output)
    what = "rig setup" if cameras else f"rig calibrate {' '.join(given)}"
    say(f"read it over, then: {what} --config {output}")


_HEAD = """# What {} shows in plain sight. Check what is said of each sheet: lengths are
# metres, measured on paper (or a text with a unit, "40mm"); a sheet with moving = true is carried about.
"""


def _seen(given: Sequence[str]) -> tuple[tuple[Marking, ...], list[CameraConfig]]:
    """What is in sight, and the live cameras that see it."""
    from quadrig.io.live.capture.chosen_sources import is_live

    if not any(map(is_live, given)):
        from quadrig.io.recording.recorded_cameras import open_recording
        from quadrig.io.search.in_sight import recording_in_sight

        opened = open_recording(list(given))
        for remark in opened.notes:
            note(remark)
        return recording_in_sight(opened), []
    from quadrig.io.search.in_sight import together
    from quadrig.single.markings.in_sight import markings_in_sight

    pictures, cameras = _live_pictures(given)
    return together([markings_in_sight(each) for each in pictures]), cameras


def _live_pictures(given: Sequence[str]) -> tuple[list[list[Picture]], list[CameraConfig]]:
    from quadrig.io.live.capture.chosen_sources import named_sources
    from quadrig.io.live.capture.source import Source

    specs = named_sources(list(given), RigConfig(()), Path())
    with ExitStack() as stack:
        sources = [stack.enter_context(closing(Source(name, spec))) for name, spec in specs.items()]
        until = time.monotonic() + _PATIENCE
        while time.monotonic() < until and any(len(source.frames()) < _PICTURES for source in sources):
            time.sleep(0.05)
        pictures = [[frame.grey for frame in source.frames()[-_PICTURES:]] for source in sources]
        blind = [source.state() for source, seen in zip(sources, pictures, strict=True) if not seen]
    if blind:
        raise QuadrigError(f"no picture from {blind[0].name}: {blind[0].detail or 'nothing came'}")
    addresses = [spec.address for spec in specs.values()]
    return pictures, [
        CameraConfig(name, source=int(address) if address.isdigit() else address)
        for name, address in zip(specs, addresses, strict=True)
    ]


def _rectangle(marking: Marking, every: Sequence[Marking], size: str | None, moving: bool | None) -> Rectangle:
    """A marking of unit size with the size that it has on paper, and a name of its own."""
    single = marking.size is None
    what = "the black of a tag" if single or marking.kind == "aprilgrid" else "a square"
    metres = read_length(size or _asked(f"{marking.description}: side of {what} (such as 40mm)", "--size LENGTH"))
    real = marking.scaled(metres)
    width, height = real.size or (metres, metres)
    alike = [one for one in every if one.noun == marking.noun]
    tag = getattr(marking, "id", None)
    name = f"tag{tag}" if tag is not None else marking.noun + (str(alike.index(marking)) if len(alike) > 1 else "")
    return Rectangle(name, width, height, real, moving=not single if moving is None else moving)


def _asked(question: str, option: str) -> str:
    """The answer of whoever sits at the terminal. Raises QuadrigError where nobody does."""
    if not sys.stdin.isatty():
        raise QuadrigError(f"{question}? Nobody can be asked here; give {option}")
    return typer.prompt(question, err=True)
