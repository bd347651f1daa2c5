"""Which paths are parts of one recording, and which are recordings of their own of the same cameras."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from quadrig.io.recording.image_folder import IMAGE_SUFFIXES
from quadrig.io.recording.messages.ros_bag import is_bag
from quadrig.io.recording.recorded_cameras import Recording, open_recording
from quadrig.io.recording.video import VIDEO_SUFFIXES
from quadrig.single.errors import QuadrigError

# Parts of a bag that was split follow one another at once; somebody who begins anew takes longer (s).
_FOLLOWS_WITHIN = 10.0


@dataclass
class _Group:
    paths: list[Path]
    spans: dict[str, tuple[float, float]] = field(default_factory=dict)


def separate_recordings(paths: Sequence[Path | str] | Path | str, rate: float | None = None) -> list[list[Path]]:
    """The paths of each recording: a path that brings a camera again begins another one, unless it is the next part
    of a split MCAP file. Paths that cannot be opened by themselves stay with those before them."""
    given = [Path(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    groups: list[_Group] = []
    for path in given if len(given) > 1 else []:
        try:
            spans = _spans(open_recording(path, rate=rate))
        except QuadrigError:
            spans = {}
        group = next((one for one in groups if _belongs(spans, one.spans)), None)
        if group is None:
            group = _Group([])
            groups.append(group)
        group.paths.append(path)
        for name, (first, last) in spans.items():
            before = group.spans.get(name, (first, last))
            group.spans[name] = (min(first, before[0]), max(last, before[1]))
    return [group.paths for group in groups] if groups else [given]


def _spans(recording: Recording) -> dict[str, tuple[float, float]]:
    """When each camera recorded, s: empty intervals where its images carry no time that two recordings share."""
    spans = {}
    for camera in recording.cameras:
        stamps = camera.source.quick_stamps()
        shared = all(path.suffix.lower() not in VIDEO_SUFFIXES | IMAGE_SUFFIXES for path in recording.files)
        of_a_clock = shared and not any(path.is_dir() and not is_bag(path) for path in recording.files)
        begin, end = (float(stamps.min()) / 1e9, float(stamps.max()) / 1e9) if len(stamps) else (0.0, 0.0)
        spans[camera.name] = (begin, end) if of_a_clock else (float("inf"), float("-inf"))
    return spans


def _belongs(spans: dict[str, tuple[float, float]], group: dict[str, tuple[float, float]]) -> bool:
    """Whether what these cameras recorded can be of one recording with the group's."""
    return all(
        first <= group[name][1] + _FOLLOWS_WITHIN and group[name][0] <= last + _FOLLOWS_WITHIN
        for name, (first, last) in spans.items()
        if name in group
    )
