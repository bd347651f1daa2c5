"""`rig single`: focal and pose of one camera from one picture of one rectangle."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from quadrig.io.config.kalibr_target import read_target
from quadrig.io.config.known_sizes import PAPER_SIZES
from quadrig.io.recording.decode_image import UndecodableImage, decode_file, read_picture_file
from quadrig.io.recording.picture_header import read_header
from quadrig.io.report.single import json_report, text_report
from quadrig.io.search.plain_sights import sight_sentence
from quadrig.rig.words import read_length
from quadrig.single.arrays import Picture
from quadrig.single.calibration import Distortion, Model, calibrate_view
from quadrig.single.detect.image_search import detect_views
from quadrig.single.detect.pictures import grey_image
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.blank_sheet import PlainMarking
from quadrig.single.markings.charuco import CharucoMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.tag import TagMarking
from quadrig.single.rectangle import Marking, PointsMarking, Rectangle
from quadrig.single.solve.corners import in_turn
from quadrig.single.view import View

# Standard deviation (px) of a corner that a person pointed at.
_POINTED = 0.5


def single(
    image: Annotated[Path, typer.Argument(help="The picture: JPEG, PNG or whatever OpenCV reads.", metavar="IMAGE")],
    width: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Width of the rectangle, such as 0.16, 160mm or 16cm.")
    ] = None,
    height: Annotated[
        str | None, typer.Option(metavar="LENGTH", help="Its height; one of the two alone is a square's.")
    ] = None,
    paper: Annotated[
        str | None, typer.Option(help=f"A sheet of known size, lying across: {', '.join(PAPER_SIZES)}.")
    ] = None,
    portrait: Annotated[bool, typer.Option("--portrait", help="The paper stands upright.")] = False,
    corners: Annotated[
        tuple[str, str, str, str] | None,
        typer.Option(
            help="The corners as x,y pixels: bottom right, bottom left, top left, top right of the upright sheet.",
            metavar="X,Y X,Y X,Y X,Y",
        ),
    ] = None,
    tag: Annotated[str | None, typer.Option(help="A tag, as DICTIONARY:ID; --width is its outer edge.")] = None,
    charuco: Annotated[
        str | None,
        typer.Option(help="A ChArUco board, as COLUMNSxROWS:SQUARE:MARKER:DICTIONARY[:legacy][:inverted]."),
    ] = None,
    chessboard: Annotated[
        str | None, typer.Option(help="A chessboard, as COLUMNSxROWS:SQUARE, such as 9x6:25mm.")
    ] = None,
    target: Annotated[
        Path | None, typer.Option(help="A target file of Kalibr's: AprilGrid, checkerboard or circle grid.")
    ] = None,
    plain: Annotated[bool, typer.Option("--plain", help="A blank sheet: the default where none is given.")] = False,
    focal: Annotated[float | None, typer.Option(help="The focal where it is known, px.")] = None,
    principal_point: Annotated[
        str | None, typer.Option(help="The principal point where it is known, as x,y; else the middle.")
    ] = None,
    principal_point_sigma: Annotated[
        float | None,
        typer.Option(help="How well it is known, px; 0 where it is given, else as in real cameras."),
    ] = None,
    distortion: Annotated[
        Distortion,
        typer.Option(help="Which terms the lens may have: none, k1, 'k1 k2', or auto: all real lenses do."),
    ] = "auto",
    model: Annotated[
        Model, typer.Option(help="pinhole, fisheye, or auto: a fisheye where a pinhole misses what it meets.")
    ] = "auto",
    sigma: Annotated[
        float | None,
        typer.Option(help="Standard deviation of a corner, px, as far as it is known; else as detected."),
    ] = None,
    save: Annotated[Path | None, typer.Option(help="Write what was found as a rerun file, .rrd.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The result as JSON.")] = False,
) -> None:
    """Focal and pose of a camera from one picture of a rectangle of known size, with what limits them.

    A photograph's own rotation (EXIF) is applied first: corners are pixels of the picture as one sees it.
    What follows "+-" is one sigma of that number, or of each number of a list by itself: in two cases of three the
    truth is within it. It holds what the lens, the sheet's flatness and the corners leave open.

    Examples: rig single desk.jpg --paper A4;
    rig single desk.jpg --tag apriltag_36h11:7 --width 160mm;
    rig single desk.jpg --paper A4 --corners 1830,1220 310,1190 420,260 1710,240
    """
    picture, turned_by_exif = read_picture(image)
    size = _size(width, height, paper, portrait)
    rectangle = _rectangle(size, _marking(corners, tag, charuco, chessboard, target, plain))
    remarks = [f"the picture was {turned_by_exif}, as its EXIF says"] if turned_by_exif else []
    if corners is None:
        view = _found(picture, rectangle, image)
    else:
        turned, changed = in_turn(np.array([_point(text, "--corners") for text in corners]))
        view = View(rectangle.name, rectangle.corners, turned, sigma=_POINTED)
        if changed:
            remarks.append("the corners turn the wrong way round: they were read as with y upwards, last to first")
    if sigma is not None:
        if not sigma > 0:
            raise QuadrigError(f"--sigma {sigma}: give a standard deviation above zero, in pixels")
        view = replace(view, sigma=sigma)
    calibration = calibrate_view(
        view,
        (picture.shape[1], picture.shape[0]),
        focal=focal,
        principal_point=None if principal_point is None else np.array(_point(principal_point, "--principal-point")),
        principal_point_sigma=principal_point_sigma,
        distortion=distortion,
        model=model,
    )
    if save is not None:
        from quadrig.io.viewer.single import save_calibration

        save_calibration(save, picture, rectangle, view, calibration)
    report = json_report if as_json else text_report
    print(report(image.name, rectangle, view, calibration, remarks))


def read_picture(path: Path) -> tuple[Picture, str]:
    """The picture (h, w, 3) uint8, blue green red, and how it was turned to stand upright by its EXIF, or "".

    Raises QuadrigError where it is none.
    """
    if not path.is_file():
        raise QuadrigError(f"{path} is not there; give a picture")
    try:
        data = read_picture_file(path)
        return decode_file(data, gray=False), read_header(data).turned
    except UndecodableImage as error:
        raise QuadrigError(f"{path} is not a picture that can be read ({error}); give a JPEG or PNG") from error


def _size(width: str | None, height: str | None, paper: str | None, portrait: bool) -> tuple[float, float] | None:
    if paper is None:
        sides = {"--width": width, "--height": height}
        given = [_length(text, option) for option, text in sides.items() if text is not None]
        # One side alone is a square's.
        return (given[0], given[-1]) if given else None
    if width is not None or height is not None:
        raise QuadrigError("--paper and --width or --height say the same thing; give one of them")
    names = {name.lower(): size for name, size in PAPER_SIZES.items()}
    if paper.lower() not in names:
        raise QuadrigError(f"--paper {paper}: no such paper; choose one of {', '.join(PAPER_SIZES)}")
    across, down = names[paper.lower()]
    return (down, across) if portrait else (across, down)


def _marking(
    corners: tuple[str, ...] | None,
    tag: str | None,
    charuco: str | None,
    chessboard: str | None,
    target: Path | None,
    plain: bool,
) -> Marking:
    given = [
        name
        for name, value in (
            ("--corners", corners),
            ("--tag", tag),
            ("--charuco", charuco),
            ("--chessboard", chessboard),
            ("--target", target),
            ("--plain", plain or None),
        )
        if value is not None
    ]
    if len(given) > 1:
        raise QuadrigError(f"{' and '.join(given)} are different markings; give one")
    if corners is not None:
        return PointsMarking()
    if tag is not None:
        dictionary, _, number = tag.rpartition(":")
        if not dictionary or not number.isdigit():
            raise QuadrigError(f"--tag {tag}: give DICTIONARY:ID, such as apriltag_36h11:7")
        return TagMarking(dictionary, int(number))
    if charuco is not None:
        return _charuco(charuco)
    if target is not None:
        return read_target(target)
    if chessboard is not None:
        parts = chessboard.split(":")
        if len(parts) != 2:
            raise QuadrigError(f"--chessboard {chessboard}: give COLUMNSxROWS:SQUARE, such as 9x6:25mm")
        columns, rows = _grid(parts[0], "--chessboard")
        return ChessboardMarking(columns, rows, _length(parts[1], "--chessboard"))
    return PlainMarking()


def _charuco(text: str) -> CharucoMarking:
    parts = text.split(":")
    options = set(parts[4:])
    if len(parts) < 4 or not options <= {"legacy", "inverted"}:
        raise QuadrigError(
            f"--charuco {text}: give COLUMNSxROWS:SQUARE:MARKER:DICTIONARY, such as 5x7:30mm:22mm:aruco_4x4_50, "
            "then :legacy or :inverted where the board is so"
        )
    columns, rows = _grid(parts[0], "--charuco")
    square, marker = _length(parts[1], "--charuco"), _length(parts[2], "--charuco")
    return CharucoMarking(columns, rows, square, marker, parts[3], "legacy" in options, "inverted" in options)


def _grid(text: str, option: str) -> tuple[int, int]:
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdigit() and rows.isdigit()):
        raise QuadrigError(f"{option} {text}: give the squares as COLUMNSxROWS, such as 9x6")
    return int(columns), int(rows)


def _length(text: str, option: str) -> float:
    try:
        return read_length(text)
    except QuadrigError as error:
        raise QuadrigError(f"{option}: {error}") from None


def _point(text: str, option: str) -> tuple[float, float]:
    x, _, y = text.partition(",")
    try:
        point = float(x), float(y)
    except ValueError:
        raise QuadrigError(f"{option}: {text!r} is not a point; give x,y in pixels, such as 1830,1220") from None
    if not np.isfinite(point).all():
        raise QuadrigError(f"{option}: {text!r} is not a point of the picture; give x,y in pixels")
    return point


def _rectangle(size: tuple[float, float] | None, marking: Marking) -> Rectangle:
    own = marking.size
    if own is not None:
        if size is not None and not np.allclose(size, own, rtol=1e-6):
            raise QuadrigError(
                f"the board is {own[0]:g} x {own[1]:g} m by its squares, not {size[0]:g} x {size[1]:g} m; "
                "leave --width and --height out"
            )
        return Rectangle(marking.noun, *own, marking)
    if size is None:
        raise QuadrigError("the rectangle has no size; give --width and --height, such as 297mm, or --paper A4")
    return Rectangle(marking.noun, *size, marking)


def _found(picture: Picture, rectangle: Rectangle, path: Path) -> View:
    views = detect_views(picture, [rectangle])
    if not views:
        sight = sight_sentence(str(path), [grey_image(picture)], [rectangle])
        raise QuadrigError(sight or f"{path}: {rectangle.marking.not_found}, or give --corners by hand")
    return views[0]
