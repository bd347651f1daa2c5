"""Files appear whole or not at all: written beside their place, by one process at a time, then renamed into it."""

import errno
import glob
import os
import shlex
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from quadrig.io.file_kind import file_kind, sign_picture
from quadrig.single.errors import QuadrigError

try:
    import fcntl
except ImportError:  # Windows: nobody is told of another process there
    fcntl = None

LARGEST_TEXT = 1 << 25
"""Bytes of the longest text that is written for us: ten thousand rectangles, a day's table of times."""

LARGEST_OF_CAMERAS = 4_000_000
"""Bytes of a thousand cameras with all their digits; YAML is read at a megabyte a second."""

NO_ROOM = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))
"""What is said of a disk that is full; Windows knows no quota."""

# What this process holds: a command holds its place from the start, and what writes there goes through it.
_held: set[Path] = set()
# What its command reads: nothing is written there.
_read: set[Path] = set()
# Of the command of another process so many characters are said: enough to know it by.
_COMMAND = 80


def read_whole(path: Path, most: int = LARGEST_TEXT) -> bytes:
    """The bytes of a file. Raises QuadrigError where it is larger than its kind is, and OSError as open does."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise QuadrigError(f"{path} is a device, a pipe or a socket; give a file")
    with path.open("rb") as stream:
        # What is no file has no size.
        known = os.fstat(stream.fileno()).st_size
        data = stream.read(most + 1) if known <= most else b""
    if known > most or len(data) > most:
        raise QuadrigError(f"{path}: is larger than {most // 10**6} MB, which no such file is; give another")
    return data


def read_text(path: Path) -> str:
    """The text of a file, as Path.read_text gives it, without the mark that some editors put before it.

    Raises as read_whole does, and where it is no UTF-8.
    """
    try:
        text = read_whole(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise QuadrigError(f"{path}: is not UTF-8, as a text has to be; save it as UTF-8") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


@contextmanager
def place_held(path: Path | str) -> Iterator[Path]:
    """The file that `path` leads to, where no other process of quadrig writes until the block ends.

    It is a lock on a hidden file beside it: gone with this process, however that ends, and what a process that was
    killed left there is removed by the next. Raises QuadrigError as refuse_no_place does, where nothing can be
    written in that folder, and where another process is at work there: which one.
    """
    path = Path(path)
    refuse_no_place(path)
    place = path.resolve()
    if place in _held:
        yield place
        return
    lock = place.with_name(f".{place.name}.lock")
    try:
        stream = _locked(lock)
    except BlockingIOError:
        raise QuadrigError(
            f"{path} is being written by {_holder(lock)}; wait for it, or choose another place"
        ) from None
    except OSError as error:
        raise cannot_write(path, error) from error
    _held.add(place)
    try:
        yield place
    finally:
        _held.discard(place)
        # Removed while it is locked, so that nobody locks it in between.
        with suppress(OSError):
            lock.unlink(missing_ok=True)
        stream.close()


@contextmanager
def written_beside(path: Path | str) -> Iterator[Path]:
    """A path to write to, in the folder of `path`; it becomes `path` when the block ends without an error.

    A link stays and what it leads to is written; a file that is there keeps its mode.
    Raises QuadrigError as place_held does, where it cannot be written to its end, and where a file of another kind is
    there: a recording that a report would replace cannot be made again.
    """
    with place_held(path) as place:
        try:
            beside = new_part(place)
        except OSError as error:
            raise cannot_write(path, error) from error
        try:
            yield beside
            sign_picture(beside)
            refuse_other_kind(path, file_kind(beside))
            beside.replace(place)
        except OSError as error:
            # One that names another file is of what was read.
            if error.filename not in (None, str(beside), str(place)):
                raise
            raise cannot_write(path, error) from error
        finally:
            with suppress(OSError):
                beside.unlink(missing_ok=True)


@contextmanager
def only_read(paths: Iterable[Path]) -> Iterator[None]:
    """Files that a command was given to read: until the block ends, nothing is written in their place."""
    added = {path.resolve() for path in paths} - _read
    _read.update(added)
    try:
        yield
    finally:
        _read.difference_update(added)


def refuse_other_kind(path: Path | str, new: str | None) -> None:
    """Raises QuadrigError where a file is there that is of another kind (file_kind) than what would replace it."""
    there = file_kind(Path(path))
    if there not in (None, new):
        new = new or "an empty file"
        raise QuadrigError(f"{path} is {there} and would be replaced by {new}; choose another place, or move it away")


def new_part(place: Path) -> Path:
    """A new hidden file beside a place that is held, to be renamed into it; with the mode that it will have there."""
    # A temporary file is private (0600); the finished one follows the user's own umask like any other.
    mode = stat.S_IMODE(place.stat().st_mode) if place.exists() else 0o666 & ~_umask()
    handle, name = tempfile.mkstemp(prefix=_part_prefix(place), suffix=place.suffix, dir=place.parent)
    os.close(handle)
    part = Path(name)
    part.chmod(mode)
    return part


def cannot_write(path: Path | str, error: OSError) -> QuadrigError:
    """What is said where a file cannot be written."""
    what = error.strerror or str(error)
    room = "make room, or " if error.errno in NO_ROOM else ""
    return QuadrigError(f"cannot write {path}: {what[:1].lower()}{what[1:]}; {room}choose another place")


def refuse_no_place(path: Path) -> None:
    """Raises QuadrigError where no file may be written: over a folder, a device or a pipe, over what is read-only,
    over what this command reads, or where its folder is absent, and for "-", which is no standard output here."""
    if str(path) == "-":
        raise QuadrigError("nothing is written to standard output but what a command prints; give the name of a file")
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
    if path.resolve() in _read:
        raise QuadrigError(
            f"{path} is what this command reads, and would be written over; name another file to write"
        )


def write_text(path: Path | str, text: str) -> None:
    """Write a text file (UTF-8) whole or not at all. Raises QuadrigError as written_beside does."""
    with written_beside(path) as beside:
        beside.write_text(text, encoding="utf-8")


def _part_prefix(place: Path) -> str:
    return f".{place.stem}.part-"


def _locked(lock: Path) -> IO[bytes]:
    """The lock's file, open and locked, in which this process is named; what was left beside it is removed.

    Raises BlockingIOError where another process has it.
    """
    while True:
        stream = lock.open("ab", buffering=0)
        try:
            alone = _lock(stream)
        except BlockingIOError:
            stream.close()
            raise
        # Whoever had it before removes it: another process may have a new one by now.
        if not _is_still(stream, lock):
            stream.close()
            continue
        try:
            stream.truncate(0)
            stream.write(f"{os.getpid()} {_command()}\n".encode())
        except OSError:
            lock.unlink()
            stream.close()
            raise
        if alone:
            _remove_parts(lock)
        return stream


def _is_still(stream: IO[bytes], lock: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(stream.fileno()), lock.stat())
    except FileNotFoundError:
        return False


def _lock(stream: IO[bytes]) -> bool:
    """Lock a file; whether that could be done: some file systems cannot."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        return False
    return True


def _remove_parts(lock: Path) -> None:
    place = lock.with_name(lock.name.removeprefix(".").removesuffix(".lock"))
    for part in place.parent.glob(f"{glob.escape(_part_prefix(place))}*{glob.escape(place.suffix)}"):
        with suppress(OSError):
            part.unlink()


def _command() -> str:
    words = [Path(sys.argv[0]).name, *sys.argv[1:]] if sys.argv else []
    return shlex.join(words)[:_COMMAND].replace("\n", " ")


def _holder(lock: Path) -> str:
    """Who holds a lock, in words."""
    try:
        number, _, command = lock.read_text(encoding="utf-8", errors="replace").strip().partition(" ")
    except OSError:
        number = command = ""
    return f"process {number} ({command})" if number else "another process"


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
