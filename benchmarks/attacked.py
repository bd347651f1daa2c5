"""Small whole inputs of every kind that quadrig reads, made by quadrig and others' writers, and what reads them."""

import shutil
import struct
from collections.abc import Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from fractions import Fraction
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
from mutations import Mutate, either, forged_mcap, mutated_bytes, mutated_json, mutated_text

from quadrig.io.commands.main import run
from quadrig.io.formats.any_file import read_any_rig
from quadrig.io.formats.maps import ideal_rig
from quadrig.io.formats.registry import FORMATS, export_files
from quadrig.io.topic_writer import TopicWriter
from quadrig.single.arrays import Picture
from quadrig.single.lens import Intrinsics
from quadrig.single.markings.tag import TagMarking
from quadrig.single.pose import Pose
from quadrig.single.rectangle import Rectangle
from quadrig.single.render.picture import Sheet, ray_grid, render_image
from quadrig.single.rotation import rotation_from_vector

WIDTH, HEIGHT, FRAMESETS = 320, 240, 6
START, PERIOD = 1_700_000_000_000_000_000, 100_000_000
CONFIG = """reference = "cam0"

[[rectangle]]
name = "sheet"
width = 0.24
height = 0.24
moving = true
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 5 }

[[rectangle]]
name = "board"
moving = true
marking = { kind = "charuco", columns = 4, rows = 3, square = 0.05, marker = 0.04, dictionary = "aruco_4x4_50" }

[[rectangle]]
name = "wall"
width = 0.3
height = 0.2
marking = { kind = "tag", dictionary = "apriltag_36h11", id = 9 }
world_from_rect = { translation = [0, 1, 2], angles_deg = [0, 90, 0] }

[[camera]]
name = "cam0"
focal = 300
principal_point = [160, 120]
distortion = [0.0, 0.0]

[[camera]]
name = "cam1"
lens = "f c k1 k2"
"""
COURT = """[[rectangle]]
name = "court"
size = "tennis court"
marking = { kind = "points" }
"""
CORNERS = """# by hand
[[corners]]
camera = "left"
rectangle = "court"
sigma = 1.0
bottom_right = [250.5, 200.0]
bottom_left = [60.0, 190.0]
top_left = [100.0, 80.5]
top_right = [200, 90]

[[corners]]
camera = "right"
rectangle = "court"
bottom_right = [270.5, 210.0]
bottom_left = [40.0, 200.0]
top_left = [120.0, 70.5]
top_right = [220, 95]
"""
TARGETS = {
    "april": "target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n",
    "checker": "target_type: 'checkerboard'\ntargetCols: 6\ntargetRows: 7\n"
    "rowSpacingMeters: 0.06\ncolSpacingMeters: 0.06\n",
    "circles": "target_type: 'circlegrid'\ntargetCols: 6\ntargetRows: 7\n"
    "spacingMeters: 0.02\nasymmetricGrid: False\n",
}
PICTURES = (".jpg", ".png", ".webp", ".tiff", ".bmp", ".ppm")


@dataclass(frozen=True)
class Reader:
    """Files of one kind and what reads them.

    needs: files and folders of the whole inputs that are laid out; damaged: patterns of the files of which one is
    mutated. commands: of `rig`, one of them by chance; {} is the damaged file, {folder} where it lies, {name}
    its name.
    unchanged: whether the result must be that of the whole file, as kept detections are searched again.
    """

    needs: tuple[str, ...]
    damaged: tuple[str, ...]
    mutate: Mutate
    commands: tuple[str, ...]
    unchanged: bool = False


_CALIBRATE = "calibrate {} -c rig.toml -o out/rig.mcap --workers 1"
_OF_RECORDING = ("info {}", "info {} --json", f"{_CALIBRATE} --no-cache", f"{_CALIBRATE} --no-cache --share 0.5")
_OF_RIG = (
    "info {}", "info {} --json", "report {} -o out/report.html", "inspect {} --save out/rig.rrd",
    "compare {} rig.mcap",
    "check {} pictures/cam0 pictures/cam1", "undistort {} pictures/cam0 -o out", "export {} -f json --covariance",
    *(f"export {{}} -f {name} -o out/{name}" for name, form in FORMATS.items() if form.write),
    "calibrate pictures/cam0 pictures/cam1 -c rig.toml -o out/rig.mcap --workers 1 --no-cache --lenses {}",
    "calibrate pictures/cam0 pictures/cam1 -c rig.toml -o out/rig.mcap --workers 1 --no-cache --only cam1 --from {}",
)  # fmt: skip
_OF_FORMAT = (
    "import {} -o out/rig.mcap", "import {} -o out/rig.mcap --unit m --size 320x240",
    "import {folder} -o out/rig.mcap",
    "calibrate pictures/cam0 pictures/cam1 -c rig.toml -o out/rig.mcap --workers 1 --no-cache --lenses {}",
)  # fmt: skip
_ANY = either(mutated_bytes, mutated_text, mutated_json)
_WITH_PICTURES = ("rig.toml", "pictures")

