"""Whatever comes, every reader gives what it read or one sentence."""

import string
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from quadrig.io.config.corners_toml import read_corners
from quadrig.io.config.rig_toml import RigConfig, config_text, parse_config
from quadrig.io.formats.any_file import read_any_lenses
from quadrig.io.recording.decode_image import UndecodableImage, decode_file, decode_image
from quadrig.io.recording.messages.image_message import EncodedImage, read_image, read_lens, read_stamp
from quadrig.io.recording.messages.mcap_reader import MAGIC, McapBytes, index_mcap
from quadrig.io.recording.time_table import with_timestamps
from quadrig.io.rig_file.record import decode_fit, decode_rig
from quadrig.io.safe_json import read_json
from quadrig.single.errors import QuadrigError
from quadrig.single.rectangle import Rectangle

# The same examples each time, so that a test that passed passes again; python -m benchmarks fuzz draws others.
usual = settings(
    max_examples=60, deadline=None, derandomize=True, database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)  # fmt: skip

json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=12,
)
toml_words = st.sampled_from(
    ["[[rectangle]]", "[[camera]]", "[[body]]", "[[corners]]", 'name = "a"', "width = 0.1", "height = nan", "\n", "=",
     "marking = { kind = 'points' }", "marking = { kind = 'tag', dictionary = 'aruco_4x4_50', id = 1 }", "moving = 1",
     "target = 'x.yaml'", "world_from_rect = { translation = [0, 0, 0], angles_deg = [0, 0, inf] }", "focal = -0.0",
     'reference = "a"', "size = 'A4'", "[", "]", "{", '"', "'''", "\\u0000", "1e999", "0x", "1979-05-27", "#", "é"]
)  # fmt: skip
texts = st.lists(toml_words | st.text(string.printable, max_size=6), max_size=14).map("\n".join)


def one_sentence(error: Exception) -> None:
    assert str(error)
    assert "\n" not in str(error)


@usual
@given(texts)
def test_rig_toml(text):
    try:
        assert isinstance(parse_config(text), RigConfig)
    except QuadrigError as error:
        one_sentence(error)


@usual
@given(texts)
def test_corners_toml(tmp_path, text):
    (tmp_path / "corners.toml").write_text(text, encoding="utf-8")
    try:
        read_corners(tmp_path / "corners.toml", [Rectangle("a", 1.0, 1.0)])
    except QuadrigError as error:
        one_sentence(error)


@usual
@given(st.text(st.characters(exclude_categories=("C",)), min_size=1, max_size=40), st.floats(1e-3, 1e3))
def test_every_name_and_length_comes_back_from_rig_toml(name, length):
    config = RigConfig((Rectangle(name, length, length),))
    (again,) = parse_config(config_text(config)).rectangles
    assert (again.name, again.width) == (name, length)


@usual
@given(st.sampled_from(["cdr", "protobuf", "json"]), st.binary(max_size=200) | json_values.map(msgspec.json.encode))
def test_messages(encoding, data):
    schemas = {"cdr": "sensor_msgs/msg/Image", "protobuf": "foxglove.RawImage", "json": "foxglove.CompressedImage"}
    lenses = {"cdr": "sensor_msgs/msg/CameraInfo", "protobuf": "foxglove.CameraCalibration"}
    for read in (
        lambda: read_stamp(encoding, data),
        lambda: decode_image(read_image(encoding, schemas[encoding], data)),
        lambda: read_lens(encoding, lenses.get(encoding, "foxglove.CameraCalibration"), data),
    ):
        try:
            read()
        except ValueError as error:
            one_sentence(error)


@usual
@given(
    st.sampled_from(["mono8", "bgr8", "rgb16", "bayer_rggb8", "yuyv", "nv12", "i420", "32fc1", "?"]),
    st.binary(max_size=64),
    *[st.integers(0, 9) | st.sampled_from([2**31, 2**32 - 1])] * 3,
)  # fmt: skip
def test_raw_images(encoding, data, width, height, step):
    try:
        assert decode_image(EncodedImage(encoding, data, width, height, step)).dtype == np.uint8
    except UndecodableImage as error:
        one_sentence(error)


@usual
@given(st.sampled_from([b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n", b"II*\0", b"BM", b"P5 3 3 255\n", b""]), st.binary())
def test_pictures(begin, data):
    with pytest.raises(UndecodableImage) if begin != b"P5 3 3 255\n" or len(data) < 9 else np.errstate():
        decode_file(begin + data)


records = st.tuples(st.integers(0, 15), st.binary(max_size=60), st.integers(-2, 2))


@usual
@given(st.lists(records, max_size=6))
def test_mcap_records(tmp_path, parts):
    body = b"".join(bytes([op]) + max(0, len(data) + off).to_bytes(8, "little") + data for op, data, off in parts)
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + body)
    index = index_mcap(path)
    file = McapBytes(path)
    for topic in index.topics:
        for chunk, offset in zip(topic.chunks.tolist(), topic.offsets.tolist(), strict=True):
            try:
                file.message(chunk, offset)
            except ValueError as error:
                one_sentence(error)
    file.close()
    one_sentence(ValueError(index.note or "whole"))


@usual
@given(json_values)
def test_records(value):
    data = msgspec.json.encode(value)
    for read in (decode_rig, decode_fit, read_json):
        with suppress(ValueError, QuadrigError):
            read(data)


@pytest.mark.parametrize("data", [b"[" * 5000 + b"]" * 5000, b'{"a":' * 5000 + b"1" + b"}" * 5000])
def test_json_that_is_nested_too_deep_is_a_value_error(data):
    with pytest.raises(ValueError, match="nested too deep"):
        read_json(data)


@usual
@given(
    st.sampled_from(["%YAML:1.0\n---\n", "cam0:\n  camera_model: pinhole\n", "image_width: 3\ndistortion_model: x\n",
                     '{"rig_frame":0,"cameras":', '{"frames":[{"transform_matrix":', "<robot>", "<opencv_storage>",
                     "[cam_0]\nmatrix=1\ndistortions=", "{'lensmodel': 'LENSMODEL_OPENCV4', 'intrinsics': "]),
    st.text(max_size=20) | json_values.map(lambda value: msgspec.json.encode(value).decode()),
)  # fmt: skip
def test_files_of_other_programs(tmp_path, begin, rest):
    for suffix in (".yaml", ".json", ".xml", ".toml", ".cameramodel"):
        path = Path(tmp_path / f"a{suffix}")
        path.write_text(begin + rest, encoding="utf-8", errors="replace")
        with pytest.raises(QuadrigError) as caught:
            read_any_lenses(path)
        one_sentence(caught.value)


@usual
@given(st.text(',;\t\n"0123456789.e-+cameraframetime ', max_size=60))
def test_tables_of_times(tmp_path, text):
    path = tmp_path / "times.csv"
    path.write_text("camera,frame,time\n" + text, encoding="utf-8")
    try:
        with_timestamps([], path, [])
    except QuadrigError as error:
        one_sentence(error)
