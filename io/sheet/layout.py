"""Sheets to print: markings at their exact size, with cutting marks, a ruler, and the lines for rig.toml."""

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadrig.io.config.known_sizes import PAPER_SIZES
from quadrig.io.config.rig_toml import RigConfig, config_text
from quadrig.io.sheet.pdf import PdfPage, pdf_bytes
from quadrig.rig.words import read_length
from quadrig.single.errors import QuadrigError
from quadrig.single.patch import Patch
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.marking_image import marking_patches

# mm along the edge of the paper that home printers leave white.
_EDGE = 8.0
# mm at the foot of a page for ruler, advice and rig.toml lines.
_FOOT = 34.0
# Length and distance (mm) of cutting marks from the corners they point at.
_CUT, _CUT_GAP = 4.0, 1.0
# mm from the edge of the paper to what is to be cut out.
BORDER = _EDGE + _CUT + _CUT_GAP
# mm: what a ruler of 150 mm is read to is 0.5 mm, so its scale is good to 0.3 %.
_RULER = 150.0
# A printer that is off by more than this did not print "at actual size": the page was fitted to the paper.
_SCALE_LIMITS = (0.5, 2.0)


@dataclass(frozen=True)
class Paper:
    """A page in mm, as it is held."""

    name: str
    width: float
    height: float

    @property
    def room(self) -> tuple[float, float]:
        """Width and height in mm that markings with their quiet zones may fill."""
        return self.width - 2 * BORDER, self.height - BORDER - _EDGE - _FOOT


def paper_named(name: str, across: bool) -> Paper:
    """The paper of a name in any case, lying across or upright. Raises QuadrigError where there is none."""
    for known, (width, height) in PAPER_SIZES.items():
        if known.lower() == name.strip().lower():
            sides = (width * 1e3, height * 1e3) if across else (height * 1e3, width * 1e3)
            return Paper(known, *sides)
    raise QuadrigError(f"there is no paper {name!r}; choose one of {', '.join(PAPER_SIZES)}")


def parse_ids(text: str) -> list[int]:
    """Tag ids of "0-3", "7", "1,4,9-11". Raises QuadrigError where it is none of these."""
    ids: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+)\s*(?:-\s*(\d+)\s*)?", part)
        if match is None or int(match[2] or match[1]) < int(match[1]):
            raise QuadrigError(f"{text!r} names no tag ids; give some such as 0-3 or 1,4,9")
        ids += range(int(match[1]), int(match[2] or match[1]) + 1)
    if len(set(ids)) < len(ids):
        raise QuadrigError(f"{text!r} names a tag id twice; every rectangle needs its own")
    return ids


def parse_measured(text: str) -> float:
    """The printer's scale of "148.5mm/150mm": what the ruler measures over what it says.

    Raises QuadrigError where it is no such ratio, or one that no printer makes by accident.
    """
    parts = text.split("/")
    if len(parts) != 2:
        raise QuadrigError(f"{text!r} is no measurement; give measured over printed length, such as 148.5mm/150mm")
    # Of a ratio the unit does not matter where neither has one.
    scale = read_length(parts[0], math.inf) / read_length(parts[1], math.inf)
    if not _SCALE_LIMITS[0] < scale < _SCALE_LIMITS[1]:
        raise QuadrigError(f"{text!r} makes the print {scale:.3g} times its size; measure the ruler again")
    return scale


def largest_tag(paper: Paper, cells: int, per_page: int) -> float:
    """Side in metres, whole mm, of the largest tags of which per_page fit on the paper with their quiet zones."""
    side = max(min(w, h) for w, h in _slots(paper, per_page)) / (1 + 3 / cells)
    return whole_mm(side, paper)


def largest_step(paper: Paper, across: float, down: float) -> float:
    """Length in metres, whole mm, of which the paper holds so many across and down, such as a board's square."""
    width, height = paper.room
    return whole_mm(min(width / across, height / down), paper)


def whole_mm(side: float, paper: Paper) -> float:
    """Metres of a length in mm, rounded down to whole ones. Raises QuadrigError where none is left."""
    if side < 1:
        raise QuadrigError(f"nothing of use fits on {paper.name}; take larger paper or fewer squares")
    return int(side) * 1e-3


def _slots(paper: Paper, per_page: int) -> list[tuple[float, float]]:
    """Sizes (mm) of the places for per_page sheets in each arrangement of columns and rows."""
    width, height = paper.room
    gap = 2 * (_CUT + _CUT_GAP)
    return [((width - gap * (c - 1)) / c, (height - gap * (r - 1)) / r) for c, r in _arrangements(per_page)]