READERS = {
    "recording": Reader(("rig.toml", "recordings"), ("recordings/*.mcap",), mutated_bytes, _OF_RECORDING),
    "forged recording": Reader(("rig.toml", "recordings"), ("recordings/*.mcap",), forged_mcap, _OF_RECORDING),
    "bag": Reader(
        ("rig.toml", "bags"), ("bags/*.bag", "bags/ros2/*"), mutated_bytes, (*_OF_RECORDING, "info bags/ros2"),
    ),
    "video": Reader(("rig.toml", "videos"), ("videos/*",), mutated_bytes, (*_OF_RECORDING, "info videos")),
    "pictures": Reader(
        _WITH_PICTURES, ("pictures/cam?/*",), mutated_bytes,
        ("info {folder}", "calibrate pictures -c rig.toml -o out/rig.mcap --workers 1 --no-cache",
         "record pictures/cam0 pictures/cam1 -o out/room.mcap", "undistort rig.mcap {} -o out"),
    ),
    "single": Reader(
        ("single",), ("single/*",), mutated_bytes,
        ("single {} --tag apriltag_36h11:5 --width 0.24 --height 0.24", "single {} --paper A4", "info {}"),
    ),
    "rig.toml": Reader(
        (*_WITH_PICTURES, "rig.mcap"), ("rig.toml",), mutated_text,
        ("calibrate pictures -c {} -o out/rig.mcap --workers 1 --no-cache", "check rig.mcap pictures -c {}"),
    ),
    "corners.toml": Reader(
        ("court",), ("court/corners.toml", "court/rig.toml"), mutated_text,
        ("calibrate court/left.jpg court/right.jpg -c court/rig.toml -o out/rig.mcap --workers 1 --no-cache",),
    ),
    "target": Reader(
        ("pictures", "single", "targets"), ("targets/*.yaml", "targets/*.toml"), mutated_text,
        ("calibrate pictures -c targets/{name}.toml -o out/rig.mcap --workers 1 --no-cache",
         "single single/tag.png --target targets/{name}.yaml"),
    ),
    "table": Reader(
        (*_WITH_PICTURES, "times.csv"), ("times.csv",), mutated_text,
        ("record pictures/cam0 pictures/cam1 -o out/room.mcap --timestamps times.csv",
         "record pictures/cam0 -o out/room.mcap --timestamps times.csv"),
    ),
    "rig.mcap": Reader((*_WITH_PICTURES, "rig.mcap", "damaged"), ("damaged/rig.mcap",), mutated_bytes, _OF_RIG),
    "forged rig.mcap": Reader((*_WITH_PICTURES, "rig.mcap", "damaged"), ("damaged/rig.mcap",), forged_mcap, _OF_RIG),
    "detections": Reader(
        (*_WITH_PICTURES, "kept"), ("kept/rig.detections.mcap",), mutated_bytes,
        ("calibrate pictures -c rig.toml -o kept/rig.mcap --workers 1",), unchanged=True,
    ),
    "forged detections": Reader(
        (*_WITH_PICTURES, "kept"), ("kept/rig.detections.mcap",), forged_mcap,
        ("calibrate pictures -c rig.toml -o kept/rig.mcap --workers 1",),
    ),
    **{
        f"format {name}": Reader((*_WITH_PICTURES, f"formats/{name}"), (f"formats/{name}/**/*",), _ANY, _OF_FORMAT)
        for name, form in FORMATS.items() if form.read and form.write
    },
}  # fmt: skip


