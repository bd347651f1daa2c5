"""What every reader of pictures is: opened by open_reader, it blocks while it reads, and knows nothing of threads.

It gives (media time in ns, bytes or picture) until read() returns None at the end, and raises SourceLostError where
the source went away and may come back.
"""

from typing import Protocol

from quadrig.single.arrays import Picture

# A network source that says nothing for this long (s) is lost: a camera of 1 frame a second has missed three.
NETWORK_PATIENCE = 3.0

PictureData = bytes | Picture
"""A picture as its source gave it: a JPEG or PNG, or decoded (H, W) or (H, W, 3)."""


class SourceLostError(Exception):
    """A source went away; the message says how."""


class Reader(Protocol):
    """Something that gives pictures one after the other.

    live: the pictures come at their own pace and their time is the clock's; else the time is the medium's.
    """

    live: bool

    def read(self) -> tuple[int, PictureData] | None:
        """Next media time (ns; ignored where live) and picture; None at the end. Raises SourceLostError."""
        ...

    def close(self) -> None:
        """Let go of the device or file."""
        ...
