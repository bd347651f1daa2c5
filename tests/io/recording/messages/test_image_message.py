"""Every message that robots and labs record, written by somebody else's writer, is read as what it showed."""

import base64
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from quadrig.io.recording.camera import camera_name
from quadrig.io.recording.messages.image_message import read_image
from quadrig.io.recording.recorded_cameras import open_recording
from quadrig.single.errors import QuadrigError

foxglove = pytest.importorskip("foxglove")
pytest.importorskip("rosbags")

START = 1_700_000_000_000_000_000
PERIOD = 33_333_333
# A message is logged after its image was taken; the image's own stamp is what counts.
LATENCY = 7_000_000

MOSAICS = {"bayer_rggb": "RG/GB", "bayer_bggr": "BG/GR", "bayer_gbrg": "GB/RG", "bayer_grbg": "GR/BG"}


def mosaic(image, pattern):
    """What a sensor behind this colour filter gives of a BGR image."""
    result = np.empty(image.shape[:2], np.uint8)
    for row, colours in enumerate(pattern.split("/")):
        for column, colour in enumerate(colours):
            result[row::2, column::2] = image[row::2, column::2, "BGR".index(colour)]
    return result


def yuv422(image, order):
    """Two bytes a pixel, by BT.601 with video range, as cameras send it."""
    b, g, r = (image[..., k].astype(float) for k in range(3))
    y = 16 + 0.257 * r + 0.504 * g + 0.098 * b
    u = 128 - 0.148 * r - 0.291 * g + 0.439 * b
    v = 128 + 0.439 * r - 0.368 * g - 0.071 * b
    chroma = np.empty_like(y)
    chroma[:, 0::2], chroma[:, 1::2] = (u[:, 0::2] + u[:, 1::2]) / 2, (v[:, 0::2] + v[:, 1::2]) / 2
    planes = [chroma, y] if order == "uyvy" else [y, chroma]
    return np.round(np.stack(planes, axis=-1)).astype(np.uint8)


def raw(image, encoding, padding=0):
    """Bytes and step of an image in an encoding, with padding at the end of each row."""
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    alpha = np.full(gray.shape, 255, np.uint8)
    arrays = {
        "mono8": gray,
        "8UC1": gray,
        "mono16": gray.astype("<u2") << 4,
        "bgr8": image,
        "8UC3": image,
        "rgb8": image[..., ::-1],
        "bgra8": np.dstack([image, alpha]),
        "rgba8": np.dstack([image[..., ::-1], alpha]),
        "yuv422": yuv422(image, "uyvy"),
        "uyvy": yuv422(image, "uyvy"),
        "yuv422_yuy2": yuv422(image, "yuyv"),
        "yuyv": yuv422(image, "yuyv"),
        **{f"{name}8": mosaic(image, pattern) for name, pattern in MOSAICS.items()},
        **{f"{name}16": mosaic(image, pattern).astype("<u2") << 8 for name, pattern in MOSAICS.items()},
    }
    rows = np.ascontiguousarray(arrays[encoding]).view(np.uint8).reshape(image.shape[0], -1)
    padded = np.pad(rows, ((0, 0), (0, padding)))
    return padded.tobytes(), padded.shape[1]


ENCODINGS = [
    *("mono8", "8UC1", "mono16", "bgr8", "8UC3", "rgb8", "bgra8", "rgba8", "yuv422", "yuv422_yuy2", "uyvy", "yuyv"),
    *(f"{name}{bits}" for name in MOSAICS for bits in (8, 16)),
]


def check(path, pictures, camera="cam0", count=5, colour=6.0, coded="") -> None:
    """The recording has one camera with pictures 0 to count-1, at their own stamps."""
    recording = open_recording([path])
    assert [one.name for one in recording.cameras] == [camera]
    found = recording.camera(camera)
    assert (found.width, found.height, found.frames) == (pictures.WIDTH, pictures.HEIGHT, count)
    assert found.stamps.tolist() == [START + k * PERIOD for k in range(count)]
    if coded:
        assert found.encoding == coded
    for k in range(count):
        bgr, gray = recording.frame(camera, k), recording.frame(camera, k, gray=True)
        assert bgr.dtype == gray.dtype == np.uint8
        assert bgr.shape == (*gray.shape, 3) == (pictures.HEIGHT, pictures.WIDTH, 3)
        assert pictures.number(bgr) == pictures.number(gray) == k
        if colour:
            assert pictures.colour_error(bgr) < colour


