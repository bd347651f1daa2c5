"""Files for the rerun viewer, written whole or not at all."""

import os
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from quadrig.io.whole_file import written_beside

# Bytes that a pipe hands over at once.
_PIECE = 1 << 16


@contextmanager
def rrd_written(path: Path, name: str, blueprint: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """A stream to log to; what was logged is in the file (.rrd) when the block ends without an error.

    Raises QuadrigError as written_beside does.
    """
    with written_beside(path) as beside, _draining_into(beside) as sink:
        stream = rr.RecordingStream(name)
        try:
            stream.save(str(sink), default_blueprint=blueprint)
            yield stream
        finally:
            stream.disconnect()


@contextmanager
def _draining_into(path: Path) -> Iterator[Path]:
    """A pipe whose bytes go into `path`. Raises OSError where they find no room, when all of them were taken.

    rerun waits for its own writing thread, and for ever where that dies of a full disk: here it never does.
    """
    if not hasattr(os, "mkfifo"):  # Windows: a full disk ends in rerun's own words there
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        pipe = Path(folder) / "rrd"
        os.mkfifo(pipe)
        # Open at both ends before rerun comes: neither waits for the other, and the end is there when all let go.
        source = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
        keeper = os.open(pipe, os.O_WRONLY)
        os.set_blocking(source, True)
        errors: list[OSError] = []
        thread = threading.Thread(target=_drain, args=(source, path, errors), name="rrd", daemon=True)
        thread.start()
        try:
            yield pipe
        finally:
            os.close(keeper)
            thread.join()
            os.close(source)
        if errors:
            raise errors[0]


def _drain(source: int, path: Path, errors: list[OSError]) -> None:
    try:
        with path.open("wb") as file:
            while piece := os.read(source, _PIECE):
                file.write(piece)
    except OSError as error:
        errors.append(error)
        while os.read(source, _PIECE):
            pass
