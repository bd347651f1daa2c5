"""MCAP files as writers leave them: chunked or not, compressed or not, indexed or not, whole or cut off."""

import re
import struct
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from mcap.opcode import Opcode

from quadrig.io.recording.messages.mcap_reader import MAGIC, McapBytes, index_mcap
from quadrig.io.recording.recorded_cameras import open_recording

foxglove = pytest.importorskip("foxglove")

# Behind the kind and length of the record and the times of its first and last message.
SIZE_IN_CHUNK = 9 + 16
START = 1_700_000_000_000_000_000
COUNT = 12

WRITERS = {
    "zstd": {"compression": "Zstd"},
    "lz4": {"compression": "Lz4"},
    "no compression": {"compression": None},
    "no chunks": {"use_chunks": False},
    "no chunk index": {"compression": "Lz4", "emit_chunk_indexes": False},
    "no message index": {"compression": "Zstd", "emit_message_indexes": False},
    "nothing repeated": {"compression": None, "repeat_channels": False, "repeat_schemas": False},
    "no statistics": {"compression": "Lz4", "emit_statistics": False},
    "a bare stream": {
        "compression": "Zstd",
        **dict.fromkeys(("emit_chunk_indexes", "emit_message_indexes", "emit_statistics"), False),
        **dict.fromkeys(("emit_summary_offsets", "repeat_channels", "repeat_schemas"), False),
    },
}


def write(path, pictures, compression=None, chunk_size=8000, **given):
    """Two cameras, twelve pictures each, in several chunks; the second camera's number is 11 - k."""
    from foxglove.channels import CompressedImageChannel
    from foxglove.mcap import MCAPCompression, MCAPWriteOptions
    from foxglove.messages import CompressedImage, Timestamp

    how = MCAPWriteOptions(
        compression=getattr(MCAPCompression, compression) if compression else None, chunk_size=chunk_size, **given
    )
    context = foxglove.Context()
    with foxglove.open_mcap(path, context=context, writer_options=how):
        channels = [CompressedImageChannel(f"/cam{k}/image", context=context) for k in range(2)]
        for k in range(COUNT):
            stamp = START + k * 10**8
            for channel, number in zip(channels, (k, 11 - k), strict=True):
                data = cv2.imencode(".jpg", pictures.picture(number))[1].tobytes()
                time = Timestamp(*divmod(stamp, 10**9))
                channel.log(CompressedImage(timestamp=time, data=data, format="jpeg"), log_time=stamp)


def numbers(recording, pictures):
    """What each camera's images show."""
    return {
        camera.name: [pictures.number(image) for image in camera.source.images() if image is not None]
        for camera in recording.cameras
    }


@pytest.mark.parametrize("name", WRITERS)
def test_every_way_of_writing(tmp_path, pictures, name):
    path = tmp_path / "a.mcap"
    write(path, pictures, **WRITERS[name])
    recording = open_recording([path])
    assert numbers(recording, pictures) == {"cam0": list(range(12)), "cam1": list(range(11, -1, -1))}
    assert recording.notes == ()
    assert recording.camera("cam1").stamps.tolist() == [START + k * 10**8 for k in range(COUNT)]
    assert recording.indexed == (name in ("zstd", "lz4", "no compression"))


