"""Videos as a camera's recording: files (mp4, avi, mkv...) and CompressedVideo topics, through PyAV."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from quadrig.io.recording.decode_image import shrunk
from quadrig.io.recording.limits import most_pixels, too_many_pixels
from quadrig.io.recording.messages.mcap_messages import McapMessages, OpenMessages
from quadrig.single.arrays import Ints, Picture
from quadrig.single.errors import QuadrigError

VIDEO_SUFFIXES = {".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v", ".mpg", ".mpeg", ".ts"}

_CODECS = {"h264": "h264", "h265": "hevc", "hevc": "hevc", "vp9": "vp9", "av1": "av1"}
# First plane is the luma: grey without a conversion.
_LUMA_FIRST = {
    *("yuv420p", "yuv422p", "yuv444p", "yuvj420p", "yuvj422p", "yuvj444p"),
    *("nv12", "nv21", "gray"),
}
# A key frame's parameter sets stand at its beginning; only the name of a frame and its stamp come before.
_KEY_FRAME_BYTES = 1500
# Where a picture says for certain that no other builds on it: a sub-layer's of H.265 may serve the layers above.
_SAYS_IDLE = {"h264"}
# Batches longer than this give no more speed, and the progress bar would stand still too long.
_LONGEST_BATCH = 120


@dataclass(frozen=True, eq=False)
class VideoFile:
    """Frames of a video file. times (N,): presentation times in units of time_base seconds, rising.

    keys (K,): indices of the frames at which decoding can begin. counted: the file carries no times, so that
    frames are counted from its start; timed: by the rate that it names, else by a second each.
    """

    path: Path
    encoding: str
    times: Ints
    time_base: float
    keys: Ints
    counted: bool = False
    timed: bool = True

    def __len__(self) -> int:
        return len(self.times)

    @property
    def files(self) -> tuple[Path, ...]:
        """As ImageSource has it."""
        return (self.path,)

    def stamps(self) -> Ints:
        """As ImageSource has it, from the start of the video."""
        return np.round(self.times * (self.time_base * 1e9)).astype(np.int64)

    def quick_stamps(self) -> Ints:
        """As ImageSource has it."""
        return self.stamps()

    def part(self, indices: Ints) -> "VideoFile":
        """As ImageSource has it."""
        # Where to begin is found by time, so the part needs no key frames of its own.
        none = np.zeros(0, np.int64)
        return replace(self, times=self.times[indices], keys=none)

    def images(self, gray: bool = True, shrink: int = 1) -> Iterator[Picture | None]:
        """As ImageSource has it."""
        yield from _pick(self._frames(), self.times, gray, shrink)

    def why_unreadable(self, _index: int) -> str:
        """As ImageSource has it: a picture builds on those before it."""
        return ""

    def batches(self, indices: Ints, size: int) -> list[Ints]:
        """As ImageSource has it."""
        if self.counted:
            return [indices] if len(indices) else []
        return _batches_at(self.keys, indices, size)

    def _frames(self) -> Iterator[tuple[int | None, Any]]:
        """Frames with their times, from the key frame before the first time on, as far as the file can be read."""
        import av
        from av.error import FFmpegError

        try:
            with av.open(str(self.path)) as container:
                stream = container.streams.video[0]
                stream.codec_context.thread_count = 1
                stream.codec_context.options = {"max_pixels": str(most_pixels())}
                if not self.counted and len(self) and self.times[0] > 0:
                    container.seek(int(self.times[0]), stream=stream, backward=True)
                if self.counted:
                    yield from enumerate(container.decode(stream))
                    return
                wanted = set(self.times.tolist())
                for packet in container.demux(stream):
                    _pass_over_idle(stream.codec_context, packet, wanted)
                    yield from ((frame.pts, frame) for frame in packet.decode())
        except (FFmpegError, ValueError):
            return


@dataclass(frozen=True, eq=False)
class McapVideo:
    """Frames of a CompressedVideo topic. wanted (N,): which messages' images count; None: all."""

    messages: McapMessages
    encoding: str
    wanted: Ints | None = field(default=None)
    timed: bool = True

    def __len__(self) -> int:
        return len(self.messages) if self.wanted is None else len(self.wanted)

    @property
    def files(self) -> tuple[Path, ...]:
        """As ImageSource has it."""
        return self.messages.paths

    @cached_property
    def keys(self) -> Ints:
        """Indices of the messages at which decoding can begin."""
        with self.messages.opened() as opened:
            keys = [k for k in range(len(self.messages)) if k == 0 or self._is_key(opened, k)]
        return np.array(keys, np.int64)

    def stamps(self) -> Ints:
        """As ImageSource has it."""
        stamps = self.messages.stamps()
        return stamps if self.wanted is None else stamps[self.wanted]

    def quick_stamps(self) -> Ints:
        """As ImageSource has it."""
        stamps = self.messages.quick_stamps()
        return stamps if self.wanted is None else stamps[self.wanted]

    def part(self, indices: Ints) -> "McapVideo":
        """As ImageSource has it: from the key frame before the first to the last."""
        indices = np.asarray(indices)
        if len(indices) == 0:
            return McapVideo(self.messages.part(indices), self.encoding)
        first = self.keys[np.searchsorted(self.keys, indices[0], side="right") - 1]
        return McapVideo(
            self.messages.part(np.arange(int(first), int(indices[-1]) + 1)), self.encoding, indices - first
        )

    def images(self, gray: bool = True, shrink: int = 1) -> Iterator[Picture | None]:
        """As ImageSource has it."""
        wanted = np.arange(len(self.messages)) if self.wanted is None else self.wanted
        frames = self._frames(set(wanted.tolist()))
        yield from _pick(((frame.pts, frame) for frame in frames), wanted, gray, shrink)

    def why_unreadable(self, _index: int) -> str:
        """As ImageSource has it: a picture builds on those before it."""
        return ""

    def batches(self, indices: Ints, size: int) -> list[Ints]:
        """As ImageSource has it."""
        return _batches_at(self.keys, indices, size)

    def _is_key(self, opened: OpenMessages, index: int) -> bool:
        try:
            if self.messages.message_encoding == "json":
                return _begins_key_frame(opened.image(index).data, self.encoding)
            return _begins_key_frame(opened.data(index, _KEY_FRAME_BYTES), self.encoding)
        except ValueError:
            return False

    def _frames(self, wanted: set[int]) -> Iterator[Any]:
        import av
        from av.error import FFmpegError

        if self.encoding not in _CODECS:
            raise ValueError(f"a video of {self.encoding!r} is none of {', '.join(_CODECS)}")
        decoder: Any = av.CodecContext.create(_CODECS[self.encoding], "r")
        decoder.thread_count = 1
        decoder.options = {"max_pixels": str(most_pixels())}
        with self.messages.opened() as opened:
            for index in range(len(self.messages)):
                try:
                    packet = av.Packet(opened.image(index).data)
                    packet.pts = packet.dts = index
                    _pass_over_idle(decoder, packet, wanted)
                    # An empty one would be the end of the video.
                    yield from decoder.decode(packet) if packet.size else ()
                except (FFmpegError, ValueError):
                    continue
        with suppress(FFmpegError):
            yield from decoder.decode(None)