def write_ros2(path, messages, schema="sensor_msgs/msg/Image", topic="/cam0/image_raw"):
    """Messages by mcap-ros2-support, with the definition that ROS itself puts into a bag."""
    from mcap_ros2.writer import Writer
    from rosbags.typesys import Stores, get_typestore

    text, _ = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(schema, ros_version=2)
    with path.open("wb") as stream, Writer(stream) as writer:
        registered = writer.register_msgdef(schema, text)
        for k, message in enumerate(messages):
            seconds, nanoseconds = divmod(START + k * PERIOD, 10**9)
            stamp = {"sec": seconds, "nanosec": nanoseconds}
            message = {"header": {"stamp": stamp, "frame_id": "optical"}, **message}
            writer.write_message(topic, registered, message, START + k * PERIOD + LATENCY)


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_ros2_image_in_every_encoding(tmp_path, pictures, encoding, padding):
    def message(k):
        data, step = raw(pictures.picture(k), encoding, padding)
        size = {"height": pictures.HEIGHT, "width": pictures.WIDTH}
        return {**size, "encoding": encoding, "is_bigendian": 0, "step": step, "data": data}

    path = tmp_path / "bag.mcap"
    write_ros2(path, [message(k) for k in range(5)])
    check(path, pictures, colour=0.0 if encoding in ("mono8", "8UC1", "mono16") else 6.0, coded=encoding.lower())


@pytest.mark.parametrize("form", ["jpeg", "png", "bgr8; jpeg compressed bgr8"])
def test_ros2_compressed_image(tmp_path, pictures, form):
    suffix = ".png" if form == "png" else ".jpg"

    def message(k):
        return {"format": form, "data": cv2.imencode(suffix, pictures.picture(k))[1].tobytes()}

    path = tmp_path / "bag.mcap"
    messages = [message(k) for k in range(5)]
    write_ros2(path, messages, "sensor_msgs/msg/CompressedImage", "/cam0/image_raw/compressed")
    check(path, pictures)


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_grbg8", "mono16", "yuv422"])
def test_rosbags_writer(tmp_path, pictures, encoding):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        image = writer.add_connection("/front/left/image_raw", "sensor_msgs/msg/Image", typestore=store)
        lens = writer.add_connection("/front/left/camera_info", "sensor_msgs/msg/CameraInfo", typestore=store)
        for k in range(5):
            stamp = types["builtin_interfaces/msg/Time"](*divmod(START + k * PERIOD, 10**9))
            header = types["std_msgs/msg/Header"](stamp, "left")
            data, step = raw(pictures.picture(k), encoding, 8)
            size = (pictures.HEIGHT, pictures.WIDTH)
            taken = types["sensor_msgs/msg/Image"](header, *size, encoding, 0, step, np.frombuffer(data, np.uint8))
            writer.write(image, START + k * PERIOD + LATENCY, store.serialize_cdr(taken, image.msgtype))
            info = types["sensor_msgs/msg/CameraInfo"](
                header, *size, "plumb_bob", np.array([-0.3, 0.1, 0.001, -0.002, 0.05]),
                np.array([80.0, 0, 47, 0, 82.0, 31, 0, 0, 1]), np.eye(3).ravel(), np.zeros(12), 0, 0,
                types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, do_rectify=False),
            )  # fmt: skip
            writer.write(lens, START + k * PERIOD + LATENCY, store.serialize_cdr(info, lens.msgtype))
    check(tmp_path / "bag", pictures, camera="front/left", colour=0.0 if encoding == "mono16" else 6.0)
    prior = open_recording([tmp_path / "bag"]).camera("front/left").prior
    assert prior is not None
    assert (prior.focal, prior.aspect, *prior.principal_point) == (80.0, 82.0 / 80.0, 47.0, 31.0)
    assert prior.distortion.tolist() == [-0.3, 0.1, 0.001, -0.002, 0.05]


