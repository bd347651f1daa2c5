"""What a file is by how it begins, and whether it is quadrig's: what can be made again may be replaced."""

import struct
import zlib
from pathlib import Path

RIG, RECORDING = "a rig", "a recording"

_MCAP = b"\x89MCAP0"
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
# How files begin that are written here, or that cannot be made again, and where that stands in them.
_SIGNS = (
    (0, _PNG, "a picture"),
    (0, b"\xff\xd8\xff", "a picture"),
    (4, b"ftyp", "a video"),
    (0, b"%PDF", "a PDF"),
    (0, b"RRF", "a file of rerun"),
    (0, b"<!doctype html", "a page"),
    (0, b"<!DOCTYPE html", "a page"),
)
_NOT_OURS = ((0, b"#ROSBAG", "a ROS bag"), (0, b"SQLite", "a ROS bag"), (0, b"RIFF", "a video"), (0, b"{", "JSON"))
# Every writer says which program wrote the file at its beginning or, of videos, at its end.
_ENDS = 1024
_WORD = b"quadrig"
# The profile of an MCAP stands behind its sign, the record's kind and two lengths.
_PROFILE_AT = 17
_RIG_PROFILE = struct.pack("<I", len(_WORD)) + _WORD


def file_kind(file: Path) -> str | None:
    """What a file is, in words; None where there is none, or nothing in it."""
    try:
        ends = _ends(file)
    except FileNotFoundError:
        return None
    begin = ends[0]
    if not begin:
        return None
    if begin.startswith(_MCAP):
        return RIG if begin[_PROFILE_AT:].startswith(_RIG_PROFILE) else RECORDING
    kind = _by_sign(begin, _SIGNS)
    if kind is not None:
        return kind if _are_ours(ends) else f"{kind} that quadrig did not write"
    return _by_sign(begin, _NOT_OURS) or ("another file" if b"\0" in begin else "a text")


def is_written_here(file: Path) -> bool:
    """Whether a file says that quadrig wrote it."""
    return _are_ours(_ends(file))


def sign_picture(file: Path) -> None:
    """Write into a PNG or JPEG that quadrig made it; any other file stays as it is."""
    # A recording may be larger than memory.
    if not _ends(file)[0].startswith((_PNG, _JPEG)):
        return
    data = file.read_bytes()
    if data.startswith(_PNG):
        words = b"tEXtSoftware\0" + _WORD
        chunk = struct.pack(">I", len(words) - 4) + words + struct.pack(">I", zlib.crc32(words))
        # The header, of 13 bytes, is the first chunk.
        at = len(_PNG) + 12 + 13
    else:
        chunk = b"\xff\xfe" + struct.pack(">H", 2 + len(_WORD)) + _WORD
        # JFIF wants its own segment first.
        at = 4 + int.from_bytes(data[4:6], "big") if data[2:4] == b"\xff\xe0" else 2
    file.write_bytes(data[:at] + chunk + data[at:])


def _ends(file: Path) -> tuple[bytes, bytes]:
    with file.open("rb") as stream:
        begin = stream.read(_ENDS)
        stream.seek(max(0, file.stat().st_size - _ENDS))
        return begin, stream.read(_ENDS)


def _are_ours(ends: tuple[bytes, bytes]) -> bool:
    return any(_WORD in end for end in ends)


def _by_sign(begin: bytes, signs: tuple[tuple[int, bytes, str], ...]) -> str | None:
    return next((kind for at, sign, kind in signs if begin[at:].startswith(sign)), None)
