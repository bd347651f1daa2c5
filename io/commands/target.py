"""`rig target`: draw a sheet with markings to print, and print its rig.toml lines."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from quadrig.io.config.rig_toml import RigConfig, config_text, read_config
from quadrig.io.sheet.layout import (
    Paper,
    largest_square,
    largest_tag,
    paper_named,
    parse_ids,
    parse_measured,
    scaled,
    target_pdf,
    target_toml,
)
from quadrig.io.whole_file import write_text, written_beside
from quadrig.rig.words import read_length
from quadrig.single.detect.dictionaries import canonical_dictionary, tag_dictionary
from quadrig.single.detect.image_search import check_rectangles
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Rectangle

# Share of a ChArUco square's side that its tag takes: the white around it is what the tag needs to be found.
_MARKER_SHARE = 0.75


class Kind(StrEnum):
    """What is printed."""

    tag = "tag"
    charuco = "charuco"
    chessboard = "chessboard"


def target(
    kind: Annotated[Kind, typer.Option(help="What to print.")] = Kind.tag,
    ids: Annotated[str, typer.Option(help="Tag ids, such as 0-3 or 1,4,9; for a board its first one.")] = "0",
    dictionary: Annotated[
        str | None, typer.Option(help="Tag dictionary; apriltag_36h11 for tags, aruco_4x4_50 for boards.")
    ] = None,
    paper: Annotated[str, typer.Option(help="A5, A4, A3, A2, letter or legal.")] = "A4",
    output: Annotated[Path | None, typer.Option("-o", "--output", help="PDF to write.")] = None,
    size: Annotated[
        str | None, typer.Option(help="Side of a tag, or of a board's square, such as 80mm; as large as fits.")
    ] = None,
    columns: Annotated[int | None, typer.Option(min=2, help="Squares of a board along its width.")] = None,
    rows: Annotated[int | None, typer.Option(min=2, help="Squares of a board along its height.")] = None,
    per_page: Annotated[int, typer.Option(min=1, max=24, help="Tags on a page.")] = 1,
    name: Annotated[str | None, typer.Option(help="Name in rig.toml; tags add their id to it.")] = None,
    moving: Annotated[
        bool | None, typer.Option("--moving/--static", help="Carried about, or lying still; boards are carried.")
    ] = None,
    measured: Annotated[
        str | None, typer.Option(help="What the printed ruler measures, over what it says: 148.5mm/150mm.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="rig.toml to put these rectangles into, by name; made where there is none.")
    ] = None,
) -> None:
    """Draw markings at their exact size, with cutting marks and a ruler, and print their rig.toml lines.

    Print at actual size and measure the ruler; where it is not as long as it says, run the same command with
    --measured (and --config rig.toml): the lines then give the size that was really printed.

    Example: rig target --kind tag --ids 0-3 --paper A4 -o sheet.pdf
    """
    scale = 1.0 if measured is None else parse_measured(measured)
    moves = kind is not Kind.tag if moving is None else moving
    if kind is Kind.tag:
        page = paper_named(paper, across=False)
        rectangles = _tags(ids, dictionary, page, size, per_page, name or "tag", moves)
    else:
        # By default an odd and an even count, so that a chessboard turned by 180 degrees differs from itself.
        usual = (9, 6) if kind is Kind.chessboard else (7, 5)
        columns, rows = columns or usual[0], rows or usual[1]
        page = paper_named(paper, across=columns >= rows)
        square = read_length(size, "mm") if size else largest_square(page, columns, rows)
        marking = _board_marking(kind, columns, rows, square, ids, dictionary)
        rectangles, per_page = [Rectangle(name or "board", columns * square, rows * square, marking, moves)], 1
    check_rectangles(rectangles)
    if output is not None:
        drawing = target_pdf(rectangles, page, per_page)
        with written_beside(output) as beside:
            beside.write_bytes(drawing)
        print(f"wrote {output}; print it at actual size and measure the ruler", file=sys.stderr)
    printed = [scaled(rectangle, scale) for rectangle in rectangles] if scale != 1.0 else rectangles
    if config is not None:
        _put_into(config, printed)
        print(f"wrote {config}", file=sys.stderr)
    print(target_toml(printed).strip())


def _tags(
    ids: str, dictionary: str | None, paper: Paper, size: str | None, per_page: int, name: str, moving: bool
) -> list[Rectangle]:
    known = canonical_dictionary(dictionary or "apriltag_36h11")
    numbers = parse_ids(ids)
    cells = tag_dictionary(known).markerSize + 2
    side = read_length(size, "mm") if size else largest_tag(paper, cells, min(per_page, len(numbers)))
    return [Rectangle(f"{name}{number}", side, side, TagMarking(known, number), moving) for number in numbers]


def _board_marking(
    kind: Kind, columns: int, rows: int, square: float, ids: str, dictionary: str | None
) -> ChessboardMarking | CharucoMarking:
    if kind is Kind.chessboard:
        if dictionary is not None:
            raise QuadrigError("a chessboard has no tags; leave --dictionary out or choose --kind charuco")
        return ChessboardMarking(columns, rows, square)
    known = canonical_dictionary(dictionary or "aruco_4x4_50")
    marker = round(_MARKER_SHARE * square, 4)
    return CharucoMarking(columns, rows, square, marker, known, first_id=parse_ids(ids)[0])


def _put_into(path: Path, rectangles: list[Rectangle]) -> None:
    """Add the rectangles to a rig.toml; those of the same names are replaced, and the file then written again."""
    if not path.exists():
        write_text(path, target_toml(rectangles))
        return
    config = read_config(path)
    new = {rectangle.name: rectangle for rectangle in rectangles}
    kept = [new.pop(rectangle.name, rectangle) for rectangle in config.rectangles]
    check_rectangles([*kept, *new.values()])
    if len(new) == len(rectangles):
        write_text(path, config.text.rstrip() + "\n\n" + target_toml(rectangles))
    else:
        write_text(path, config_text(RigConfig((*kept, *new.values()), config.cameras, config.reference)))
