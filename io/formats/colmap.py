"""COLMAP's model, as text and as binary, with its rig and one frame. Poses are cam_from_world (our camera_from_rig)
as QW QX QY QZ TX TY TZ; pixels begin at the corner of the top-left pixel."""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np

from quadrig.io.formats.format import HALF_PIXEL, Files, Held, Options, camera_matrix, lens_of, pose_of_quaternion
from quadrig.rig.result import Camera, Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics, LensModel
from quadrig.single.pose import Pose


@dataclass(frozen=True)
class _Model:
    """One of COLMAP's camera models: focals is 1 or 2; places: where its distortion stands among OpenCV's."""

    name: str
    focals: int
    places: tuple[int, ...]
    model: LensModel = "pinhole"

    @property
    def count(self) -> int:
        return self.focals + 2 + len(self.places)


# By number. What is not here (FOV, thin prisms, division models) no lens of ours holds.
_MODELS = {
    0: _Model("SIMPLE_PINHOLE", 1, ()),
    1: _Model("PINHOLE", 2, ()),
    2: _Model("SIMPLE_RADIAL", 1, (0,)),
    3: _Model("RADIAL", 1, (0, 1)),
    4: _Model("OPENCV", 2, (0, 1, 2, 3)),
    5: _Model("OPENCV_FISHEYE", 2, (0, 1, 2, 3), "fisheye"),
    6: _Model("FULL_OPENCV", 2, (0, 1, 2, 3, 4, 5, 6, 7)),
    8: _Model("SIMPLE_RADIAL_FISHEYE", 1, (0,), "fisheye"),
    9: _Model("RADIAL_FISHEYE", 1, (0, 1), "fisheye"),
}
_CAMERA_SENSOR = 0
# A model's scale is anyone's guess, and its binary form has no place to say it.
_METRES = "# lengths in metres"
_FILES = ("rigs", "cameras", "frames", "images", "points3D")


def colmap_files(rig: Rig, _options: Options) -> Files:
    """rigs.txt, cameras.txt, frames.txt, images.txt (one image for each camera, by its name), points3D.txt."""
    first, others = rig.cameras[0], list(enumerate(rig.cameras))[1:]
    rig_from_first = first.rig_from_camera
    sensors = [
        f"CAMERA {i + 1} 1 {_text(_seven(one.rig_from_camera.inverse() @ rig_from_first))}" for i, one in others
    ]
    data = [f"CAMERA {index + 1} {index + 1}" for index, _ in enumerate(rig.cameras)]
    cameras, images = [], []
    for number, camera in enumerate(rig.cameras, start=1):
        kind, parameters = _lens(camera)
        lens, pose = camera.intrinsics, _seven(camera.rig_from_camera.inverse())
        cameras.append(f"{number} {_MODELS[kind].name} {lens.width} {lens.height} {_text(parameters)}")
        images += [f"{number} {_text(pose)} {number} {camera.name}.jpg", ""]
    frame = f"1 1 {_text(_seven(rig_from_first.inverse()))} {len(data)} {' '.join(data)}"
    lines = {
        "rigs": ["# RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as (SENSOR_TYPE, SENSOR_ID, "
                 "HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])", " ".join([f"1 {len(data)} CAMERA 1", *sensors])],
        "cameras": [_METRES, "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", *cameras],
        "frames": ["# FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX, TY, TZ], NUM_DATA_IDS, "
                   "DATA_IDS[] as (SENSOR_TYPE, SENSOR_ID, DATA_ID)", frame],
        "images": ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
                   "# POINTS2D[] as (X, Y, POINT3D_ID)", *images],
        "points3D": ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"],
    }  # fmt: skip
    return {f"{name}.txt": "\n".join([*lines[name], ""]) for name in _FILES}


def colmap_binary_files(rig: Rig, _options: Options) -> Files:
    """The same as rigs.bin, cameras.bin, frames.bin, images.bin, points3D.bin."""
    count, rig_from_first = len(rig.cameras), rig.cameras[0].rig_from_camera
    rigs = struct.pack("<QIIiI", 1, 1, count, _CAMERA_SENSOR, 1)
    cameras = images = struct.pack("<Q", count)
    frames = struct.pack("<QII7dI", 1, 1, 1, *_seven(rig_from_first.inverse()), count)
    for number, camera in enumerate(rig.cameras, start=1):
        kind, parameters = _lens(camera)
        lens, camera_from_rig = camera.intrinsics, camera.rig_from_camera.inverse()
        if number > 1:
            rigs += struct.pack("<iIB7d", _CAMERA_SENSOR, number, 1, *_seven(camera_from_rig @ rig_from_first))
        cameras += struct.pack("<IiQQ", number, kind, lens.width, lens.height)
        cameras += struct.pack(f"<{len(parameters)}d", *parameters)
        frames += struct.pack("<iIQ", _CAMERA_SENSOR, number, number)
        images += struct.pack("<I7dI", number, *_seven(camera_from_rig), number)
        images += f"{camera.name}.jpg".encode() + b"\0" + struct.pack("<Q", 0)
    content = (rigs, cameras, frames, images, struct.pack("<Q", 0))
    return {f"{name}.bin": held for name, held in zip(_FILES, content, strict=True)}