def stamp_of(k):
    from foxglove.messages import Timestamp

    return Timestamp(*divmod(START + k * PERIOD, 10**9))


def options(**given):
    from foxglove.mcap import MCAPWriteOptions

    return MCAPWriteOptions(**given)


@pytest.mark.parametrize("suffix", ["jpeg", "png", "webp"])
def test_foxglove_compressed_image(tmp_path, pictures, suffix):
    from foxglove.channels import CompressedImageChannel
    from foxglove.messages import CompressedImage

    context = foxglove.Context()
    with foxglove.open_mcap(tmp_path / "a.mcap", context=context):
        channel = CompressedImageChannel("/cam0/image", context=context)
        for k in range(5):
            data = cv2.imencode(f".{suffix}", pictures.picture(k))[1].tobytes()
            channel.log(CompressedImage(timestamp=stamp_of(k), data=data, format=suffix), log_time=START + k)
    check(tmp_path / "a.mcap", pictures, coded=suffix)


@pytest.mark.parametrize("encoding", ["rgb8", "bgra8", "yuv422", "yuv422_yuy2", "bayer_rggb8", "mono8"])
def test_foxglove_raw_image_and_calibration(tmp_path, pictures, encoding):
    from foxglove.channels import CameraCalibrationChannel, RawImageChannel
    from foxglove.messages import CameraCalibration, RawImage

    context = foxglove.Context()
    size = {"width": pictures.WIDTH, "height": pictures.HEIGHT}
    with foxglove.open_mcap(tmp_path / "a.mcap", context=context):
        images = RawImageChannel("/cam0/image_raw", context=context)
        lenses = CameraCalibrationChannel("/cam0/camera_info", context=context)
        matrix = [90.0, 0.0, 40.0, 0.0, 90.0, 30.0, 0.0, 0.0, 1.0]
        fisheye = CameraCalibration(**size, distortion_model="kannala_brandt", D=[0.1, 0.2, 0.3, 0.4], K=matrix)
        lenses.log(fisheye, log_time=START)
        for k in range(5):
            data, step = raw(pictures.picture(k), encoding, 4)
            image = RawImage(timestamp=stamp_of(k), **size, encoding=encoding, step=step, data=data)
            images.log(image, log_time=START + k)
    check(tmp_path / "a.mcap", pictures, colour=0.0 if encoding == "mono8" else 6.0)
    prior = open_recording([tmp_path / "a.mcap"]).cameras[0].prior
    assert prior is not None
    assert prior.model == "fisheye"
    assert prior.distortion.tolist() == [0.1, 0.2, 0.3, 0.4, 0.0]


@pytest.mark.parametrize("dated", [False, True])
def test_foxglove_json(tmp_path, pictures, dated):
    """dated: protobuf's own JSON has the stamp as a date, and it does not come first."""
    context = foxglove.Context()
    schema = {"type": "object", "title": "foxglove.CompressedImage"}
    lens = {"type": "object", "title": "foxglove.CameraCalibration"}
    with foxglove.open_mcap(tmp_path / "a.mcap", context=context):
        named = foxglove.Schema(
            name="foxglove.CompressedImage", encoding="jsonschema", data=json.dumps(schema).encode()
        )
        channel = foxglove.Channel("/cam0/image", schema=named, message_encoding="json", context=context)
        named = foxglove.Schema(
            name="foxglove.CameraCalibration", encoding="jsonschema", data=json.dumps(lens).encode()
        )
        lenses = foxglove.Channel("/cam0/camera_info", schema=named, message_encoding="json", context=context)
        size = {"width": pictures.WIDTH, "height": pictures.HEIGHT}
        lenses.log({**size, "distortion_model": "plumb_bob", "D": [], "K": [70, 0, 48, 0, 70, 32, 0, 0, 1]})
        for k in range(5):
            data = base64.b64encode(cv2.imencode(".png", pictures.picture(k))[1].tobytes()).decode()
            seconds, nanoseconds = divmod(START + k * PERIOD, 10**9)
            if dated:
                written = np.datetime64(START + k * PERIOD, "ns").astype(str) + "Z"
                message = {"data": data, "format": "png", "timestamp": written}
            else:
                message = {"timestamp": {"sec": seconds, "nsec": nanoseconds}, "data": data, "format": "png"}
            channel.log(message, log_time=START + k)
    check(tmp_path / "a.mcap", pictures, coded="png")
    prior = open_recording([tmp_path / "a.mcap"]).cameras[0].prior
    assert prior is not None
    assert prior.focal == 70


