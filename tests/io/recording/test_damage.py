"""Damaged recordings and pictures: what is whole is used, one sentence says the rest, and nothing claims memory."""

import random
import struct
import subprocess
import sys
import tracemalloc
import zlib
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import cv2
import lz4.frame
import msgspec
import numpy as np
import pytest
import zstandard

from quadrig.io.commands.main import run
from quadrig.io.recording.decode_image import UndecodableImage, decode_file, decode_image
from quadrig.io.recording.framesets import build_framesets
from quadrig.io.recording.messages.image_message import EncodedImage
from quadrig.io.recording.messages.mcap_reader import MAGIC, index_mcap
from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.io.rig_file.record import encode_rig
from quadrig.io.topic_writer import TopicWriter
from quadrig.single.errors import QuadrigError

foxglove = pytest.importorskip("foxglove")


def attempt(call: Callable, *given, **options) -> tuple[Any, str]:
    """What a call gives, or the one line that it refuses with; any other error is a failure of the test."""
    try:
        return call(*given, **options), ""
    except (QuadrigError, UndecodableImage) as error:
        return None, str(error)


@pytest.fixture(scope="module")
def mutated(load_script):
    """mutated(data, draw): bytes changed at random."""
    return load_script("benchmarks/mutations.py").mutated_bytes


@pytest.fixture(scope="module")
def recordings(tmp_path_factory, load_script, pictures):
    writer = load_script("tests/io/recording/messages/test_mcap_reader.py")
    folder = tmp_path_factory.mktemp("whole")
    for k, options in enumerate(writer.WRITERS.values()):
        writer.write(folder / f"{k}.mcap", pictures, **options)
    return [path.read_bytes() for path in sorted(folder.iterdir())]


@pytest.mark.parametrize("seed", range(60))
def test_mutated_recordings_give_what_is_whole_or_one_sentence(tmp_path, recordings, mutated, seed):
    draw = random.Random(seed)
    path = tmp_path / "a.mcap"
    for data in recordings:
        path.write_bytes(mutated(data, draw))
        recording, said = attempt(open_recording, [path])
        assert "\n" not in said
        if recording is None:
            continue
        build_framesets(recording)
        for camera in recording.cameras:
            assert len(list(camera.source.images())) == camera.frames


def test_one_flipped_bit_costs_no_more_than_a_chunk_or_topic(tmp_path, recordings):
    """Of 24 pictures in chunks of 8000 bytes, wherever in the file the bit lies."""
    path = tmp_path / "a.mcap"
    draw = random.Random(1)
    for data in recordings:
        for _ in range(12):
            changed = bytearray(data)
            changed[draw.randrange(len(MAGIC), len(data))] ^= 1 << draw.randrange(8)
            path.write_bytes(bytes(changed))
            recording, said = attempt(open_recording, [path])
            if recording is None:
                # A length at the beginning of the file that claims all of it.
                assert "the file was cut off" in said or "damaged" in said or "beyond the limit" in said
                continue
            assert any(image is not None for camera in recording.cameras for image in camera.source.images())


def chunk_file(compression: str, stored: bytes, size: int) -> bytes:
    name = compression.encode()
    body = struct.pack("<QQQII", 0, 0, size, 0, len(name)) + name + struct.pack("<Q", len(stored)) + stored
    header = struct.pack("<BQII", 1, 8, 0, 0)
    return MAGIC + header + struct.pack("<BQ", 6, len(body)) + body


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("honest", [True, False])
def test_a_bomb_is_not_unfolded(tmp_path, compression, honest, monkeypatch):
    """A gigabyte of zeros in some kilobytes, with its size told truly, and with a lie."""
    monkeypatch.setenv("RIG_LARGEST", "16")
    zeros = bytes(1 << 24)
    if compression == "zstd":
        stored = zstandard.ZstdCompressor(level=9).compress(zeros) * 64
    else:
        stored = lz4.frame.compress(zeros * 16)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(chunk_file(compression, stored, 1 << 30 if honest else 1000))
    tracemalloc.start()
    note = index_mcap(path).note
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6
    assert ("RIG_LARGEST=358 raises it" in note) == honest
    with pytest.raises(QuadrigError, match="no images in this recording"):
        open_recording([path])


def png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    data = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(9))) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + data


