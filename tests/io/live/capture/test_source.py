"""Sources: files, folders and a stream served on this machine; what stalls or goes away holds nobody up."""

import os
import signal
import struct
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from socketserver import StreamRequestHandler, ThreadingTCPServer

import cv2
import pytest

from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.capture.framesets import LiveFramesets
from quadrig.io.live.capture.source import Pace, Source
from quadrig.io.live.capture.source_spec import parse_source
from quadrig.io.live.record.recorder import LiveRecorder
from quadrig.single.errors import QuadrigError


def number_of(frame: Frame) -> int:
    grey = frame.grey
    return sum(1 << bit for bit in range(8) if grey[90, 40 * bit + 20] > 120)


@contextmanager
def rtsp_server(stream: Path, rate: float = 30.0):
    """An RTSP server on 127.0.0.1 that plays an MPEG transport stream over the connection itself (RFC 2326, 2250)."""
    stopped = threading.Event()

    class Handler(StreamRequestHandler):
        def handle(self):
            while (request := self.request_lines()) and "PLAY" not in request[0]:
                self.answer(request)
            if request:
                self.answer(request)
                self.play(stream.read_bytes())

        def request_lines(self) -> list[str]:
            lines = []
            while line := self.rfile.readline().decode().strip():
                lines.append(line)
            return lines

        def answer(self, request: list[str]):
            method, sequence = request[0].split()[0], next(r for r in request if r.lower().startswith("cseq"))
            head, body = "Session: 1\r\n", ""
            if method == "OPTIONS":
                head = "Public: OPTIONS, DESCRIBE, SETUP, PLAY\r\n"
            elif method == "DESCRIBE":
                body = (
                    "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=test\r\nt=0 0\r\nm=video 0 RTP/AVP 33\r\na=control:one\r\n"
                )
                head = f"Content-Type: application/sdp\r\nContent-Length: {len(body)}\r\n"
            elif method == "SETUP":
                head += "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n"
            self.wfile.write(f"RTSP/1.0 200 OK\r\n{sequence}\r\n{head}\r\n{body}".encode())

        def play(self, data: bytes):
            size = 7 * 188
            parts = [data[k : k + size] for k in range(0, len(data), size)]
            for number, part in enumerate(parts):
                header = struct.pack(">BBHII", 0x80, 33, number & 0xFFFF, 3000 * number, 1)
                try:
                    self.wfile.write(b"$" + struct.pack(">BH", 0, len(header + part)) + header + part)
                except OSError:
                    return
                if stopped.wait(0.2 / rate):
                    return

    server = ThreadingTCPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"rtsp://127.0.0.1:{server.server_address[1]}/stream"
    finally:
        stopped.set()
        server.shutdown()
        server.server_close()


@contextmanager
def sources_of(pace: Pace = "real time", **texts):
    start = time.time_ns()
    opened = [Source(name, parse_source(text), pace, start) for name, text in texts.items()]
    try:
        yield opened
    finally:
        for source in opened:
            source.close()


def framesets_of(sources, most=1000, **options):
    collector, found = LiveFramesets(sources, **options), []
    while len(found) < most and (frameset := collector.next(timeout=2)) is not None:
        found.append(frameset)
    return found


def wait_for(condition, seconds=8.0):
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, "it did not happen"
        time.sleep(0.01)


@pytest.mark.parametrize(("codec", "ending"), [("MJPG", "avi"), ("mp4v", "mp4")])
def test_video_consumed_gives_every_frame_once(tmp_path, codec, ending, numbered):
    paths = [str(numbered.write_video(tmp_path / f"{name}.{ending}", 40, codec=codec)) for name in "ab"]
    with sources_of("consumed", a=paths[0], b=paths[1]) as sources:
        framesets = framesets_of(sources)
    assert [number_of(f.frames["a"]) for f in framesets] == list(range(40))
    assert [number_of(f.frames["b"]) for f in framesets] == list(range(40))
    assert all(f.frames["a"].stamp == f.frames["b"].stamp for f in framesets)


