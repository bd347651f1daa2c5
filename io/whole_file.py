"""Files appear whole or not at all: written beside their place, then renamed into it; and are read whole."""

import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from quadrig.single.errors import QuadrigError

LARGEST_TEXT = 1 << 25
"""Bytes of the longest text that is written for us: ten thousand rectangles, a day's table of times."""

LARGEST_OF_CAMERAS = 4_000_000
"""Bytes of a thousand cameras with all their digits; YAML is read at a megabyte a second."""


def read_whole(path: Path, most: int = LARGEST_TEXT) -> bytes:
    """The bytes of a file. Raises QuadrigError where it is larger than its kind is, and OSError as open does."""
    with path.open("rb") as stream:
        # What is no file has no size.
        known = os.fstat(stream.fileno()).st_size
        data = stream.read(most + 1) if known <= most else b""
    if known > most or len(data) > most:
        raise QuadrigError(f"{path}: is larger than {most // 10**6} MB, which no such file is; give another")
    return data


def read_text(path: Path) -> str:
    """The text of a file, as Path.read_text gives it. Raises as read_whole, and UnicodeDecodeError."""
    return read_whole(path).decode().replace("\r\n", "\n").replace("\r", "\n")


@contextmanager
def written_beside(path: Path | str) -> Iterator[Path]:
    """A path to write to, in the folder of `path`; it becomes `path` when the block ends without an error.

    A link stays and what it leads to is written; a file that is there keeps its mode.
    Raises QuadrigError as refuse_no_place does, and where the folder cannot be written to.
    """
    path = Path(path)
    refuse_no_place(path)
    path = path.resolve()
    try:
        # A temporary file is private (0600); the finished one follows the user's own umask like any other.
        mode = stat.S_IMODE(path.stat().st_mode) if path.exists() else 0o666 & ~_umask()
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise QuadrigError(f"cannot write {path}: {error.strerror}; choose another place") from error
    os.close(handle)
    beside = Path(name)
    try:
        yield beside
        beside.chmod(mode)
        beside.replace(path)
    except OSError as error:
        raise QuadrigError(f"cannot write {path}: {error.strerror or error}; choose another place") from error
    finally:
        with suppress(OSError):
            beside.unlink(missing_ok=True)


def refuse_no_place(path: Path) -> None:
    """Raises QuadrigError where no file may be written: over a folder, a device or a pipe, over what is read-only,
    or where its folder is absent."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        folder = (path.resolve() if path.is_symlink() else path).parent
        if not folder.is_dir():
            raise QuadrigError(f"cannot write {path}: there is no folder {folder}; make it first") from None
        return
    except OSError as error:
        raise QuadrigError(f"cannot write {path}: {error.strerror}; choose another place") from error
    if stat.S_ISDIR(mode):
        raise QuadrigError(f"{path} is a folder; give the name of a file to write")
    if not stat.S_ISREG(mode):
        raise QuadrigError(f"{path} is a device, a pipe or a socket; give the name of a file to write")
    if not os.access(path, os.W_OK):
        raise QuadrigError(f"{path} is read-only; choose another place, or make it writable")


def write_text(path: Path | str, text: str) -> None:
    """Write a text file (UTF-8) whole or not at all. Raises QuadrigError as written_beside does."""
    with written_beside(path) as beside:
        beside.write_text(text, encoding="utf-8")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
