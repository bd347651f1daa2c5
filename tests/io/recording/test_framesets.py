"""Framesets: images of one instant are found by time, whatever the cameras' rates, gaps and starts."""

from pathlib import Path

import numpy as np
import pytest

from quadrig.io.recording.camera import RecordedCamera
from quadrig.io.recording.framesets import NO_FRAME, build_framesets, match_stamps
from quadrig.io.recording.image_folder import ImageFiles
from quadrig.io.recording.image_source import Stamped
from quadrig.io.recording.recorded_cameras import Recording
from quadrig.single.errors import QuadrigError

MILLISECOND = 10**6


def recording(**stamps: np.ndarray) -> Recording:
    """A recording without files; stamps in seconds."""
    cameras = []
    for name, times in stamps.items():
        files = ImageFiles((Path("image.png"),) * len(times), np.arange(len(times)), np.zeros(len(times), int))
        stamped = Stamped(files, np.round(times * 1e9).astype(np.int64))
        cameras.append(RecordedCamera(name, name, 1, 1, stamped))
    return Recording((), (), tuple(cameras))


def test_equal_rates_with_jitter_and_offsets():
    rng = np.random.default_rng(1)
    truth = np.arange(100) / 30
    found = build_framesets(recording(
        a=truth + rng.normal(0, 0.001, 100), b=truth + 0.008 + rng.normal(0, 0.001, 100), c=truth - 0.005,
    ))  # fmt: skip
    assert len(found) == 100
    assert np.array_equal(found.frames, np.repeat(np.arange(100)[:, None], 3, axis=1))
    offsets = {report.camera: report.offset for report in found.report}
    assert offsets["b"] - offsets["a"] == pytest.approx(0.008, abs=0.001)
    assert offsets["c"] - offsets["a"] == pytest.approx(-0.005, abs=0.001)
    # Half of 33 ms, which is as far as the nearest image of another camera can be.
    assert found.tolerance == pytest.approx(1 / 60, rel=0.1)


def test_different_rates_join_where_they_meet():
    found = build_framesets(recording(fast=np.arange(300) / 60, slow=np.arange(50) / 10 + 0.003))
    assert len(found) == 300
    both = np.all(found.frames != NO_FRAME, axis=1)
    assert np.flatnonzero(both).tolist() == list(range(0, 300, 6))
    assert {(report.camera, report.used, report.dropped) for report in found.report} == {
        ("fast", 50, 250),
        ("slow", 50, 0),
    }


def test_dropped_frames_and_a_late_start():
    rng = np.random.default_rng(2)
    ticks = np.arange(200)
    kept = {"a": ticks[rng.random(200) > 0.1], "b": ticks[rng.random(200) > 0.2], "late": ticks[120:]}
    found = build_framesets(recording(**{name: numbers / 25 for name, numbers in kept.items()}))
    for column, numbers in enumerate(kept.values()):
        # Every image is in exactly one frameset, that of its own tick.
        at = found.frames[:, column] != NO_FRAME
        assert np.array_equal(found.frames[at, column], np.arange(len(numbers)))
        assert np.array_equal(np.round(found.times[at] / 40 / MILLISECOND), numbers)
    assert np.all(np.diff(found.times) > 0)
    assert np.any(np.all(found.frames[:, :2] == NO_FRAME, axis=1))


def test_cameras_that_were_never_on_together():
    found = build_framesets(recording(a=np.arange(10.0), b=np.arange(100.0, 110.0)))
    assert np.all(found.sizes() == 1)
    assert [report.used for report in found.report] == [0, 0]
    assert all(np.isnan(report.offset) for report in found.report)


def test_tolerance_given():
    stamps = {"a": np.arange(50) / 10, "b": np.arange(50) / 10 + 0.02}
    assert np.all(build_framesets(recording(**stamps), 0.021).sizes() == 2)
    assert np.all(build_framesets(recording(**stamps), 0.019).sizes() == 1)
    with pytest.raises(QuadrigError, match="tolerance"):
        build_framesets(recording(**stamps), -1.0)


def test_stamps_that_do_not_rise_keep_their_images():
    times = np.array([0.0, 0.2, 0.1, 0.3])
    found = build_framesets(recording(a=times, b=np.arange(4) / 10))
    assert found.frames.tolist() == [[0, 0], [2, 1], [1, 2], [3, 3]]
    sets, images = found.of_camera("a")
    assert images.tolist() == [0, 1, 2, 3]
    assert sets.tolist() == [0, 2, 1, 3]


@pytest.mark.parametrize("seed", range(20))
def test_every_image_once_and_near_its_instant(seed):
    rng = np.random.default_rng(seed)
    stamps = [np.sort(rng.integers(0, 10**10, rng.integers(0, 60))) for _ in range(4)]
    if not any(len(one) for one in stamps):
        return
    tolerance = 10**8
    times, frames = match_stamps(stamps, tolerance)
    for column, one in enumerate(stamps):
        at = frames[:, column] != NO_FRAME
        assert sorted(frames[at, column]) == list(range(len(one)))
        assert np.all(np.abs(one[frames[at, column]] - times[at]) <= tolerance)
    assert np.all(np.diff(times) >= 0)
