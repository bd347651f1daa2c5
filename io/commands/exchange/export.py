"""`rig export`: a rig in the format of another program."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from quadrig.io.formats.any_file import read_any_rig
from quadrig.io.formats.format import Files, Options
from quadrig.io.formats.maps import ideal_rig
from quadrig.io.formats.registry import FORMATS, export_rig
from quadrig.io.formats.rig_json import json_schema, json_text
from quadrig.io.formats.ros import from_roll_pitch_yaw
from quadrig.io.plain_words import console
from quadrig.io.report.terminal import print_sentence
from quadrig.io.verbosity import note
from quadrig.io.whole_file import written_beside
from quadrig.rig.words import read_coordinate
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose

# m; a frame that is farther away says whether it is in metres or in millimetres.
_BARE_PLACE = 10.0


def _list(asked: bool) -> None:
    if asked:
        where = console()
        for name, form in FORMATS.items():
            if form.write is not None:
                way = "out and in" if form.read is not None else "out"
                place = f"*{form.suffixes[0]}" if form.suffixes else "a folder"
                print_sentence(f"{way}, {place}: {form.what}; without {form.loses}", where, mark=f"{name:14} ")
        raise typer.Exit


def _schema(asked: bool) -> None:
    if asked:
        print(json_text(json_schema()))
        raise typer.Exit


def export(
    rig: Annotated[
        Path, typer.Argument(help="The rig to export: a rig.mcap, or any format that is read.", metavar="RIG")
    ],
    form: Annotated[str | None, typer.Option("--format", "-f", metavar="FORMAT", help=", ".join(FORMATS))] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="A file, whose suffix can say the format, or a folder for several files."
        ),
    ] = None,
    covariance: Annotated[
        bool, typer.Option("--covariance", help="The joint covariance too, in json; its sigmas are always there.")
    ] = False,
    undistorted: Annotated[
        bool, typer.Option("--undistorted", help="The pinhole lenses of pictures that `rig undistort` makes.")
    ] = False,
    base: Annotated[str, typer.Option(help="Name of the frame that carries the rig, in urdf and tf.")] = "rig",
    base_from_rig: Annotated[
        str,
        typer.Option(
            metavar="'X Y Z R P Y'", help="Where the rig frame is in it: lengths, and roll pitch yaw in degrees."
        ),
    ] = "0 0 0 0 0 0",
    _listed: Annotated[
        bool, typer.Option("--list", callback=_list, is_eager=True, help="Show every format, and what it loses.")
    ] = False,
    _schema_asked: Annotated[
        bool, typer.Option("--schema", callback=_schema, is_eager=True, help="Show the JSON Schema of json.")
    ] = False,
) -> None:
    """Write a rig in the format of another program; json to standard output where nothing else is said.

    Examples: rig export rig.mcap -o rig.json; rig export rig.mcap --format ros -o camera_info
    """
    form = _form(form, output)
    held = read_any_rig(rig)
    done = export_rig(ideal_rig(held) if undistorted else held, form, Options(covariance, base, _pose(base_from_rig)))
    for remark in done.notes:
        note(remark)
    if output is not None:
        for path in _write(done.files, output, bool(FORMATS[form].suffixes)):
            print(path)
        return
    if len(done.files) > 1 or not FORMATS[form].suffixes:
        raise QuadrigError(f"{form} is {len(done.files)} files ({', '.join(done.files)}); name a folder with -o")
    print(*done.files.values(), end="")


def _form(form: str | None, output: Path | None) -> str:
    """The format asked for, or that of the output's name. Raises where the two do not go together."""
    names = [name for name, each in FORMATS.items() if each.write is not None]
    if form is not None and form not in names:
        raise typer.BadParameter(f"there is no {form!r}; there are {', '.join(names)}", param_hint="--format")
    if output is None or not output.suffix or output.is_dir():
        return form or "json"
    ends = {name: FORMATS[name].suffixes for name in names}
    fits = [name for name in names if output.name.endswith(ends[name])]
    if form is not None:
        if ends[form] and form not in fits:
            raise QuadrigError(
                f"{output}: a {form} file ends in {' or '.join(ends[form])}; name it so, or leave out -f"
            )
        return form
    # The longest ending that is a format's own decides: transforms.json is more than .json.
    own = sorted((name for name in fits if output.name.endswith(ends[name][0])), key=lambda name: -len(ends[name][0]))
    if not own:
        which = f"may be {', '.join(fits)}" if fits else f"says no format; there are {', '.join(names)}"
        raise QuadrigError(f"{output}: its suffix {which}: say which with --format")
    return own[0]


def _pose(words: str) -> Pose:
    try:
        *place, roll, pitch, yaw = words.replace(",", " ").split()
        x, y, z = (read_coordinate(word, _BARE_PLACE) for word in place)
        angles = np.radians([float(roll), float(pitch), float(yaw)])
    except ValueError as error:
        raise typer.BadParameter(f"{words!r} are no six numbers", param_hint="--base-from-rig") from error
    return Pose(from_roll_pitch_yaw(*angles), np.array([x, y, z]))


def _write(files: Files, output: Path, single: bool) -> list[Path]:
    """All of the files or none."""
    if single and not output.is_dir():
        paths = [output]
    else:
        output.mkdir(parents=True, exist_ok=True)
        paths = [output / name for name in files]
    with ExitStack() as stack:
        for path, content in zip(paths, files.values(), strict=True):
            beside = stack.enter_context(written_beside(path))
            beside.write_bytes(content.encode() if isinstance(content, str) else content)
    return paths
