"""Files appear whole or not at all: written beside their place, then renamed into it."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from quadrig.single.errors import QuadrigError


@contextmanager
def written_beside(path: Path | str) -> Iterator[Path]:
    """A path to write to, in the folder of `path`; it becomes `path` when the block ends without an error.

    Raises QuadrigError where the folder is absent or cannot be written to.
    """
    path = Path(path)
    refuse_no_place(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise QuadrigError(f"cannot write {path}: {error.strerror}; choose another place") from error
    os.close(handle)
    beside = Path(name)
    try:
        yield beside
        # A temporary file is private (0600); the finished one follows the user's own umask like any other.
        beside.chmod(0o666 & ~_umask())
        beside.replace(path)
    except OSError as error:
        raise QuadrigError(f"cannot write {path}: {error.strerror or error}; choose another place") from error
    finally:
        with suppress(OSError):
            beside.unlink(missing_ok=True)


def refuse_no_place(path: Path) -> None:
    """Raises QuadrigError where a file cannot be written because its name is a folder's or its folder is absent."""
    if path.is_dir():
        raise QuadrigError(f"{path} is a folder; give the name of a file to write")
    if not path.parent.is_dir():
        raise QuadrigError(f"cannot write {path}: there is no folder {path.parent}; make it first")


def write_text(path: Path | str, text: str) -> None:
    """Write a text file (UTF-8) whole or not at all. Raises QuadrigError as written_beside does."""
    with written_beside(path) as beside:
        beside.write_text(text, encoding="utf-8")


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
