"""The Views a live session kept, written into its recording as they are kept and read back by --resume."""

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from quadrig.single.view import View

KEPT_TOPIC = "/quadrig/kept_views"
KEPT_SCHEMA = "quadrig.KeptViews"


class _KeptView(msgspec.Struct):
    """One View; JSON writes a float64 so that it comes back to the last bit."""

    camera: str
    rectangle: str
    points: list[list[float]]
    pixels: list[list[float]]
    alternatives: list[list[list[float]]]
    sigma: float


class _KeptFrameset(msgspec.Struct):
    frameset: int
    sizes: dict[str, tuple[int, int]]
    views: list[_KeptView]


def encode_views(frameset: int, views: Sequence[View], sizes: dict[str, tuple[int, int]]) -> bytes:
    """The JSON of one kept frameset. sizes: width and height, px, of each camera's pictures."""
    kept = [
        _KeptView(
            v.camera,
            v.rectangle,
            v.points.tolist(),
            v.pixels.tolist(),
            [reading.tolist() for reading in v.alternatives],
            float(v.sigma),
        )
        for v in views
    ]
    return msgspec.json.encode(_KeptFrameset(frameset, sizes, kept))


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
                    kept = msgspec.json.decode(record.data, type=_KeptFrameset)
                    sizes.update(kept.sizes)
                    views += [_view(kept.frameset, view) for view in kept.views]
        except (McapError, EOFError):
            # A session that was killed leaves a file without an end; what came before the cut is whole.
            pass
    return views, sizes


def _view(frameset: int, kept: _KeptView) -> View:
    return View(
        kept.rectangle,
        np.array(kept.points),
        np.array(kept.pixels),
        kept.camera,
        frameset,
        tuple(np.array(reading) for reading in kept.alternatives),
        kept.sigma,
    )
