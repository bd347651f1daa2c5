"""Tables of time stamps (CSV) as recorders write them: which columns hold what is read from their names."""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from quadrig.io.recording.camera import RecordedCamera
from quadrig.io.recording.image_source import Stamped
from quadrig.io.whole_file import read_whole
from quadrig.single.errors import QuadrigError

_CAMERA = ("cam_id", "camera", "camera_name", "camera_id", "cam", "cam_name", "port", "device", "view")
_FRAME = ("frame_index", "frame", "frame_id", "frame_number", "image", "image_index", "index")
_INSTANT = ("sync_index", "sync_id", "frameset", "trigger")
_TIME = re.compile(
    r"#?(?:(?:frame|sensor|capture|system|header)_?)?(?:timestamps?|time_?stamps?|times?|stamps?|seconds|nanoseconds|t|ts)"
    r"(?:[_ ]?[\[(]?(?P<unit>s|sec|seconds|ms|us|ns|nsec|nanoseconds|milliseconds|microseconds)[\])]?)?"
)
_DIGITS = {
    **dict.fromkeys(("ns", "nsec", "nanoseconds"), 0),
    **dict.fromkeys(("us", "microseconds"), 3),
    **dict.fromkeys(("ms", "milliseconds"), 6),
    **dict.fromkeys(("s", "sec", "seconds"), 9),
}
# A time without a unit that counts from 1970 says its unit by its size: this year is 1.7e9 s. Others are seconds.
_UNITS_BY_SIZE = ((10**17, 0), (10**14, 3), (10**11, 6))


@dataclass(frozen=True)
class _Columns:
    """Names of the columns, None where the table has no such. digits: from the unit to nanoseconds, by name."""

    camera: str | None
    frame: str | None
    time: str
    timed: bool
    digits: int | None


def with_timestamps(cameras: Sequence[RecordedCamera], table: Path, notes: list[str]) -> list[RecordedCamera]:
    """The cameras with the time stamps of a CSV, whose header says which column is the camera, the image, the time.

    A camera is named by its name, or the number that its name ends with; without such a column the table is that of
    the only camera. Rows are matched to images by the image's number where it counts from 0, else in its order.
    A table that has instants (sync_index) and no times makes those the order of time. notes: takes a sentence for
    each camera of whose images some have no row.
    Raises QuadrigError where table and cameras do not fit together.
    """
    rows, timed = _read_table(table)
    if "" in rows and len(cameras) > 1:
        raise QuadrigError(f"{table}: no column says the camera, and there are {len(cameras)}; add one called camera")
    result = []
    for camera in cameras:
        mine = rows.get("" if "" in rows else _table_name(camera.name, rows))
        if not mine:
            known = ", ".join(rows)
            raise QuadrigError(f"{table}: no rows for camera {camera.name!r}; it has {known}")
        if len(mine) < camera.frames:
            left = f"{camera.frames - len(mine)} of {camera.frames} images have"
            notes.append(f"camera {camera.name!r}: {left} no row in {table} and are left out")
        result.append(_with_stamps(camera, sorted(mine), table, timed))
    return result


def _with_stamps(camera: RecordedCamera, rows: list[tuple[int, int]], table: Path, timed: bool) -> RecordedCamera:
    indices, stamps = (np.array(column, np.int64) for column in zip(*rows, strict=True))
    if len(rows) == camera.frames:
        indices = np.arange(camera.frames)
    elif indices[0] < 0 or indices[-1] >= camera.frames or np.any(np.diff(indices) == 0):
        raise QuadrigError(
            f"{table}: camera {camera.name!r} has {camera.frames} images but {len(rows)} rows, up to frame_index "
            f"{indices[-1]}; give the table of these videos"
        )
    source = camera.source.source if isinstance(camera.source, Stamped) else camera.source
    return replace(camera, source=Stamped(source.part(indices), stamps, timed))


def _read_table(table: Path) -> tuple[dict[str, list[tuple[int, int]]], bool]:
    """Number of the image and time (ns) of each row, by camera ("" where the table does not say), and whether those
    are times."""
    rows: dict[str, list[tuple[int, int]]] = {}
    try:
        text = read_whole(table).decode("utf-8-sig")
        lines = text.splitlines()
        delimiter = max(",;\t", key=lines[0].count) if lines else ","
        reader = csv.DictReader(lines, delimiter=delimiter, skipinitialspace=True)
        columns = _columns(list(reader.fieldnames or []), table)
        for count, row in enumerate(reader):
            camera = row[columns.camera].strip() if columns.camera else ""
            frame = int(row[columns.frame]) if columns.frame else count
            if abs(frame) >= 2**63:
                raise ValueError(f"{frame} is no number of an image")
            rows.setdefault(camera, []).append((frame, _nanoseconds(row[columns.time], columns)))
    except (ValueError, TypeError, AttributeError, csv.Error) as error:
        raise QuadrigError(f"{table}: a row is not numbers ({error}); give whole rows") from error
    except OSError as error:
        raise QuadrigError(f"{table}: cannot be read ({error.strerror}); give a table of time stamps") from error
    if not rows:
        raise QuadrigError(f"{table}: there are no rows in it; give a table of time stamps")
    return rows, columns.timed


def _columns(header: list[str], table: Path) -> _Columns:
    """Which column is which. Raises QuadrigError, with what was found, where none is the time."""
    plain = {re.sub(r"[\s.\-]+", "_", name.strip().lower()).lstrip("#_ "): name for name in header}
    camera = next((plain[name] for name in _CAMERA if name in plain), None)
    frame = next((plain[name] for name in _FRAME if name in plain), None)
    for name, column in plain.items():
        if match := _TIME.fullmatch(name):
            unit = match["unit"] or (name if name in _DIGITS else "")
            return _Columns(camera, frame, column, timed=True, digits=_DIGITS.get(unit))
    instant = next((plain[name] for name in _INSTANT if name in plain), None)
    if instant is not None:
        return _Columns(camera, frame, instant, timed=False, digits=9)
    found = ", ".join(header) or "nothing"
    raise QuadrigError(
        f"{table}: no column is a time; its header has {found}; call the columns camera, frame_index and time (in "
        "seconds), or timestamp_ns"
    )


def _nanoseconds(text: str, columns: _Columns) -> int:
    """Whole nanoseconds: a float of seconds since 1970 would lose all below 0.2 microseconds."""
    try:
        value = Decimal(text.strip())
        digits = columns.digits
        if digits is None:
            digits = next((digits for least, digits in _UNITS_BY_SIZE if abs(value) >= least), 9)
        stamp = int(value.scaleb(digits))
    except (InvalidOperation, OverflowError) as error:
        raise ValueError(f"{text!r} is no time") from error
    if abs(stamp) >= 2**63:
        raise ValueError(f"{text!r} is no time")
    return stamp


def _table_name(camera: str, rows: Mapping[str, object]) -> str:
    """What the table calls a camera: its name, or the number that its name ends with."""
    if camera in rows:
        return camera
    digits = camera[len(camera.rstrip("0123456789")) :]
    return next((one for one in rows if digits and one.isdigit() and int(one) == int(digits)), "")