def read_video(path: Path) -> VideoFile:
    """The frames of a video file, found without decoding them. Raises QuadrigError where it is no video."""
    import av
    from av.error import FFmpegError

    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise QuadrigError(f"{path}: no video in this file; give a recording of a camera")
            stream = container.streams.video[0]
            if refused := too_many_pixels(stream.codec_context.width, stream.codec_context.height):
                raise QuadrigError(f"{path}: its pictures of {refused}")
            packets = [(p.pts, p.dts, p.is_keyframe) for p in container.demux(stream) if p.size]
            name, base = stream.codec_context.name, stream.time_base
            rate = stream.average_rate
    except (FFmpegError, OSError, ValueError) as error:
        # ValueError: words in it that are no UTF-8.
        raise QuadrigError(f"{path}: cannot be read as a video ({error}); is it whole?") from error
    if not packets:
        raise QuadrigError(f"{path}: this video has no frames; was its recording cut off?")
    if base is None or any(pts is None for pts, _, _ in packets):
        period, first = float(1 / rate) if rate else 1.0, np.zeros(1, np.int64)
        return VideoFile(path, name, np.arange(len(packets)), period, first, counted=True, timed=bool(rate))
    times = np.array([pts for pts, _, _ in packets], np.int64)
    order = np.argsort(times, kind="stable")
    keys = np.flatnonzero(np.array([key for _, _, key in packets])[order])
    return VideoFile(path, name, times[order], float(base), keys)


def _pass_over_idle(decoder: Any, packet: Any, wanted: set[int]) -> None:
    """Have the decoder leave out the picture of this packet where nobody wants it and no other builds on it."""
    if decoder.name in _SAYS_IDLE:
        decoder.skip_frame = "DEFAULT" if packet.pts is None or packet.pts in wanted else "NONREF"


def _pick(
    frames: Iterator[tuple[int | None, Any]], wanted: Ints, gray: bool, shrink: int
) -> Iterator[Picture | None]:
    """The images at the wanted, rising times; None for those that do not come."""
    position = 0
    for time, frame in frames:
        while position < len(wanted) and time is not None and time > wanted[position]:
            position += 1
            yield None
        if position == len(wanted):
            return
        if time == wanted[position]:
            position += 1
            yield shrunk(_array(frame, gray), shrink)
    for _ in range(position, len(wanted)):
        yield None


def _array(frame: Any, gray: bool) -> Picture:
    if not gray:
        return frame.to_ndarray(format="bgr24")
    if frame.format.name not in _LUMA_FIRST:
        return frame.to_ndarray(format="gray")
    luma = frame.planes[0]
    rows = np.frombuffer(luma, np.uint8).reshape(-1, luma.line_size)
    return rows[: frame.height, : frame.width].copy()


def _batches_at(keys: Ints, indices: Ints, size: int) -> list[Ints]:
    """Batches that begin at key frames, so that no frame is decoded twice, as far as that keeps them short."""
    groups = np.searchsorted(keys, indices, side="right")
    batches: list[list[int]] = [[]]
    previous = -1
    for index, group in zip(indices.tolist(), groups.tolist(), strict=True):
        if len(batches[-1]) >= (size if group != previous else _LONGEST_BATCH):
            batches.append([])
        batches[-1].append(index)
        previous = group
    return [np.array(batch, np.int64) for batch in batches if batch]


def _begins_key_frame(data: bytes, encoding: str) -> bool:
    """Whether the NAL units (Annex B) at the start of these bytes belong to a key frame (H.264 and H.265)."""
    position = data.find(b"\0\0\1")
    while 0 <= position < len(data) - 3:
        unit = data[position + 3]
        if encoding == "h264" and unit & 0x1F in (5, 7):
            return True
        if encoding in ("h265", "hevc") and (16 <= (unit >> 1) & 0x3F <= 21 or (unit >> 1) & 0x3F in (32, 33)):
            return True
        position = data.find(b"\0\0\1", position + 3)
    return False