@pytest.mark.parametrize(("codec", "form"), [("libx264", "h264"), ("libx265", "h265")])
def test_foxglove_compressed_video(tmp_path, pictures, codec, form):
    av = pytest.importorskip("av")
    from foxglove.channels import CompressedVideoChannel
    from foxglove.messages import CompressedVideo

    encoder = av.CodecContext.create(codec, "w")
    encoder.width, encoder.height, encoder.pix_fmt, encoder.gop_size = pictures.WIDTH, pictures.HEIGHT, "yuv420p", 4
    encoder.time_base = encoder.framerate = 30
    encoder.time_base = 1 / encoder.framerate
    encoder.max_b_frames = 0
    encoder.options = {"x265-params": "log-level=none:bframes=0:annexb=1:repeat-headers=1:keyint=4"}
    frames = [av.VideoFrame.from_ndarray(pictures.picture(k), format="bgr24") for k in range(10)]
    for k, frame in enumerate(frames):
        frame.pts = k
    packets = [packet for frame in [*frames, None] for packet in encoder.encode(frame)]
    headers = b"" if form == "h265" else bytes(encoder.extradata or b"")
    context = foxglove.Context()
    with foxglove.open_mcap(tmp_path / "a.mcap", context=context):
        channel = CompressedVideoChannel("/cam0/video", context=context)
        for k, packet in enumerate(packets):
            data = bytes(packet)
            data = headers + data if packet.is_keyframe else data
            channel.log(CompressedVideo(timestamp=stamp_of(k), data=data, format=form), log_time=START + k)
    # Any one image is found from the key frame before it; chroma at half size mixes the colours a little.
    check(tmp_path / "a.mcap", pictures, camera="cam0/video", count=10, colour=12.0, coded=form)
    source = open_recording([tmp_path / "a.mcap"]).cameras[0].source
    some = source.part(np.array([2, 3, 7]))
    assert [pictures.number(image) for image in some.images() if image is not None] == [2, 3, 7]
    assert some.stamps().tolist() == [START + k * PERIOD for k in (2, 3, 7)]


def test_stamp_unset_means_time_of_recording(tmp_path, pictures):
    from foxglove.channels import CompressedImageChannel
    from foxglove.messages import CompressedImage

    context = foxglove.Context()
    with foxglove.open_mcap(tmp_path / "a.mcap", context=context):
        channel = CompressedImageChannel("/cam0/image", context=context)
        for k in range(5):
            data = cv2.imencode(".png", pictures.picture(k))[1].tobytes()
            channel.log(CompressedImage(data=data, format="png"), log_time=START + k * PERIOD)
    check(tmp_path / "a.mcap", pictures)


def test_names_that_are_no_utf8_cost_no_picture(tmp_path, pictures):
    from mcap.reader import make_reader

    schema, data = "sensor_msgs/msg/CompressedImage", cv2.imencode(".png", pictures.picture(3))[1].tobytes()
    write_ros2(tmp_path / "bag.mcap", [{"format": "png", "data": data}], schema)
    with (tmp_path / "bag.mcap").open("rb") as stream:
        (message,) = (message.data for _, _, message in make_reader(stream).iter_messages())
    assert b"optical" in message
    image = read_image("cdr", schema, message.replace(b"optical", b"\xff\xfe\0ical"))
    assert (image.encoding, image.data) == ("png", data)


