"""Bags of ROS 1 and of ROS 2 in SQLite, by rosbags' own writers: read as what they showed."""

import sqlite3
import sys

import cv2
import numpy as np
import pytest

from quadrig.io.commands.main import run
from quadrig.io.recording.messages import ros_bag
from quadrig.io.recording.messages.mcap_reader import from_zstd as ros_bag_from_zstd
from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.single.errors import QuadrigError

pytest.importorskip("rosbags")

START, PERIOD, LATENCY, COUNT = 1_700_000_000_000_000_000, 33_333_333, 7_000_000, 6


def messages(types, pictures, ros1):
    """(topic, type, log time, message) of two cameras, one raw and one compressed, with a lens for the first."""
    header_type, time_type = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    for k in range(COUNT):
        stamp = time_type(*divmod(START + k * PERIOD, 10**9))
        header = header_type(k, stamp, "optical") if ros1 else header_type(stamp, "optical")
        size = (pictures.HEIGHT, pictures.WIDTH)
        raw = pictures.picture(k).reshape(-1)
        image = types["sensor_msgs/msg/Image"](header, *size, "bgr8", 0, 3 * pictures.WIDTH, raw)
        jpeg = cv2.imencode(".jpg", pictures.picture(11 - k))[1].reshape(-1)
        small = types["sensor_msgs/msg/CompressedImage"](header, "jpeg", jpeg)
        roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, do_rectify=False)
        lens = types["sensor_msgs/msg/CameraInfo"](
            header, *size, "plumb_bob", np.array([-0.3, 0.1, 0.001, -0.002, 0.05]),
            np.array([80.0, 0, 47, 0, 82.0, 31, 0, 0, 1]), np.eye(3).ravel(), np.zeros(12), 0, 0, roi,
        )  # fmt: skip
        # Two messages of one topic at one log time, as a bag that was written late has them.
        log = START + (k // 2 * 2) * PERIOD + LATENCY
        yield "/front/left/image_raw", "sensor_msgs/msg/Image", log, image
        yield "/right/image_raw/compressed", "sensor_msgs/msg/CompressedImage", log, small
        yield "/front/left/camera_info", "sensor_msgs/msg/CameraInfo", log, lens


def write_ros1(path, pictures, compression=None):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer(path)
    if compression:
        writer.set_compression(Writer.CompressionFormat[compression])
    with writer:
        topics = {}
        for topic, kind, log, message in messages(store.types, pictures, ros1=True):
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(topics[topic], log, store.serialize_ros1(message, kind))


def write_ros2(folder, pictures, compression=None):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = Writer(folder, version=8)
    if compression:
        writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with writer:
        topics = {}
        for topic, kind, log, message in messages(store.types, pictures, ros1=False):
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(topics[topic], log, store.serialize_cdr(message, kind))


def check(path, pictures):
    recording = open_recording(path)
    assert [camera.name for camera in recording.cameras] == ["front/left", "right"]
    left, right = recording.cameras
    assert left.stamps.tolist() == right.stamps.tolist() == [START + k * PERIOD for k in range(COUNT)]
    assert [pictures.number(image) for image in left.source.images() if image is not None] == list(range(COUNT))
    assert [pictures.number(image) for image in right.source.images() if image is not None] == [11, 10, 9, 8, 7, 6]
    assert np.array_equal(recording.frame("front/left", 3), pictures.picture(3))
    # Any of them, in any order, and in parts.
    assert [pictures.number(recording.frame("right", k)) for k in (5, 0, 3)] == [6, 11, 8]
    part = left.source.part(np.array([1, 2, 5]))
    assert [pictures.number(image) for image in part.images() if image is not None] == [1, 2, 5]
    assert left.prior is not None
    assert (left.prior.focal, *left.prior.principal_point) == (80.0, 47.0, 31.0)
    assert left.prior.distortion.tolist() == [-0.3, 0.1, 0.001, -0.002, 0.05]


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_ros1(tmp_path, pictures, compression):
    write_ros1(tmp_path / "room.bag", pictures, compression)
    check(tmp_path / "room.bag", pictures)
    check(tmp_path, pictures)


@pytest.mark.parametrize("compression", [None, "FILE", "MESSAGE"])
def test_ros2_in_sqlite(tmp_path, pictures, compression):
    write_ros2(tmp_path / "bag", pictures, compression)
    check(tmp_path / "bag", pictures)
    if compression is None:
        check(next((tmp_path / "bag").glob("*.db3")), pictures)


def test_a_bag_becomes_mcap(tmp_path, pictures, capsys):
    write_ros1(tmp_path / "room.bag", pictures)
    assert run(["record", str(tmp_path / "room.bag"), "--images", "png", "-o", str(tmp_path / "room.mcap")]) == 0
    assert run(["info", str(tmp_path / "room.mcap")]) == 0
    assert "front/left" in capsys.readouterr().out
    copy = open_recording(tmp_path / "room.mcap")
    assert np.array_equal(copy.frame("front/left", 2), pictures.picture(2))


@pytest.mark.parametrize("compression", ["BZ2", "LZ4"])
def test_chunks_of_ros1_unfold_no_further_than_allowed(tmp_path, pictures, monkeypatch, compression):
    """Cut short at the limit: what is in a chunk beyond it cannot be read."""
    path = tmp_path / "room.bag"
    write_ros1(path, pictures, compression)
    monkeypatch.setenv("RIG_LARGEST", "1")
    check(path, pictures)
    monkeypatch.setattr(ros_bag, "most_bytes", lambda: 1000)
    with pytest.raises(QuadrigError, match="no images in this recording"):
        open_recording(path)


def test_messages_of_ros2_unfold_no_further_than_allowed(tmp_path, pictures, monkeypatch):
    """A message of zeros that unfolds to a thousand times its size is left out alone."""
    import zstandard

    write_ros2(tmp_path / "bag", pictures, "MESSAGE")
    with sqlite3.connect(next((tmp_path / "bag").glob("*.db3"))) as bag:
        stamped = (
            zstandard.ZstdDecompressor()
            .decompressobj()
            .decompress(bag.execute("SELECT data FROM messages WHERE id = 1").fetchone()[0])
        )
        bomb = zstandard.ZstdCompressor().compress(stamped + bytes(20_000_000))
        bag.execute("UPDATE messages SET data = ? WHERE id = 1", (bomb,))
    monkeypatch.setenv("RIG_LARGEST", "1")
    asked = []
    monkeypatch.setattr(ros_bag, "from_zstd", lambda data, size: asked.append(size) or ros_bag_from_zstd(data, size))
    left = open_recording(tmp_path / "bag").cameras[0]
    assert len([image for image in left.source.images() if image is not None]) == COUNT - 1
    assert max(asked) == 3_000_001


def test_without_rosbags_the_extra_is_named(tmp_path, pictures, monkeypatch):
    write_ros1(tmp_path / "room.bag", pictures)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(QuadrigError, match=r"pip install 'quadrig\[bags\]'"):
        open_recording(tmp_path / "room.bag")


@pytest.mark.parametrize("keep", [0, 20, 5000, 0.5, 0.99])
@pytest.mark.parametrize("kind", ["bag", "db3"])
def test_bags_that_were_cut_off_are_one_sentence_or_what_is_whole(tmp_path, pictures, kind, keep):
    path = tmp_path / "room.bag"
    if kind == "bag":
        write_ros1(path, pictures)
    else:
        write_ros2(tmp_path / "bag", pictures)
        path = next((tmp_path / "bag").glob("*.db3"))
    data = path.read_bytes()
    path.write_bytes(data[: int(keep if isinstance(keep, int) else keep * len(data))])
    try:
        cameras = open_recording(path).cameras
    except QuadrigError as error:
        said = str(error)
    else:
        said = ""
        for camera in cameras:
            list(camera.source.images())
    assert said == "" or "cannot be read as a bag" in said or "no images" in said
