"""Files for the rerun viewer, written whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from quadrig.io.whole_file import written_beside
from quadrig.single.errors import QuadrigError


@contextmanager
def rrd_written(path: Path, name: str, blueprint: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """A stream to log to; what was logged is in the file (.rrd) when the block ends without an error.

    Raises QuadrigError as written_beside does.
    """
    with written_beside(path) as beside:
        stream = rr.RecordingStream(name)
        try:
            stream.save(str(beside), default_blueprint=blueprint)
            yield stream
            stream.flush()
        except RuntimeError as error:
            # Its own thread writes, and says no more than that it ended.
            raise QuadrigError(f"cannot write {path}: {error}; make room, or choose another place") from error
        finally:
            stream.disconnect()