def make_whole(folder: Path, work: Path) -> None:
    """Write every whole input into a folder. work: where they are laid out, since kept detections know the place of
    their pictures."""
    shots = _shots()
    folder.mkdir()
    (folder / "rig.toml").write_text(CONFIG)
    for camera, pictures in shots.items():
        place = folder / "pictures" / camera
        place.mkdir(parents=True)
        for k, picture in enumerate(pictures):
            cv2.imwrite(str(place / f"{k:03}{('.jpg', '.png')[k % 2]}"), picture)
    lay_out(folder, work, _WITH_PICTURES)
    with chdir(work):
        _run("calibrate pictures -c rig.toml -o out/rig.mcap --workers 1")
        for name in ("foxglove", "ros2"):
            _run(f"record pictures/cam0 pictures/cam1 -o out/{name}.mcap --format {name}")
    for kept in ("kept/rig.mcap", "kept/rig.detections.mcap", "rig.mcap", "damaged/rig.mcap"):
        (folder / kept).parent.mkdir(exist_ok=True)
        shutil.copy(work / "out" / Path(kept).name, folder / kept)
    _make_recordings(folder / "recordings", shots)
    for name in ("foxglove", "ros2"):
        shutil.copy(work / f"out/{name}.mcap", folder / "recordings")
    _make_bags(folder / "bags", shots)
    _make_videos(folder / "videos", shots)
    _make_texts(folder, shots)
    _make_formats(folder / "formats", folder / "rig.mcap")


def lay_out(folder: Path, work: Path, needs: Sequence[str]) -> None:
    """Copy what a reader needs, with its times, into an empty folder that has a folder `out`."""
    shutil.rmtree(work, ignore_errors=True)
    (work / "out").mkdir(parents=True)
    for name in needs:
        (work / name).parent.mkdir(parents=True, exist_ok=True)
        if (folder / name).is_dir():
            shutil.copytree(folder / name, work / name)
        else:
            shutil.copy2(folder / name, work / name)


def _run(command: str) -> None:
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()) as said:
        if run(command.split()) != 0:
            raise SystemExit(f"the whole inputs are not read: rig {command}: {said.getvalue()}")


def _shots() -> dict[str, list[Picture]]:
    """What two cameras see of a tag in the hand."""
    rng = np.random.default_rng(1)
    sheet = Rectangle("sheet", 0.24, 0.24, TagMarking("apriltag_36h11", 5), moving=True)
    poses = [
        Pose(rotation_from_vector(rng.uniform(-0.6, 0.6, 3)), np.array([0, 0, 0.8]) + rng.uniform(-0.1, 0.1, 3))
        for _ in range(FRAMESETS)
    ]
    cameras = {
        "cam0": Pose.identity(),
        "cam1": Pose(rotation_from_vector(np.array([0, -0.4, 0])), np.array([0.3, 0.0, 0.05])),
    }
    grid = ray_grid(Intrinsics.centred(WIDTH, HEIGHT, 300.0))
    return {
        name: [np.asarray(render_image(grid, pose.inverse(), [Sheet(sheet, held)], samples=2)) for held in poses]
        for name, pose in cameras.items()
    }


def _make_recordings(folder: Path, shots: dict[str, list[Picture]]) -> None:
    folder.mkdir()
    for compression in ("none", "lz4", "zstd"):
        stream = BytesIO()
        writer = TopicWriter(stream, compression)
        for topic, message in _messages(shots):
            writer.write_protobuf(topic, message, START)
        writer.declare_json("/json/image", "foxglove.CompressedImage")
        for k in range(3):
            writer.write_json("/json/image", _json_image(shots["cam0"][k], k), START + k * PERIOD)
        writer.finish()
        (folder / f"{compression}.mcap").write_bytes(stream.getvalue())


def _messages(shots: dict[str, list[Picture]]) -> Any:
    """Raw images, a video and a lens as protobuf, by topic."""
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    small = [np.ascontiguousarray(picture[::4, ::4]) for picture in shots["cam0"]]
    height, width = small[0].shape[:2]
    lens: Any = CameraCalibration(width=width, height=height, distortion_model="plumb_bob")
    lens.K.extend([75.0, 0, 40, 0, 75, 30, 0, 0, 1])
    lens.D.extend([0.0] * 5)
    yield "/raw/camera_info", lens
    for k, picture in enumerate(small):
        raw: Any = RawImage(width=width, height=height, step=3 * width, encoding="bgr8", data=picture.tobytes())
        raw.timestamp.FromNanoseconds(START + k * PERIOD)
        yield "/raw/image", raw
    for k, packet in enumerate(_h264(shots["cam1"])):
        video: Any = CompressedVideo(format="h264", data=packet)
        video.timestamp.FromNanoseconds(START + k * PERIOD)
        yield "/video/image", video


def _json_image(picture: Picture, k: int) -> bytes:
    data = cv2.imencode(".jpg", picture[::4, ::4])[1].tobytes()
    stamp = {"sec": START // 10**9, "nsec": k * PERIOD}
    return msgspec.json.encode({"timestamp": stamp, "frame_id": "x", "format": "jpeg", "data": data})


def _h264(pictures: Sequence[Picture]) -> list[bytes]:
    import av

    encoder: Any = av.CodecContext.create("libx264", "w")
    encoder.width, encoder.height, encoder.pix_fmt, encoder.time_base = WIDTH, HEIGHT, "yuv420p", Fraction(1, 10)
    encoder.options = {"tune": "zerolatency", "bf": "0"}
    frames = [av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), "bgr24") for picture in pictures]
    return [bytes(packet) for frame in [*frames, None] for packet in encoder.encode(frame)]