def _lens(camera: Camera) -> tuple[int, list[float]]:
    """FULL_OPENCV holds k1 k2 p1 p2 k3 k4 k5 k6, of which ours are the first five; OPENCV_FISHEYE k1 to k4."""
    lens = camera.intrinsics
    k, (cx, cy) = lens.distortion.tolist(), (lens.principal_point + HALF_PIXEL).tolist()
    kind, tail = (6, [*k, 0.0, 0.0, 0.0]) if lens.model == "pinhole" else (5, k[:4])
    return kind, [lens.focal, lens.focal * lens.aspect, cx, cy, *tail]


def _seven(pose: Pose) -> list[float]:
    x, y, z, w = pose.quaternion().tolist()
    return [w, x, y, z, *pose.translation.tolist()]


def _text(numbers: list[float]) -> str:
    return " ".join(repr(float(value)) for value in numbers)


@dataclass(frozen=True)
class _Content:
    """cameras: model, width, height and parameters, by number; images: pose of seven, camera and name; rigs:
    sensor_from_rig by camera, None where it is not known."""

    cameras: dict[int, tuple[_Model, int, int, list[float]]]
    images: list[tuple[list[float], int, str]]
    rigs: list[dict[int, list[float] | None]]
    metres: bool = False


def is_colmap(path: Path, _head: bytes) -> bool:
    """Whether a path is a model's folder, or one of the files there."""
    folder = path if path.is_dir() else path.parent
    return _ending(folder) != "" and (path == folder or path.stem in _FILES)


def read_colmap(path: Path) -> Held:
    """Lenses and poses of a model (folder): of its images where each camera took one, else of its rig.

    Cameras are called by the folder of their images, or by their image. Raises QuadrigError where a lens is of a
    model that quadrig does not have, or a camera took several pictures and is in no rig.
    """
    folder = path if path.is_dir() else path.parent
    content = _read_binary(folder) if _ending(folder) == ".bin" else _read_text(folder)
    names = _names(content)
    lenses = {
        names[number]: _lens_of(*camera, f"{path}: camera {number}") for number, camera in content.cameras.items()
    }
    unit = 1.0 if content.metres else None
    taken = [number for _, number, _ in content.images]
    if len(set(taken)) == len(taken):
        return Held(
            lenses, {names[number]: _pose(seven).inverse() for seven, number, _ in content.images}, "world", unit
        )
    rig = next((rig for rig in content.rigs if all(rig.get(number) is not None for number in taken)), None)
    if rig is None:
        lost = next((n for n in taken if all(each.get(n) is None for each in content.rigs)), taken[0])
        raise QuadrigError(
            f"{path}: cameras took several pictures each, and no rig says where {names[lost]} is among them; set up "
            "a rig in COLMAP (rig_configurator), or give a model of one picture a camera"
        )
    poses = {names[n]: _pose(seven).inverse() for n, seven in rig.items() if seven is not None and n in names}
    return Held(lenses, poses, unit=unit)


def _ending(folder: Path) -> str:
    """How the files of a model end; "" where there is none."""
    ends = (end for end in (".bin", ".txt") if all((folder / f"{n}{end}").is_file() for n in ("cameras", "images")))
    return next(ends, "")


def _names(content: _Content) -> dict[int, str]:
    """A name for each camera: the folder of its pictures, else its one picture, else its number."""
    pictures = {number: [Path(n) for _, k, n in content.images if k == number] for number in content.cameras}
    folders = {number: {one.parent.as_posix() for one in own} for number, own in pictures.items()}
    own_folder = [next(iter(each)) for each in folders.values() if len(each) == 1 and each != {"."}]
    if len(own_folder) == len(set(own_folder)) == len(content.cameras):
        return dict(zip(content.cameras, own_folder, strict=True))
    return {n: own[0].with_suffix("").as_posix() if len(own) == 1 else f"camera{n}" for n, own in pictures.items()}


