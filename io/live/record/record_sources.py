"""Live cameras into a recording, as they come: setup's sources and recorder, nothing searched and nobody coached."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.capture.source import Source, SourceState
from quadrig.io.live.capture.source_spec import SourceSpec
from quadrig.io.live.record.recorder import LiveRecorder
from quadrig.single.errors import QuadrigError

# Much shorter than a frame of the quickest camera: a source keeps eight frames back.
_LOOK_EVERY = 0.004


@dataclass(frozen=True)
class RecordedSource:
    """What one source gave: frames, the size of its first picture (px; 0 where it gave none), and how it ended.

    left_out: pictures that were not of its camera.
    """

    name: str
    frames: int
    width: int
    height: int
    detail: str = ""
    left_out: int = 0


@dataclass(frozen=True)
class LiveRecording:
    """What was recorded. dropped: frames that the disk could not keep up with; ending: why it stopped."""

    sources: tuple[RecordedSource, ...]
    seconds: float
    dropped: int
    ending: str


def record_sources(
    specs: Mapping[str, SourceSpec],
    output: Path,
    stop: Callable[[], str],
    show: Callable[[Sequence[SourceState]], None],
    attachments: Mapping[str, bytes] | None = None,
) -> LiveRecording:
    """Record every frame of live sources until `stop` says why, Ctrl-C, or all of them have ended.

    show: gets how the sources do, over and over. attachments: files that go with the recording, by name.
    The recording is closed whatever happens; where no source gave a picture there is none, and an old one stays.
    Raises QuadrigError where it cannot be written, or no source gave a picture.
    """
    began, ending = time.monotonic(), "interrupted"
    first: dict[str, Frame] = {}
    counts = dict.fromkeys(specs, 0)
    with ExitStack() as stack:
        recorder = stack.enter_context(closing(LiveRecorder(output, attachments)))
        start = time.time_ns()
        sources = [stack.enter_context(closing(Source(name, spec, start=start))) for name, spec in specs.items()]
        try:
            while not (asked := stop()):
                states = [source.state() for source in sources]
                for source in sources:
                    for frame in source.frames():
                        recorder.write(frame)
                        first.setdefault(source.name, frame)
                        counts[source.name] += 1
                        source.drop_through(frame.stamp)
                show(states)
                if all(state.condition in ("ended", "failed") for state in states):
                    asked = "every source has ended"
                    break
                time.sleep(_LOOK_EVERY)
            ending = asked
        except KeyboardInterrupt:
            pass
        states = [source.state() for source in sources]
    if not first:
        why = "; ".join(state.detail for state in states if state.detail) or "look at the sources"
        raise QuadrigError(f"no source gave a picture: {why}")
    recorded = tuple(_recorded(state, counts[state.name], first.get(state.name)) for state in states)
    return LiveRecording(recorded, time.monotonic() - began, recorder.dropped, ending)


def _recorded(state: SourceState, count: int, first: Frame | None) -> RecordedSource:
    try:
        height, width = (0, 0) if first is None else first.grey.shape
    except QuadrigError:
        height, width = 0, 0
    return RecordedSource(state.name, count, width, height, state.detail, state.left_out)