def test_depth_is_no_camera_and_a_broken_image_is_left_out(tmp_path, pictures):
    size = {"height": pictures.HEIGHT, "width": pictures.WIDTH}
    depth = {**size, "encoding": "16UC1", "is_bigendian": 0, "step": 2 * size["width"]}
    depth["data"] = bytes(2 * size["width"] * size["height"])
    write_ros2(tmp_path / "depth.mcap", [depth], topic="/depth/image_raw")
    with pytest.raises(QuadrigError, match=r"depth.*16uc1"):
        open_recording([tmp_path / "depth.mcap"])

    good = [{"format": "jpeg", "data": cv2.imencode(".jpg", pictures.picture(k))[1].tobytes()} for k in range(3)]
    good[1] = {"format": "jpeg", "data": b"\xff\xd8 and then the cable fell out"}
    write_ros2(tmp_path / "a.mcap", good, "sensor_msgs/msg/CompressedImage")
    recording = open_recording([tmp_path / "a.mcap"])
    images = list(recording.camera("cam0").source.images())
    assert images[1] is None
    assert [pictures.number(image) for image in images if image is not None] == [0, 2]
    with pytest.raises(QuadrigError, match="image 1 of camera 'cam0'"):
        recording.frame("cam0", 1)


def test_raw_and_compressed_of_one_camera_are_one_camera(tmp_path, pictures):
    from mcap_ros2.writer import Writer

    from quadrig.io.recording.messages.image_message import ROS2_DEFINITIONS

    with (tmp_path / "a.mcap").open("wb") as stream, Writer(stream) as writer:
        image = writer.register_msgdef("sensor_msgs/msg/Image", ROS2_DEFINITIONS["sensor_msgs/msg/Image"])
        name = "sensor_msgs/msg/CompressedImage"
        compressed = writer.register_msgdef(name, ROS2_DEFINITIONS[name])
        header = {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": ""}
        picture = pictures.picture(3)
        data, step = raw(picture, "bgr8")
        size = {"height": pictures.HEIGHT, "width": pictures.WIDTH}
        message = {"header": header, **size, "encoding": "bgr8", "is_bigendian": 0, "step": step, "data": data}
        writer.write_message("/cam0/image_raw", image, message, 1)
        data = cv2.imencode(".jpg", picture)[1].tobytes()
        writer.write_message(
            "/cam0/image_raw/compressed", compressed, {"header": header, "format": "jpeg", "data": data}, 2
        )
    recording = open_recording([tmp_path / "a.mcap"])
    assert [camera.topic for camera in recording.cameras] == ["/cam0/image_raw"]
    assert "/cam0/image_raw/compressed" in recording.notes[0]
    wanted = open_recording([tmp_path / "a.mcap"], {"eye": "/cam0/image_raw/compressed"})
    assert [(camera.name, camera.encoding) for camera in wanted.cameras] == [("eye", "jpeg")]
    assert open_recording([tmp_path / "a.mcap"], {"cam0": None}).cameras[0].topic == "/cam0/image_raw"
    with pytest.raises(QuadrigError, match=r"no topic for camera 'cam7'.*/cam0/image_raw"):
        open_recording([tmp_path / "a.mcap"], {"cam7": None})


def test_names():
    assert camera_name("/cam0/image_raw/compressed") == "cam0"
    assert camera_name("/stereo/left/image_raw") == "stereo/left"
    assert camera_name("/cam0/camera_info") == "cam0"
    assert camera_name("/image_raw") == "camera"


def test_what_is_no_recording_is_one_sentence(tmp_path: Path):
    (tmp_path / "text.mcap").write_text("hello")
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "nothing").mkdir()
    context = foxglove.Context()
    with foxglove.open_mcap(tmp_path / "talk.mcap", context=context):
        foxglove.Channel("/chatter", message_encoding="json", context=context).log({"say": "hello"})
    for name, words in {
        "text.mcap": "not an MCAP file",
        "empty.mcap": "is empty",
        "nothing": "no recording in this folder",
        "talk.mcap": "no images in this recording",
        "absent.mcap": "no such file",
    }.items():
        with pytest.raises(QuadrigError, match=words) as caught:
            open_recording([tmp_path / name])
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)