def test_files_of_different_rates_meet_at_the_same_instants(tmp_path, numbered):
    fast = numbered.write_video(tmp_path / "fast.avi", 40, rate=40)
    slow = numbered.write_video(tmp_path / "slow.avi", 10, rate=10, step=4)
    with sources_of("consumed", fast=str(fast), slow=str(slow)) as sources:
        framesets = [f for f in framesets_of(sources) if len(f.frames) == 2]
    assert len(framesets) == 10
    assert all(number_of(f.frames["fast"]) == number_of(f.frames["slow"]) for f in framesets)


def test_video_in_real_time_keeps_its_clock_and_drops_what_nobody_fetched(tmp_path, numbered):
    path = numbered.write_video(tmp_path / "a.avi", 45, rate=30)
    with sources_of(a=str(path)) as sources:
        collector, numbers = LiveFramesets(sources), []
        while (frameset := collector.next(timeout=1)) is not None:
            numbers.append(number_of(frameset.frames["a"]))
            # A frame is shown when its moment has come, never before.
            assert frameset.frames["a"].stamp <= time.time_ns()
            time.sleep(0.1)
    assert numbers == sorted(set(numbers))
    assert len(numbers) < 30


def test_folder_of_pictures_plays_in_the_order_of_names(tmp_path, numbered):
    for number in range(12):
        cv2.imwrite(str(tmp_path / f"{number:03}.png"), numbered.numbered_picture(number))
    with sources_of("consumed", a=str(tmp_path)) as sources:
        assert [number_of(f.frames["a"]) for f in framesets_of(sources)] == list(range(12))


def test_watched_folders_give_pictures_as_they_fall(tmp_path, numbered):
    for name in "ab":
        (tmp_path / name).mkdir()
    with sources_of(a=f"watch:{tmp_path / 'a'}", b=f"watch:{tmp_path / 'b'}") as sources:
        collector, seen = LiveFramesets(sources), []
        for number in (3, 4):
            for name in "ab":
                (tmp_path / name / f"{number}.jpg").write_bytes(numbered.jpeg(number))
            wait_for(lambda: all(s.frames() for s in sources))
            frameset = collector.next()
            assert frameset is not None
            seen.append({name: number_of(frame) for name, frame in frameset.frames.items()})
    assert seen == [{"a": 3, "b": 3}, {"a": 4, "b": 4}]


@pytest.mark.parametrize("lengths", [True, False])
def test_http_stream_arrives_whole(lengths, numbered):
    with numbered.stream(lengths=lengths) as address, sources_of(a=address) as sources:
        numbers = [number_of(f.frames["a"]) for f in framesets_of(sources, most=12)]
    assert len(numbers) == 12
    assert numbers == sorted(set(numbers))


def test_rtsp_stream_arrives_and_its_end_is_tried_again(tmp_path, numbered):
    stream = numbered.write_video(tmp_path / "stream.ts", 60, codec="mp4v")
    with rtsp_server(stream) as address, sources_of(a=address) as sources:
        numbers = [number_of(f.frames["a"]) for f in framesets_of(sources, most=20)]
        assert len(numbers) == 20
        assert numbers == sorted(set(numbers))
        wait_for(lambda: sources[0].state().condition == "lost", seconds=20)
        wait_for(lambda: sources[0].state().frames > 60, seconds=20)


def test_stream_that_breaks_off_is_tried_again(numbered):
    with numbered.stream(rate=60, breaks_after=5) as address, sources_of(a=address) as sources:
        wait_for(lambda: sources[0].state().condition == "lost")
        assert "gives no more pictures" in sources[0].state().detail
        wait_for(lambda: sources[0].state().frames > 5)
        assert sources[0].state().retries >= 1


def test_silent_and_absent_sources_are_named_and_hold_nobody_up(tmp_path, numbered):
    path = numbered.write_video(tmp_path / "a.avi", 120)
    with (
        numbered.stream(rate=60, silent_after=3) as silent,
        sources_of(a=str(path), silent=silent, absent="http://127.0.0.1:9/none") as sources,
    ):
        framesets = framesets_of(sources, most=60)
        states = {s.name: s.state().condition for s in sources}
    # A busy machine misses some; waiting for the silent one would leave none after its third.
    assert sum("a" in f.frames for f in framesets) > 20
    assert states["a"] == "running"
    assert states["silent"] == "stalled"
    assert states["absent"] == "lost"


def test_source_that_does_not_exist_is_one_clear_sentence(tmp_path):
    with pytest.raises(QuadrigError, match=r"nothing\.mp4.*no such file"):
        parse_source("nothing.mp4", tmp_path)