@pytest.mark.parametrize("name", WRITERS)
def test_cut_off_anywhere(tmp_path, pictures, name):
    """Whatever is left of the file, what is whole is read, in order, and something is said."""
    whole = tmp_path / "a.mcap"
    write(whole, pictures, **WRITERS[name])
    data = whole.read_bytes()
    cut = tmp_path / "cut.mcap"
    counts = []
    for length in range(len(MAGIC), len(data), len(data) // 29):
        cut.write_bytes(data[:length])
        index = index_mcap(cut)
        file = McapBytes(cut)
        payloads = {topic.topic: [file.message(c, o) for c, o in zip(topic.chunks, topic.offsets, strict=True)]
                    for topic in index.topics}  # fmt: skip
        file.close()
        counts.append(sum(len(messages) for messages in payloads.values()))
        assert re.search(r"cut off at byte \d+", index.note) or counts[-1] == 2 * COUNT
        if counts[-1] < 2:
            continue
        seen = numbers(open_recording([cut]), pictures)
        for camera, expected in {"cam0": list(range(12)), "cam1": list(range(11, -1, -1))}.items():
            assert seen[camera] == expected[: len(seen[camera])]
        assert sum(len(found) for found in seen.values()) == counts[-1]
    assert counts == sorted(counts)
    assert counts[-1] == 2 * COUNT
    # Where nothing is compressed, nothing but the message that was being written is lost.
    if name in ("no compression", "no chunks"):
        lengths = range(len(MAGIC), len(data), len(data) // 29)
        assert all(
            count >= 2 * COUNT * length // len(data) - 4 for count, length in zip(counts, lengths, strict=True)
        )


def test_damaged_chunk_is_left_out_and_said(tmp_path, pictures):
    path = tmp_path / "a.mcap"
    write(path, pictures, "Zstd", emit_message_indexes=False, emit_chunk_indexes=False)
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 2000] = bytes(2000)
    path.write_bytes(data)
    recording = open_recording([path])
    assert recording.notes
    seen = numbers(recording, pictures)
    assert 6 <= len(seen["cam0"]) < COUNT
    assert seen["cam0"] == sorted(seen["cam0"])


@pytest.mark.parametrize("claimed", [0, 100, -500, 1 << 20, 1 << 62], ids=lambda size: f"{size} bytes")
@pytest.mark.parametrize("name", [name for name in WRITERS if name != "no chunks"])
def test_a_chunk_that_lies_about_its_size_is_named_and_the_others_are_used(tmp_path, pictures, name, claimed):
    path = tmp_path / "a.mcap"
    write(path, pictures, **WRITERS[name])
    chunk = chunks_of(path)[1]
    data = bytearray(path.read_bytes())
    (true,) = struct.unpack_from("<Q", data, chunk + SIZE_IN_CHUNK)
    struct.pack_into("<Q", data, chunk + SIZE_IN_CHUNK, claimed if claimed >= 0 else true + claimed)
    path.write_bytes(data)
    recording = open_recording([path])
    seen = numbers(recording, pictures)
    assert all(len(shown) >= COUNT - 5 for shown in seen.values())
    named = any(f"byte {chunk} " in note for note in recording.notes)
    # Without a list of the chunks nobody knows beforehand that the last of its messages breaks off.
    assert named or all(len(shown) == COUNT for shown in seen.values()) or (name, claimed) == ("no chunk index", -500)


def chunks_of(path):
    """Where the chunks of a whole file begin."""
    data, place, found = path.read_bytes(), len(MAGIC), []
    while place < len(data) - len(MAGIC):
        kind, length = struct.unpack_from("<BQ", data, place)
        found += [place] if kind == Opcode.CHUNK else []
        place += 9 + length
    return found


def test_parts_of_one_recording_follow_each_other(tmp_path, pictures):
    write(tmp_path / "b.mcap", pictures, "Lz4")
    folder = tmp_path / "bag"
    folder.mkdir()
    whole = open_recording([tmp_path / "b.mcap"])
    # The same file twice is a recording of twice the images: each instant twice.
    for name in ("bag_0.mcap", "bag_1.mcap"):
        (folder / name).write_bytes((tmp_path / "b.mcap").read_bytes())
    split = open_recording([folder])
    assert [camera.frames for camera in split.cameras] == [2 * camera.frames for camera in whole.cameras]
    stamps = split.camera("cam0").stamps
    assert stamps.tolist() == sorted(stamps.tolist())
    part = split.camera("cam0").source.part(np.array([3, 8, 9]))
    assert [pictures.number(image) for image in part.images() if image is not None] == [1, 4, 4]


def test_a_file_that_was_replaced_is_read_anew(tmp_path, pictures):
    path = tmp_path / "a.mcap"
    for given in (pictures.picture, lambda number: pictures.picture((number + 5) % 12)):
        path.unlink(missing_ok=True)
        write(path, SimpleNamespace(picture=given))
        shown = numbers(open_recording([path]), pictures)["cam0"]
        assert shown == [pictures.number(given(k)) for k in range(COUNT)]
