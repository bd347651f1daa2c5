"""The Views a live session kept, written into its recording as they are kept and read back by --resume."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from quadrig.io.rig_file.view_record import ViewRecord, recorded_view, view_record
from quadrig.io.safe_json import read_json
from quadrig.single.view import View

KEPT_TOPIC = "/quadrig/kept_views"
KEPT_SCHEMA = "quadrig.KeptViews"


class _KeptFrameset(msgspec.Struct):
    frameset: int
    sizes: dict[str, tuple[int, int]]
    views: list[ViewRecord]


def encode_views(frameset: int, views: Sequence[View], sizes: dict[str, tuple[int, int]]) -> bytes:
    """The JSON of one kept frameset. sizes: width and height, px, of each camera's pictures."""
    return msgspec.json.encode(_KeptFrameset(frameset, sizes, [view_record(view) for view in views]))


@dataclass(frozen=True, eq=False)
class EarlierViews:
    """What earlier sessions kept. sizes: width and height, px, of each camera's pictures."""

    views: tuple[View, ...]
    sizes: dict[str, tuple[int, int]]

    @property
    def framesets(self) -> int:
        """The first index of a frameset that none of the Views has."""
        return max((view.frameset for view in self.views), default=-1) + 1


def read_earlier_views(paths: Sequence[Path], cameras: Sequence[str]) -> EarlierViews:
    """What the sessions of these recordings kept of these cameras."""
    views: list[View] = []
    sizes: dict[str, tuple[int, int]] = {}
    for path in paths:
        kept, kept_sizes = read_kept_views(path)
        views += [view for view in kept if view.camera in cameras]
        sizes.update({name: size for name, size in kept_sizes.items() if name in cameras})
    return EarlierViews(tuple(views), sizes)


def read_kept_views(path: Path) -> tuple[list[View], dict[str, tuple[int, int]]]:
    """Views and picture sizes of a session's recording, be it whole or cut off at any byte."""
    from mcap.exceptions import McapError
    from mcap.records import Channel, Message
    from mcap.stream_reader import StreamReader

    views: list[View] = []
    sizes: dict[str, tuple[int, int]] = {}
    channels: set[int] = set()
    with path.open("rb") as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Channel) and record.topic == KEPT_TOPIC:
                    channels.add(record.id)
                elif isinstance(record, Message) and record.channel_id in channels:
                    kept: _KeptFrameset = read_json(record.data, _KeptFrameset)
                    sizes.update(kept.sizes)
                    views += [replace(recorded_view(view), frameset=kept.frameset) for view in kept.views]
        except (McapError, EOFError, ValueError):
            # A session that was killed leaves a file without an end; what came before the cut is whole.
            pass
    return views, sizes
