"""`rig target`: draw a sheet with markings to print, and print its rig.toml lines."""

from collections.abc import Callable
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from quadrig.io.config.edit_toml import with_rectangles
from quadrig.io.config.rig_toml import read_config
from quadrig.io.sheet.box import BOX_FACES, box_pdf, largest_box_tag, on_box
from quadrig.io.sheet.layout import (
    Paper,
    largest_step,
    largest_tag,
    paper_named,
    parse_ids,
    parse_measured,
    scaled,
    target_pdf,
    target_toml,
)
from quadrig.io.verbosity import say
from quadrig.io.whole_file import write_text, written_beside
from quadrig.rig.words import read_length
from quadrig.single.detect.dictionaries import canonical_dictionary, tag_dictionary
from quadrig.single.detect.image_search import check_rectangles
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.april_grid import AprilGridMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.circle_grid import CircleGridMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Marking, Rectangle

# Share of a ChArUco square's side that its tag takes: the white around it is what the tag needs to be found.
_MARKER_SHARE = 0.75
# Gap between an AprilGrid's tags over their side: that of Kalibr's own.
_SPACING = 0.3


class Kind(StrEnum):
    """What is printed."""

    tag = "tag"
    charuco = "charuco"
    aprilgrid = "aprilgrid"
    chessboard = "chessboard"
    circles = "circles"
    acircles = "acircles"


# Columns and rows of a board where none are given: an odd and an even count, so that a chessboard turned by 180
# degrees differs from itself; Kalibr's and OpenCV's own.
_USUAL = {
    Kind.charuco: (7, 5),
    Kind.aprilgrid: (6, 6),
    Kind.chessboard: (9, 6),
    Kind.circles: (7, 6),
    Kind.acircles: (4, 11),
}


def target(
    kind: Annotated[Kind, typer.Option(help="What to print.")] = Kind.tag,
    ids: Annotated[str, typer.Option(help="Tag ids, such as 0-3 or 1,4,9; for a board its first one.")] = "0",
    dictionary: Annotated[
        str | None,
        typer.Option(help="Tag dictionary; else apriltag_36h11, for charuco aruco_4x4_50."),
    ] = None,
    paper: Annotated[str, typer.Option(help="A5, A4, A3, A2, letter or legal.")] = "A4",
    output: Annotated[Path | None, typer.Option("-o", "--output", help="PDF to write.")] = None,
    size: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH", help="Side of a tag or square, or spacing of circles, such as 80mm; as large as fits."
        ),
    ] = None,
    columns: Annotated[int | None, typer.Option(min=2, help="Squares, tags or circles along its width.")] = None,
    rows: Annotated[int | None, typer.Option(min=2, help="Squares, tags or circles along its height.")] = None,
    per_page: Annotated[int, typer.Option(min=1, max=24, help="Tags on a page.")] = 1,
    box: Annotated[bool, typer.Option("--box", help="Six tags on the net of a cube to fold: a body.")] = False,
    name: Annotated[str | None, typer.Option(help="Name in rig.toml; tags add their id to it.")] = None,
    moving: Annotated[
        bool | None, typer.Option("--moving/--static", help="Carried about, or lying still; boards are carried.")
    ] = None,
    measured: Annotated[
        str | None, typer.Option(help="What the printed ruler measures, over what it says: 148.5mm/150mm.")
    ] = None,
    put_into: Annotated[
        Path | None,
        typer.Option("--config", help="rig.toml to put these rectangles into, by name; made where there is none."),
    ] = None,
) -> None:
    """Draw markings at their exact size, with cutting marks and a ruler, and print their rig.toml lines.

    Print at actual size and measure the ruler; where it is not as long as it says, run the same command with
    --measured (and --config rig.toml): the lines then give the size that was really printed.

    Examples: rig target --kind tag --ids 0-3 --paper A4 -o sheet.pdf;
    rig target --kind aprilgrid --columns 6 --rows 6 -o april.pdf (Kalibr's layout);
    rig target --box --paper A3 -o box.pdf
    """
    scale = 1.0 if measured is None else parse_measured(measured)
    moves = (box or kind is not Kind.tag) if moving is None else moving
    draw: Callable[[list[Rectangle], Paper], bytes] = partial(target_pdf, per_page=per_page)
    if box:
        page = paper_named(paper, across=False)
        rectangles, draw = _box(ids, dictionary, page, size, name or "box", moves), box_pdf
    elif kind is Kind.tag:
        page = paper_named(paper, across=False)
        rectangles = _tags(ids, dictionary, page, size, per_page, name or "tag", moves)
    else:
        columns, rows = columns or _USUAL[kind][0], rows or _USUAL[kind][1]
        whole = _board(name, _board_marking(kind, columns, rows, 1.0, ids, dictionary), moves)
        border = 2 * whole.marking.quiet_zone(whole)
        across, down = whole.width + border, whole.height + border
        page = paper_named(paper, across=across >= down)
        step = read_length(size) if size else largest_step(page, across, down)
        rectangles = [_board(name, _board_marking(kind, columns, rows, step, ids, dictionary), moves)]
        draw = partial(target_pdf, per_page=1)
    check_rectangles(rectangles)
    if output is not None:
        drawing = draw(rectangles, page)
        with written_beside(output) as beside:
            beside.write_bytes(drawing)
        say(f"wrote {output}; print it at actual size and measure the ruler")
    printed = [scaled(rectangle, scale) for rectangle in rectangles] if scale != 1.0 else rectangles
    if put_into is not None:
        _put_into(put_into, printed)
        say(f"wrote {put_into}")
    print(target_toml(printed).strip())