def _arrangements(per_page: int) -> list[tuple[int, int]]:
    return [(columns, -(-per_page // columns)) for columns in range(1, per_page + 1)]


def target_pdf(rectangles: Sequence[Rectangle], paper: Paper, per_page: int = 1) -> bytes:
    """A PDF of the rectangles' sheets, per_page on each page, at their exact size.

    Raises QuadrigError where one does not fit, or has no marking that could be printed.
    """
    starts = range(0, len(rectangles), per_page)
    pages = [_page(rectangles[start : start + per_page], paper, per_page) for start in starts]
    return pdf_bytes(pages, "quadrig target")


def _page(rectangles: Sequence[Rectangle], paper: Paper, per_page: int) -> PdfPage:
    page = PdfPage(paper.width, paper.height)
    widest = max(sheet_size(r)[0] for r in rectangles)
    tallest = max(sheet_size(r)[1] for r in rectangles)
    columns, rows = _arrangement(paper, per_page, widest, tallest, rectangles[0].name)
    room = paper.room
    for index, rectangle in enumerate(rectangles):
        column, row = index % columns, index // columns
        x = BORDER + (column + 0.5) * room[0] / columns
        y = BORDER + (row + 0.5) * room[1] / rows
        _draw_sheet(page, rectangle, x, y)
    draw_foot(page, _short_lines(rectangles))
    return page


def sheet_size(rectangle: Rectangle) -> tuple[float, float]:
    """Width and height in mm of the marking with its quiet zone."""
    border = rectangle.marking.quiet_zone(rectangle)
    return (rectangle.width + 2 * border) * 1e3, (rectangle.height + 2 * border) * 1e3


def _arrangement(paper: Paper, per_page: int, width: float, height: float, name: str) -> tuple[int, int]:
    # Lengths typed with a tenth of a millimetre may exceed the paper's by rounding alone.
    for arrangement, slot in zip(_arrangements(per_page), _slots(paper, per_page), strict=True):
        if width <= slot[0] + 0.05 and height <= slot[1] + 0.05:
            return arrangement
    room = paper.room
    raise QuadrigError(
        f"rectangle {name!r}: {width:.0f} x {height:.0f} mm with its white border, {per_page} a page, do not fit on "
        f"{paper.name} ({room[0]:.0f} x {room[1]:.0f} mm free); take a smaller size or larger paper"
    )


def _draw_sheet(page: PdfPage, rectangle: Rectangle, x: float, y: float) -> None:
    """The marking with its middle at (x, y) mm, its name, and marks to cut along outside of its quiet zone."""
    left, top, right, bottom = draw_patches(page, rectangle, x, y)
    for corner_x, away_x in ((left, -1), (right, 1)):
        for corner_y, away_y in ((top, -1), (bottom, 1)):
            near_x, near_y = corner_x + away_x * _CUT_GAP, corner_y + away_y * _CUT_GAP
            page.line((near_x, corner_y), (near_x + away_x * _CUT, corner_y))
            page.line((corner_x, near_y), (corner_x, near_y + away_y * _CUT))
    page.text(left + 2, bottom + 3.2, f"{rectangle.name}: this side down", 2.2)


def draw_patches(page: PdfPage, rectangle: Rectangle, x: float, y: float) -> tuple[float, float, float, float]:
    """The marking with its middle at (x, y) mm; gives the box (left, top, right, bottom) of its sheet, mm."""
    sheet, *patches = marking_patches(rectangle)
    if sheet.tone < 0.5:
        patches = [sheet, *patches]
    for (tone, ellipses), run in itertools.groupby(patches, key=lambda patch: (patch.tone, patch.round)):
        fill = page.fill_ellipses if ellipses else page.fill
        fill([_box(patch, x, y) for patch in run], tone)
    return _box(sheet, x, y)


def _box(patch: Patch, x: float, y: float) -> tuple[float, float, float, float]:
    return x + patch.left * 1e3, y + patch.top * 1e3, x + patch.right * 1e3, y + patch.bottom * 1e3


def draw_foot(page: PdfPage, lines: Sequence[str]) -> None:
    """What to do with the print: ruler, advice, and a few lines more."""
    top = page.height - _EDGE - _FOOT + 5
    _draw_ruler(page, _EDGE + 2, top)
    page.text(_EDGE + 2, top + 10, "Print at actual size (100 %), not fitted to the page. Measure the ruler:", 2.6)
    page.text(_EDGE + 2, top + 13.2, f"if it is not {_ruler(page):.0f} mm long, give its length with --measured", 2.6)
    for number, line in enumerate(lines):
        page.text(_EDGE + 2, top + 17.2 + 2.3 * number, line, 1.9, mono=True)


def _ruler(page: PdfPage) -> float:
    return min(_RULER, 10 * ((page.width - 2 * _EDGE - 12) // 10))


def _draw_ruler(page: PdfPage, x: float, y: float) -> None:
    length = int(_ruler(page))
    page.line((x, y), (x + length, y), 0.15)
    for millimetre in range(length + 1):
        tick = 3.0 if millimetre % 10 == 0 else 2.0 if millimetre % 5 == 0 else 1.2
        page.line((x + millimetre, y), (x + millimetre, y + tick), 0.1)
    for centimetre in range(0, length + 1, 50):
        page.text(x + centimetre + 0.5, y + 6, f"{centimetre} mm", 2.4)


def _short_lines(rectangles: Sequence[Rectangle]) -> list[str]:
    """What rig.toml says of these rectangles, in as many lines as the foot of a page has."""
    room = int((_FOOT - 5 - 17.2) / 2.3)
    lines = [line for line in target_toml(rectangles).splitlines() if line.strip()]
    if len(lines) <= room:
        return lines
    packed = [part.strip() for part in target_toml(rectangles).split("[[rectangle]]") if part.strip()]
    lines = ["[[rectangle]] " + " ; ".join(part.splitlines()) for part in packed]
    if len(lines) <= room:
        return lines
    return [*lines[: room - 1], f"and {len(lines) - room + 1} more, which rig target has printed"]


def target_toml(rectangles: Sequence[Rectangle]) -> str:
    """The [[rectangle]] tables of rig.toml for these rectangles."""
    return config_text(RigConfig(tuple(rectangles)))


def scaled(rectangle: Rectangle, scale: float) -> Rectangle:
    """The rectangle as a printer of this scale made it, lengths rounded to a micrometre."""
    marking, pose = rectangle.marking.scaled(scale), rectangle.body_from_rect
    width, height = marking.size or (round(rectangle.width * scale, 6), round(rectangle.height * scale, 6))
    placed = pose and replace(pose, translation=np.round(pose.translation * scale, 6))
    return replace(rectangle, width=width, height=height, marking=marking, body_from_rect=placed)