def _lens_of(model: _Model, width: int, height: int, parameters: list[float], where: str) -> Intrinsics:
    focals, (cx, cy) = parameters[: model.focals], parameters[model.focals : model.focals + 2]
    distortion = np.zeros(8 if model.model == "pinhole" else 4)
    distortion[list(model.places)] = parameters[model.focals + 2 :]
    matrix = camera_matrix(focals[0], focals[-1], cx - HALF_PIXEL, cy - HALF_PIXEL)
    return lens_of((width, height), matrix, distortion, where, model.model)


def _pose(seven: Sequence[float]) -> Pose:
    w, x, y, z, *translation = seven
    return pose_of_quaternion([x, y, z, w], translation, "an image or sensor")


def _model(kind: int | str, path: Path) -> _Model:
    found = next((model for number, model in _MODELS.items() if kind in (number, model.name)), None)
    if found is None:
        names = ", ".join(model.name for model in _MODELS.values())
        raise QuadrigError(
            f"{path}: has a camera of model {kind}; quadrig reads {names}: choose one of those in COLMAP"
        )
    return found


def _read_text(folder: Path) -> _Content:
    cameras: dict[int, tuple[_Model, int, int, list[float]]] = {}
    for words in _words(folder / "cameras.txt"):
        model = _model(words[1], folder / "cameras.txt")
        cameras[int(words[0])] = model, int(words[2]), int(words[3]), _counted(words[4:], model)
    # Each image is followed by the line of its points, which may be empty.
    lines = _words(folder / "images.txt", every=2)
    images = [([float(word) for word in words[1:8]], int(words[8]), " ".join(words[9:])) for words in lines]
    rigs: list[dict[int, list[float] | None]] = []
    for words in _words(folder / "rigs.txt") if (folder / "rigs.txt").is_file() else ():
        rigs.append({int(words[3]): _seven(Pose.identity())})
        rest = words[4:]
        while rest:
            known = rest[2] == "1"
            rigs[-1][int(rest[1])] = [float(word) for word in rest[3:10]] if known else None
            rest = rest[10:] if known else rest[3:]
    with (folder / "cameras.txt").open(encoding="utf-8") as stream:
        metres = stream.readline().strip() == _METRES
    return _Content(cameras, images, rigs, metres)


def _words(path: Path, every: int = 1) -> Iterator[list[str]]:
    """The words of each line that is no comment, of one line in so many."""
    with path.open(encoding="utf-8") as stream:
        lines = (line for line in stream if not line.startswith("#") and (every > 1 or line.strip()))
        yield from (line.split() for line in islice(lines, 0, None, every) if line.strip())


def _counted(words: Sequence[str | float], model: _Model) -> list[float]:
    if len(words) != model.count:
        raise ValueError(f"a {model.name} has {model.count} parameters, not {len(words)}")
    return [float(word) for word in words]


def _read_binary(folder: Path) -> _Content:
    cameras: dict[int, tuple[_Model, int, int, list[float]]] = {}
    images: list[tuple[list[float], int, str]] = []
    rigs: list[dict[int, list[float] | None]] = []
    with (folder / "cameras.bin").open("rb") as stream:
        for _ in range(*_take(stream, "<Q")):
            number, kind, width, height = _take(stream, "<IiQQ")
            model = _model(kind, folder / "cameras.bin")
            cameras[number] = model, width, height, list(_take(stream, f"<{model.count}d"))
    with (folder / "images.bin").open("rb") as stream:
        for _ in range(*_take(stream, "<Q")):
            _, *seven, number = _take(stream, "<I7dI")
            name = b"".join(iter(lambda: stream.read(1) or b"\0", b"\0"))
            images.append((seven, number, name.decode()))
            stream.seek(24 * _take(stream, "<Q")[0], 1)
    if (folder / "rigs.bin").is_file():
        with (folder / "rigs.bin").open("rb") as stream:
            for _ in range(*_take(stream, "<Q")):
                _, count, _, number = _take(stream, "<IIiI")
                rigs.append({number: _seven(Pose.identity())})
                for _ in range(count - 1):
                    _, number, known = _take(stream, "<iIB")
                    rigs[-1][number] = list(_take(stream, "<7d")) if known else None
    return _Content(cameras, images, rigs)


def _take(stream: BinaryIO, layout: str) -> tuple:
    try:
        return struct.unpack(layout, stream.read(struct.calcsize(layout)))
    except struct.error as error:
        raise ValueError("the file ends too early") from error