def _tags(
    ids: str, dictionary: str | None, paper: Paper, size: str | None, per_page: int, name: str, moving: bool
) -> list[Rectangle]:
    known = canonical_dictionary(dictionary or "apriltag_36h11")
    numbers = parse_ids(ids)
    cells = tag_dictionary(known).markerSize + 2
    side = read_length(size) if size else largest_tag(paper, cells, min(per_page, len(numbers)))
    return [Rectangle(f"{name}{number}", side, side, TagMarking(known, number), moving) for number in numbers]


def _box(
    ids: str, dictionary: str | None, paper: Paper, size: str | None, name: str, moving: bool
) -> list[Rectangle]:
    numbers = list(range(BOX_FACES)) if ids == "0" else parse_ids(ids)
    if len(numbers) != BOX_FACES:
        raise QuadrigError(f"a box has {BOX_FACES} faces, and --ids {ids} names {len(numbers)} tags; give as many")
    family = canonical_dictionary(dictionary or "apriltag_36h11")
    side = read_length(size) if size else largest_box_tag(paper, tag_dictionary(family).markerSize + 2)
    return on_box([Rectangle(f"{name}{n}", side, side, TagMarking(family, n), moving) for n in numbers], name)


def _board(name: str | None, marking: Marking, moving: bool) -> Rectangle:
    assert marking.size is not None
    return Rectangle(name or "board", *marking.size, marking, moving)


def _board_marking(kind: Kind, columns: int, rows: int, step: float, ids: str, dictionary: str | None) -> Marking:
    """step: side of a square or tag, or spacing of circles, metres."""
    if kind is Kind.charuco:
        marker = round(_MARKER_SHARE * step, 4)
        return CharucoMarking(columns, rows, step, marker, dictionary or "aruco_4x4_50", first_id=parse_ids(ids)[0])
    if kind is Kind.aprilgrid:
        family = dictionary or "apriltag_36h11"
        return AprilGridMarking(columns, rows, step, _SPACING, family, first_id=parse_ids(ids)[0])
    if dictionary is not None:
        raise QuadrigError(f"{kind.value} has no tags; leave --dictionary out or choose --kind charuco or aprilgrid")
    if kind is Kind.chessboard:
        return ChessboardMarking(columns, rows, step)
    return CircleGridMarking(columns, rows, step, asymmetric=kind is Kind.acircles)


def _put_into(path: Path, rectangles: list[Rectangle]) -> None:
    """Put the rectangles into a rig.toml, those of the same names in their place; all else stays as it is."""
    if not path.exists():
        write_text(path, target_toml(rectangles))
        return
    config = read_config(path)
    new = {rectangle.name: rectangle for rectangle in rectangles}
    kept = [new.pop(rectangle.name, rectangle) for rectangle in config.rectangles]
    check_rectangles([*kept, *new.values()])
    write_text(path, with_rectangles(config.text, rectangles))
