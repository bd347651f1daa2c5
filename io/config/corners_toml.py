"""corners.toml: corners of rectangles as a person pointed at them, beside rig.toml. Read strictly, written in place.

    [[corners]]
    camera = "left"
    rectangle = "court"
    image = 12                        # of this camera, from 0: where the rectangle moves
    sigma = 1.0                       # standard deviation of a coordinate, px
    bottom_right = [1830.2, 1220.5]   # px; the centre of the top-left pixel is 0, 0
    bottom_left = [310.0, 1190.0]
    top_left = [420.4, 260.1]
    top_right = [1710.0, 240.8]

A corner has the same name in every camera: that of the rectangle as one reads it upright.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from quadrig.io.config.errors import decoded, locate
from quadrig.io.whole_file import read_text, write_text
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Rectangle
from quadrig.single.solve.corners import REASON_WORDS, Reason, corner_reasons

CORNER_NAMES = ("bottom_right", "bottom_left", "top_left", "top_right")
"""The corners in the order of Eq. 4."""

CLICKED = 1.0
"""Standard deviation (px) of a corner that a person clicked at some magnification."""

Length = Annotated[float, msgspec.Meta(gt=0)]


class _Corners(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    camera: str
    rectangle: str
    image: Annotated[int, msgspec.Meta(ge=0)] | None = None
    sigma: Length = CLICKED
    bottom_right: tuple[float, float] | None = None
    bottom_left: tuple[float, float] | None = None
    top_left: tuple[float, float] | None = None
    top_right: tuple[float, float] | None = None


class _File(msgspec.Struct, forbid_unknown_fields=True):
    corners: list[_Corners] = []


@dataclass(frozen=True, eq=False)
class PointedCorners:
    """One table of corners.toml.

    pixels (4, 2): in the order of Eq. 4, nan where a corner was not pointed at yet. image: which of the camera's
    images; None where the rectangle stands still and any will do. sigma: of a coordinate, px. where: file and line.
    """

    camera: str
    rectangle: Rectangle
    pixels: Floats
    image: int | None = None
    sigma: float = CLICKED
    where: str = field(default="corners.toml", compare=False)

    @property
    def key(self) -> tuple[str, str, int | None]:
        """What there is one table for."""
        return self.camera, self.rectangle.name, self.image

    @property
    def given(self) -> list[bool]:
        """Which corners were pointed at."""
        return [bool(np.isfinite(pixel).all()) for pixel in self.pixels]

    @property
    def complete(self) -> bool:
        """Whether all four were."""
        return all(self.given)

    @property
    def place(self) -> str:
        """File, line, rectangle and camera, for a sentence."""
        return f"{self.where}: [[corners]] of rectangle {self.rectangle.name!r} in camera {self.camera!r}"


def corners_beside(config: Path | str) -> Path:
    """The corners.toml of a rig.toml."""
    return Path(config).with_name("corners.toml")


def read_corners(path: Path, rectangles: Sequence[Rectangle]) -> tuple[PointedCorners, ...]:
    """The corners of these rectangles, some perhaps still missing; none where there is no such file.

    Raises QuadrigError, one sentence with file, line and what to do, where it cannot be read or holds what it may
    not.
    """
    text = _text(path)
    tables = decoded(text, _File, str(path)).corners
    read: dict[tuple[str, str, int | None], PointedCorners] = {}
    for index, table in enumerate(tables):
        where = partial(locate, str(path), text, f"$.corners[{index}]")
        pointed = _pointed(table, where, rectangles)
        if pointed.key in read:
            raise QuadrigError(
                f"{pointed.place} are given twice; keep one of them, or say with image which pictures they are of"
            )
        read[pointed.key] = pointed
    return tuple(read.values())


def _text(path: Path) -> str:
    try:
        return read_text(path)
    except FileNotFoundError:
        return ""
    except OSError as error:
        raise QuadrigError(
            f"{path}: cannot be read as text ({error}); mend it, or click again with rig pick"
        ) from error


def _pointed(table: _Corners, where: Callable[[str], str], rectangles: Sequence[Rectangle]) -> PointedCorners:
    """The corners of a table; where: file and line of a key."""
    rectangle = next((one for one in rectangles if one.name == table.rectangle), None)
    if rectangle is None:
        known = ", ".join(one.name for one in rectangles if one.marking.by_hand)
        raise QuadrigError(
            f"{where('rectangle')}: [[corners]] of rectangle {table.rectangle!r}, which is not in rig.toml; its "
            f'rectangles with marking = {{ kind = "points" }} are {known}'
        )
    given = {name: getattr(table, name) for name in CORNER_NAMES}
    pixels = np.array([pixel or (np.nan, np.nan) for pixel in given.values()])
    pointed = PointedCorners(table.camera, rectangle, pixels, table.image, table.sigma, where(""))
    if not rectangle.marking.by_hand:
        raise QuadrigError(
            f"{pointed.place}: it is found by its marking ({rectangle.marking.description}); remove this table, or "
            'give the rectangle marking = { kind = "points" }'
        )
    for key, value in {"sigma": table.sigma, **given}.items():
        if value is not None and not np.isfinite(value).all():
            raise QuadrigError(
                f"{where(key)}: {key} of rectangle {table.rectangle!r} in camera {table.camera!r} is {value}; "
                "give pixels, or click again with rig pick"
            )
    return pointed


def refuse_incomplete(pointed: PointedCorners) -> None:
    """Raises QuadrigError where corners are missing, or are no picture of a rectangle."""
    if not pointed.complete:
        missing = " and ".join(name for name, given in zip(CORNER_NAMES, pointed.given, strict=True) if not given)
        raise QuadrigError(
            f"{pointed.place} lack {missing}; all four are needed: click them with rig pick, or remove the table"
        )
    reason = Reason(int(corner_reasons(pointed.pixels)))
    if reason != Reason.OK:
        raise QuadrigError(f"{pointed.place}: {REASON_WORDS[reason]}")


def keep_corners(path: Path, pointed: PointedCorners) -> None:
    """Put a table into a corners.toml, in the place of the one with its key; without a corner left, remove that.

    All else in the file stays as it was written, comments too, and the file appears whole or not at all.
    Raises QuadrigError where it cannot be read or written.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError
    from tomlkit.items import AoT

    text = _text(path)
    try:
        document = tomlkit.parse(text)
    except TOMLKitError as error:
        raise QuadrigError(f"{path}: this is not TOML: {error}; mend it by hand") from error
    if not text:
        document.add(tomlkit.comment("Corners given by hand, px: rig pick writes them, rig calibrate reads them."))
    tables = document.setdefault("corners", tomlkit.aot())
    if not isinstance(tables, AoT):
        raise QuadrigError(f"{path}: corners is not a list of [[corners]] tables; write each as [[corners]]")
    index = next((i for i, table in enumerate(tables) if _key(table) == pointed.key), None)
    if not any(pointed.given):
        if index is not None:
            del tables[index]
        if not tables:
            # An empty list of tables would be written as `corners = []`, to which no [[corners]] can be added.
            document.remove("corners")
        write_text(path, tomlkit.dumps(document))
        return
    if index is None:
        table = tomlkit.table()
        table.update({"camera": pointed.camera, "rectangle": pointed.rectangle.name})
        if pointed.image is not None:
            table["image"] = pointed.image
        if len(tables):
            tables[-1].add(tomlkit.nl())
        tables.append(table)
        index = len(tables) - 1
    table = tables[index]
    table["sigma"] = pointed.sigma
    for name, pixel, given in zip(CORNER_NAMES, pointed.pixels, pointed.given, strict=True):
        if given:
            table[name] = [round(float(value), 2) for value in pixel]
        else:
            table.pop(name, None)
    write_text(path, tomlkit.dumps(document))


def _key(table: dict) -> tuple[str, str, int | None]:
    return table.get("camera", ""), table.get("rectangle", ""), table.get("image")
