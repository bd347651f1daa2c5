"""`rig init`: a rig.toml out of what a recording, or live cameras, show in plain sight."""

import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from quadrig.io.config.rig_toml import CameraConfig, RigConfig, config_text, parse_config
from quadrig.io.verbosity import note, say
from quadrig.io.whole_file import refuse_no_place, write_text
from quadrig.rig.words import read_length
from quadrig.single.arrays import Picture
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Marking, Rectangle

if TYPE_CHECKING:
    from quadrig.single.markings.in_sight import Sighting

# s that live cameras have to give their first pictures, and how many of each are looked at.
_PATIENCE, _PICTURES = 8.0, 3


def init(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            help="A recording: MCAP, videos, folders of pictures. Or live cameras: a number, /dev/video0, rtsp://... "
            "Asked for where none is given.",
            metavar="[NAME=]SOURCE",
        ),
    ] = None,
    size: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[SHEET=]LENGTH",
            help="Side of a square of a board, or of the black of a tag, as measured on paper: of the one kind of "
            "sheet there is, or of a kind (tag=200mm, charuco, aprilgrid, chessboard), or of one (tag3=35cm). "
            "Else asked for.",
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

    Example: rig init room.mcap --size tag=200mm --size charuco=40mm
    """
    if not only_print:
        refuse_no_place(output)
        if output.exists() and not again:
            raise QuadrigError(f"{output} is there already; name another with -o, or write over it with --again")
    given = sources or _asked("the recording, or the cameras (room.mcap; left=0 right=1)", "SOURCE...").split()
    sizes = _read_sizes(size or [])
    sightings, cameras = _seen(given)
    if not sightings:
        raise QuadrigError(
            f"{given[0]}: no tag and no board is in plain sight; show one whole and near, or describe what stands in "
            "the room by hand (rig target prints sheets and their lines)"
        )
    sheets = _named([sighting.marking for sighting in sightings])
    _refuse_unclear(sizes, sheets)
    rectangles = [_rectangle(name, marking, sizes, moving) for name, marking in sheets.items()]
    doubts = [*_shared(sizes, sheets), *_estimated(sheets, sightings)]
    for doubt in doubts:
        note(doubt)
    reference = cameras[0].name if cameras else None
    head = _HEAD.format(" ".join(given)) + "".join(f"# {doubt}.\n" for doubt in doubts)
    text = head + config_text(RigConfig(tuple(rectangles), tuple(cameras), reference))
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


def _seen(given: Sequence[str]) -> "tuple[list[Sighting], list[CameraConfig]]":
    """What is in sight, and the live cameras that see it."""
    from quadrig.io.live.capture.chosen_sources import is_live

    if any(map(is_live, given)):
        from quadrig.single.markings.in_sight import markings_in_sight, together

        pictures, cameras = _live_pictures(given)
        sightings = together([markings_in_sight(each) for each in pictures])
        return _seen_again(sightings, sum(map(len, pictures))), cameras
    from quadrig.io.recording.recorded_cameras import open_recording
    from quadrig.io.search.in_sight import recording_in_sight

    opened = open_recording(list(given))
    for remark in opened.notes:
        note(remark)
    return _seen_again(*recording_in_sight(opened)), []


def _seen_again(sightings: "Sequence[Sighting]", looked_at: int) -> "list[Sighting]":
    """Without tags that one picture of several shows: clutter is read as a tag once, a sheet is there for longer."""
    once = [one for one in sightings if one.marking.kind == "tag" and one.times == 1 and looked_at > 1]
    if once:
        listed = ", ".join(one.marking.description for one in once)
        note(f"left out, as only one of {looked_at} pictures shows it: {listed}")
    return [one for one in sightings if one not in once]


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


def _named(markings: Sequence[Marking]) -> dict[str, Marking]:
    """The markings by names of their own: tag3, board, board1."""
    named: dict[str, Marking] = {}
    for marking in markings:
        name = marking.noun + str(getattr(marking, "id", ""))
        alike = sum(other == name or other.startswith(f"{name}_") for other in named)
        named[f"{name}_{alike + 1}" if alike else name] = marking
    return named


def _read_sizes(given: Sequence[str]) -> dict[str, float]:
    """Metres by the kind or the name of a sheet; by nothing where none is said."""
    sizes: dict[str, float] = {}
    for text in given:
        sheet, _, metres = text.rpartition("=")
        if sheet in sizes:
            raise QuadrigError(f"--size {text}: a size {f'of {sheet} ' if sheet else ''}is given already; give one")
        sizes[sheet] = read_length(metres)
    return sizes


def _refuse_unclear(sizes: Mapping[str, float], sheets: Mapping[str, Marking]) -> None:
    """Raises QuadrigError where a size is of no sheet, or would be of sheets of several kinds."""
    kinds = list(dict.fromkeys(marking.kind for marking in sheets.values()))
    for sheet in sizes:
        if sheet and sheet not in kinds and sheet not in sheets:
            raise QuadrigError(f"--size {sheet}=...: in sight are {_counted(sheets)}; say it of {', '.join(sheets)}")
    if "" in sizes and len(kinds) > 1:
        example = " ".join(f"--size {kind}=LENGTH" for kind in kinds)
        raise QuadrigError(f"one --size is given for {_counted(sheets)}; measure each, and say it of each: {example}")


def _said(name: str, marking: Marking, sizes: Mapping[str, float]) -> str | None:
    """The key under which a sheet's size is given: its own name, its kind, or nothing."""
    return next((key for key in (name, marking.kind, "") if key in sizes), None)


def _shared(sizes: Mapping[str, float], sheets: Mapping[str, Marking]) -> list[str]:
    """A sentence for each size that several sheets were given."""
    sentences = []
    for key, metres in sizes.items():
        sharing = {name: marking for name, marking in sheets.items() if _said(name, marking, sizes) == key}
        if len(sharing) > 1:
            sentences.append(f"{1000 * metres:g} mm was taken for {_counted(sharing)}: measure each")
    return sentences


def _estimated(sheets: Mapping[str, Marking], sightings: "Sequence[Sighting]") -> list[str]:
    """A sentence for each board of which not only the size is to be measured."""
    what = {"charuco": "marker, the side of its tags,", "aprilgrid": "spacing, between tags over the side of one,"}
    return [
        f"{name}: its {what[sighting.marking.kind]} is estimated from the pictures: measure"
        for name, sighting in zip(sheets, sightings, strict=True)
        if sighting.estimates
    ]


def _counted(sheets: Mapping[str, Marking]) -> str:
    """Such as "5 tags and 1 charuco"."""
    kinds = Counter(marking.kind for marking in sheets.values())
    return " and ".join(f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in kinds.items())


def _rectangle(name: str, marking: Marking, sizes: Mapping[str, float], moving: bool | None) -> Rectangle:
    """A marking of unit size with the size that it has on paper."""
    single = marking.size is None
    what = "the black of a tag" if single or marking.kind == "aprilgrid" else "a square"
    said = _said(name, marking, sizes)
    if said is None:
        question = f"{marking.description}: side of {what} (such as 40mm)"
        metres = read_length(_asked(question, f"--size {marking.kind}=LENGTH"))
    else:
        metres = sizes[said]
    real = marking.scaled(metres)
    width, height = real.size or (metres, metres)
    return Rectangle(name, width, height, real, moving=not single if moving is None else moving)


def _asked(question: str, option: str) -> str:
    """The answer of whoever sits at the terminal. Raises QuadrigError where nobody does."""
    if not sys.stdin.isatty():
        raise QuadrigError(f"{question}? Nobody can be asked here; give {option}")
    return typer.prompt(question, err=True)