def test_file_that_is_no_video_fails_by_itself(tmp_path):
    (tmp_path / "text.mp4").write_text("no video")
    with sources_of(a=str(tmp_path / "text.mp4")) as sources:
        wait_for(lambda: sources[0].state().condition == "failed")
        assert "text.mp4" in sources[0].state().detail


def read_stream(path: Path) -> list[tuple[str, int, bytes]]:
    """Every message of an MCAP read from its beginning until it breaks off."""
    from mcap.exceptions import McapError
    from mcap.records import Channel, Message
    from mcap.stream_reader import StreamReader

    topics, messages = {}, []
    with path.open("rb") as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    messages.append((topics[record.channel_id], record.log_time, record.data))
        except (McapError, EOFError):
            pass
    return messages


def test_recording_gives_back_what_came(tmp_path, numbered):
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
    from mcap.reader import make_reader

    path = tmp_path / "r.mcap"
    recorder = LiveRecorder(path, {"rig.toml": b"reference = 'a'"})
    for number in range(20):
        recorder.write(Frame("a", 1000 + number, 0.0, encoded=numbered.jpeg(number)))
        recorder.write(Frame("b", 1000 + number, 0.0, picture=numbered.numbered_picture(number)))
    recorder.close()
    with path.open("rb") as file:
        reader = make_reader(file)
        assert next(iter(reader.iter_attachments())).data == b"reference = 'a'"
        seen = {"/a/image_raw/compressed": [], "/b/image_raw/compressed": []}
        for _, channel, message in reader.iter_messages():
            image = CompressedImage.FromString(message.data)
            assert image.format == "jpeg"
            frame = Frame("x", message.log_time, 0.0, encoded=image.data)
            seen[channel.topic].append((message.log_time - 1000, number_of(frame)))
    assert all(numbers == [(n, n) for n in range(20)] for numbers in seen.values())


WRITES_UNTIL_KILLED = """
import sys, time
from pathlib import Path
import numpy as np
from quadrig.io.live.capture.frame import Frame
from quadrig.io.live.record.recorder import LiveRecorder
recorder = LiveRecorder(Path(sys.argv[1]))
noise = np.random.default_rng(0).integers(0, 255, 60_000, np.uint8).tobytes()
while True:
    stamp = time.time_ns()
    recorder.write(Frame("a", stamp, 0.0, encoded=noise))
    print(stamp, flush=True)
    time.sleep(0.01)
"""


@pytest.mark.parametrize("seconds", [1.1, 1.7])
def test_kill_loses_at_most_the_last_second(tmp_path, seconds):
    path = tmp_path / "r.mcap"
    process = subprocess.Popen(
        [sys.executable, "-c", WRITES_UNTIL_KILLED, str(path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    first = int(process.stdout.readline())
    time.sleep(seconds)
    os.kill(process.pid, signal.SIGKILL)
    stamps = [first, *(int(line) for line in process.stdout.read().split())]
    process.wait()
    kept = [stamp for _, stamp, _ in read_stream(path)]
    assert kept == stamps[: len(kept)]
    assert len(kept) > 0
    assert stamps[-1] - kept[-1] < 1_000_000_000


def test_recording_where_nothing_can_be_written(tmp_path):
    with pytest.raises(QuadrigError, match="cannot write"):
        LiveRecorder(tmp_path / "absent" / "r.mcap")


def test_a_recording_appears_with_its_first_picture_in_the_place_of_the_old_one(tmp_path, numbered):
    path, second = tmp_path / "r.mcap", tmp_path / "r-2.mcap"
    old = b"\x89MCAP0\r\n of yesterday"
    path.write_bytes(old)
    second.write_bytes(b"its second part")
    # Ended, or killed, before anything came: no empty recording is taken for one.
    LiveRecorder(path, replaces=[second]).close()
    assert (path.read_bytes(), second.read_bytes()) == (old, b"its second part")
    recorder = LiveRecorder(path, replaces=[second])
    recorder.write(Frame("a", 1, 0.0, encoded=numbered.jpeg(1)))
    recorder.close()
    assert [one.name for one in tmp_path.iterdir()] == ["r.mcap"]
    assert len(read_stream(path)) == 1