@pytest.mark.parametrize("size", [(32000, 32000), (200000, 200000), (20000, 20000)])
def test_absurd_pictures_are_refused_by_their_claim(tmp_path, size, capsys, monkeypatch):
    path = tmp_path / "absurd.png"
    path.write_bytes(png(*size))
    assert run(["single", str(path), "--paper", "A4"]) == 1
    said = capsys.readouterr().err
    megapixels = size[0] * size[1] // 10**6
    assert f"{size[0]}x{size[1]} px is beyond the limit of 128 megapixels" in said
    assert f"RIG_LARGEST={megapixels} raises it" in said
    monkeypatch.setenv("RIG_LARGEST", "none")
    assert run(["single", str(path), "--paper", "A4"]) == 1
    assert "whole number" in capsys.readouterr().err


def test_a_large_picture_is_read_where_the_limit_is_raised(monkeypatch):
    data = cv2.imencode(".png", np.zeros((500, 2100), np.uint8))[1].tobytes()
    monkeypatch.setenv("RIG_LARGEST", "1")
    with pytest.raises(UndecodableImage, match="RIG_LARGEST=2 raises it"):
        decode_file(data)
    monkeypatch.setenv("RIG_LARGEST", "2")
    assert decode_file(data).shape == (500, 2100)


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".tiff", ".bmp", ".ppm", ".jp2"])
def test_mutated_pictures_are_pictures_or_undecodable(pictures, mutated, suffix):
    data = cv2.imencode(suffix, pictures.picture(3))[1].tobytes()
    assert pictures.number(decode_file(data)) == 3
    draw = random.Random(suffix)
    for _ in range(150):
        image, said = attempt(decode_file, mutated(data, draw), gray=draw.random() < 0.5)
        assert said if image is None else image.dtype == np.uint8


@pytest.mark.parametrize("claim", [{"height": 0}, {"step": 2**32 - 1}, {"width": 2**31, "height": 2**31}])
def test_raw_images_that_claim_what_they_have_not(claim):
    coded = {"width": 8, "height": 1, "step": 8} | claim
    tracemalloc.start()
    try:
        image = decode_image(EncodedImage("mono8", bytes(8), **coded))
        assert image.shape == (1, 8)
    except UndecodableImage:
        pass
    assert tracemalloc.get_traced_memory()[1] < 1e6
    tracemalloc.stop()


def json_bomb(path, topic: str, schema: str, message: bytes) -> None:
    """Empty lists and objects, 25 bytes of memory for each that is written, within the limit of a chunk."""
    with path.open("wb") as stream:
        writer = TopicWriter(stream, "zstd")
        writer.declare_json(topic, schema)
        writer.write_json(topic, message, 10**18)
        writer.finish()


def test_no_more_than_a_gigabyte_for_all_of_them(tmp_path, example_rig):
    """The resident size of a process of its own that meets every bomb at the limit as it is."""
    (tmp_path / "zstd.mcap").write_bytes(
        chunk_file("zstd", zstandard.ZstdCompressor().compress(bytes(1 << 24)) * 400, 6_553_600_000)
    )
    (tmp_path / "lz4.mcap").write_bytes(chunk_file("lz4", lz4.frame.compress(bytes(1 << 30)), 1 << 30))
    (tmp_path / "a.png").write_bytes(png(32000, 32000))
    lists = b"[" + b"[]," * 20_000_000 + b"0]"
    json_bomb(
        tmp_path / "rig.mcap",
        "/quadrig/rig",
        "quadrig.Rig",
        encode_rig(example_rig)[:-1] + b',"costs":' + lists + b"}",
    )
    json_bomb(tmp_path / "image.mcap", "/cam0/image", "foxglove.CompressedImage", b'{"data":"","D":' + lists + b"}")
    for name in ("rig.toml", "huge.png", "rig.json", "rig.yml", "rig.usdz", "times.csv"):
        with (tmp_path / name).open("wb") as stream:
            stream.write(b"\x89PNG\r\n\x1a\n" if name == "huge.png" else b"")
            stream.truncate(3 << 30)
    (tmp_path / "good.png").write_bytes(cv2.imencode(".png", np.zeros((8, 8), np.uint8))[1].tobytes())
    commands = [
        ["info", "zstd.mcap"], ["info", "lz4.mcap"], ["info", "rig.mcap"], ["info", "image.mcap"],
        ["info", "huge.png"],
        ["single", "a.png", "--paper", "A4"], ["single", "huge.png", "--paper", "A4"], ["import", "rig.mcap"],
        ["import", "rig.json"], ["import", "rig.yml"], ["import", "rig.usdz"], ["calibrate", "good.png"],
        ["record", "good.png", "-o", "out.mcap", "--timestamps", "times.csv"],
    ]  # fmt: skip
    script = (
        "import resource, sys\nfrom quadrig.io.commands.main import run\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        f"for words in {commands}:\n    assert run(words) == 1, words\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("\n") == done.stderr.count("rig: ") == len(commands), done.stderr
    assert int(done.stdout) < 1 << 20


def test_words_of_a_video_that_are_no_text_are_one_sentence(tmp_path):
    av = pytest.importorskip("av")
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), "bgr24")))
        container.mux(stream.encode(None))
    path.write_bytes(path.read_bytes().replace(b"ENCODER", b"\xffNCODER"))
    with pytest.raises(QuadrigError, match="cannot be read as a video"):
        open_recording([path])


