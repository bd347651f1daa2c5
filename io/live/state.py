"""What a live session shows: one value for the terminal and for rerun."""

from dataclasses import dataclass, field

from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.capture.source import SourceState
from quadrig.rig.coach.advice import Advice
from quadrig.rig.result import Rig
from quadrig.single.view import View


@dataclass(frozen=True, eq=False)
class SetupState:
    """One moment of a session.

    sentence: the one large sentence; note: a second, small one. frames, views: of the newest frameset. rate:
    framesets a second; latency: s from a frame's arrival until it was handed to the screens. kept:
    framesets kept so far.
    """

    sentence: str
    note: str = ""
    fault: bool = False
    frameset: int = -1
    stamp: int = 0
    frames: dict[str, Frame] = field(default_factory=dict)
    views: tuple[View, ...] = ()
    sources: tuple[SourceState, ...] = ()
    kept_views: tuple[View, ...] = ()
    kept: int = 0
    rig: Rig | None = None
    advice: Advice | None = None
    rate: float = 0.0
    latency: float = 0.0