def _make_videos(folder: Path, shots: dict[str, list[Picture]]) -> None:
    import av

    folder.mkdir()
    for camera, suffix, codec in (("cam0", "mp4", "libx264"), ("cam1", "avi", "mjpeg"), ("cam2", "mkv", "mpeg4")):
        with av.open(str(folder / f"{camera}.{suffix}"), "w") as container:
            stream: Any = container.add_stream(codec, rate=10)
            stream.width, stream.height = WIDTH, HEIGHT
            stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
            for picture in shots[camera if camera in shots else "cam0"]:
                container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), "bgr24")))
            container.mux(stream.encode(None))


def _make_bags(folder: Path, shots: dict[str, list[Picture]]) -> None:
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    folder.mkdir()
    compressed: Any = Writer1(folder / "bz2.bag")
    compressed.set_compression(Writer1.CompressionFormat.BZ2)
    for writer, name in (
        (Writer1(folder / "ros1.bag"), Stores.ROS1_NOETIC), (compressed, Stores.ROS1_NOETIC),
        (Writer2(folder / "ros2", version=8), Stores.ROS2_HUMBLE),
    ):  # fmt: skip
        store: Any = get_typestore(name)
        types, ros1 = store.types, name is Stores.ROS1_NOETIC
        kind = "sensor_msgs/msg/CompressedImage"
        with writer as opened:
            bag: Any = opened
            for camera, pictures in shots.items():
                connection = bag.add_connection(f"/{camera}/image_raw/compressed", kind, typestore=store)
                for k, picture in enumerate(pictures):
                    time = START + k * PERIOD
                    stamp = types["builtin_interfaces/msg/Time"](*divmod(time, 10**9))
                    number = (k,) if ros1 else ()
                    header = types["std_msgs/msg/Header"](*number, stamp, "optical")
                    jpeg = cv2.imencode(".jpg", picture)[1].reshape(-1)
                    message = types[kind](header, "jpeg", jpeg)
                    write = store.serialize_ros1 if ros1 else store.serialize_cdr
                    bag.write(connection, time, write(message, kind))


def _make_texts(folder: Path, shots: dict[str, list[Picture]]) -> None:
    for name in ("single", "court", "targets"):
        (folder / name).mkdir()
    for suffix in PICTURES:
        cv2.imwrite(str(folder / "single" / f"tag{suffix}"), shots["cam0"][0])
    (folder / "single/turned.jpg").write_bytes(_with_exif((folder / "single/tag.jpg").read_bytes()))
    (folder / "court/rig.toml").write_text(COURT)
    (folder / "court/corners.toml").write_text(CORNERS)
    for name, camera in (("left", "cam0"), ("right", "cam1")):
        cv2.imwrite(str(folder / f"court/{name}.jpg"), shots[camera][0])
    for name, text in TARGETS.items():
        (folder / f"targets/{name}.yaml").write_text(text)
        rectangle = f'[[rectangle]]\nname = "{name}"\nmoving = true\ntarget = "{name}.yaml"\n'
        (folder / f"targets/{name}.toml").write_text(rectangle)
    rows = [f"{camera},{k},{k / 10}" for camera in shots for k in range(FRAMESETS)]
    (folder / "times.csv").write_text("\n".join(["camera,frame_index,time", *rows]) + "\n")


def _with_exif(jpeg: bytes) -> bytes:
    """The JPEG with an EXIF block: turned by 90 degrees, and when it was taken."""
    taken = b"2026:01:02 03:04:05\0"
    body = b"II*\0" + struct.pack("<IH", 8, 2)
    body += struct.pack("<HHIHH", 0x0112, 3, 1, 6, 0) + struct.pack("<HHII", 0x8769, 4, 1, 38) + struct.pack("<I", 0)
    body += struct.pack("<H", 1) + struct.pack("<HHII", 0x9003, 2, len(taken), 56) + struct.pack("<I", 0) + taken
    block = b"Exif\0\0" + body
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(block) + 2) + block + jpeg[2:]


def _make_formats(folder: Path, rig: Path) -> None:
    held = ideal_rig(read_any_rig(rig))
    for name, form in FORMATS.items():
        if form.write is None:
            continue
        for file, content in export_files(held, name).items():
            path = folder / name / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content.encode() if isinstance(content, str) else content)