@pytest.mark.parametrize("broken", [b"", b"\x0a\xff\xff\xff"])
def test_a_damaged_message_of_a_video_costs_no_more_than_its_picture(tmp_path, broken):
    av = pytest.importorskip("av")
    from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
    from mcap.writer import Writer
    from mcap_protobuf.schema import register_schema

    encoder: Any = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height, encoder.pix_fmt, encoder.time_base = 64, 48, "yuv420p", Fraction(1, 10)
    encoder.options = {"tune": "zerolatency", "g": "2"}
    blank = np.zeros((48, 64, 3), np.uint8)
    packets = [bytes(p) for k in range(8) for p in encoder.encode(av.VideoFrame.from_ndarray(blank + 9 * k, "bgr24"))]
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/cam0/image", "protobuf", register_schema(writer, CompressedVideo))
        for k, packet in enumerate(packets):
            whole = CompressedVideo(format="h264", data=packet).SerializeToString()
            writer.add_message(channel, k * 10**9, broken if k == 4 else whole, k * 10**9)
        writer.finish()
    (camera,) = open_recording([tmp_path / "a.mcap"]).cameras
    images = list(camera.source.images())
    assert len(images) == 8
    assert sum(image is None for image in images) <= 2


def test_an_absurd_picture_among_good_ones_is_counted_and_left_out(tmp_path, pictures, capsys):
    folder = tmp_path / "cam0"
    folder.mkdir()
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = TopicWriter(stream)
        writer.declare_json("/cam1/image", "foxglove.CompressedImage")
        for k in range(5):
            data = png(200_000, 200_000) if k == 2 else cv2.imencode(".png", pictures.picture(k))[1].tobytes()
            (folder / f"{k}.png").write_bytes(data)
            stamp = {"sec": k + 1, "nsec": 0}
            message = msgspec.json.encode({"timestamp": stamp, "format": "png", "data": data})
            writer.write_json("/cam1/image", message, (k + 1) * 10**9)
        writer.finish()
    assert run(["info", str(folder)]) == 0
    assert "1 picture of another size is left out (2.png is 200000x200000, not 96x64)" in capsys.readouterr().out
    (camera,) = open_recording([tmp_path / "a.mcap"]).cameras
    shown = [None if image is None else pictures.number(image) for image in camera.source.images()]
    assert shown == [0, 1, None, 3, 4]
    assert "RIG_LARGEST=" in camera.source.why_unreadable(2)
    assert camera.source.why_unreadable(3) == ""


def test_what_parsers_stumble_over_is_not_said() -> None:
    whole = cv2.imencode(".jpg", np.zeros((64, 64), np.uint8))[1].tobytes()
    said = {attempt(decode_file, whole[:length])[1] for length in range(len(whole))} - {""}
    assert said
    assert not [one for one in said if "unpack" in one or "buffer" in one]


def test_a_video_is_refused_by_the_size_that_it_claims(tmp_path):
    av = pytest.importorskip("av")
    path = tmp_path / "a.avi"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mjpeg", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj420p"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), "bgr24")))
        container.mux(stream.encode(None))
    data = bytearray(path.read_bytes())
    # FFmpeg believes the picture's own header.
    place = data.index(b"\xff\xc0") + 5
    data[place : place + 4] = struct.pack(">HH", 20_000, 20_000)
    path.write_bytes(data)
    with pytest.raises(QuadrigError, match=r"is beyond the limit|none of its first images can be read"):
        open_recording([path])


def test_what_is_mutated_is_the_same_for_the_same_seed(load_script):
    """Or a case that found something could not be made again."""
    mutations = load_script("benchmarks/mutations.py")
    data = msgspec.json.encode({"a": [1, [2.5, "x"], {"b": None}], "c": {"d": [[0.0] * 3] * 3}})
    for mutate in (mutations.mutated_bytes, mutations.mutated_text, mutations.mutated_json):
        once = [mutate(data, random.Random(seed)) for seed in range(300)]
        assert once == [mutate(data, random.Random(seed)) for seed in range(300)]
