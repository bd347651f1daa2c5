"""rig.toml: what stands in the room. Read strictly, what is wrong in it named by its line, written back."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from quadrig.io.config.corners_toml import PointedCorners, corners_beside, read_corners
from quadrig.io.config.errors import decoded, locate
from quadrig.io.config.kalibr_target import with_targets_read
from quadrig.io.config.known_sizes import known_size
from quadrig.io.config.marking_tables import (
    Length,
    LineTime,
    marking_keys,
    marking_of,
    marking_table,
    read_quantities,
)
from quadrig.io.config.toml_lines import toml_line
from quadrig.io.plain_words import plain_name
from quadrig.io.whole_file import read_text, write_text
from quadrig.rig.problem.camera_input import CameraInput, LensChoice
from quadrig.rig.problem.layouts import check_bodies
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics, LensModel, image_middle
from quadrig.single.markings.registry import marking_kinds
from quadrig.single.pose import Pose
from quadrig.single.rectangle import PRINT_SCALE_SIGMA, WORLD, Marking, Rectangle
from quadrig.single.rotation import rotation_from_angles, rotation_from_quaternion, vector_from_rotation

# Lengths measured twice, once as columns x square and once as the sheet's side, agree to a printer's rounding.
_SIDE_TOLERANCE = 1e-3

# A quaternion typed with four decimals is a unit one to this much; beyond it, a number is wrong.
_UNIT_TOLERANCE = 1e-2

# Metres and degrees of a pose in a room; beyond it, or where it is nan, a number is wrong.
_FARTHEST = 1e6

# Of OpenCV's 4, 5, 8, 12 or 14 those that lenses here have.
_COEFFICIENTS = 5

Positive = Annotated[float, msgspec.Meta(gt=0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0)]
Name = Annotated[str, msgspec.Meta(min_length=1)]


class _Table(msgspec.Struct, forbid_unknown_fields=True):
    """A table of rig.toml: an unknown key is an error."""


class _GivenPose(_Table):
    """A pose, and how well it is known: sigma in metres along each axis, sigma_deg about each; exactly where 0."""

    translation: tuple[Length, Length, Length]
    angles_deg: tuple[float, float, float] | None = None
    quaternion_xyzw: tuple[float, float, float, float] | None = None
    sigma: Length = Length(0.0)
    sigma_deg: NotNegative = 0.0


class _Rectangle(_Table, kw_only=True):
    name: Name
    marking: msgspec.Struct
    size: str | None = None
    width: Length | None = None
    height: Length | None = None
    moving: bool = False
    back: bool = False
    scale_sigma: float = PRINT_SCALE_SIGMA
    world_from_rect: _GivenPose | None = None
    body: Name | None = None
    body_from_rect: _GivenPose | None = None


class _Body(_Table):
    name: Name
    moving: bool = False


class _Camera(_Table):
    name: Name
    topic: str | None = None
    source: int | str | None = None
    focal: Positive | None = None
    principal_point: tuple[float, float] | None = None
    distortion: Annotated[list[float], msgspec.Meta(max_length=14)] | None = None
    aspect: Positive = 1.0
    model: LensModel = "pinhole"
    fixed: bool = False
    lens: LensChoice = "auto"
    line_time: LineTime | None = None


class _File(_Table, kw_only=True):
    rectangle: Sequence[_Rectangle]
    reference: str | None = None
    camera: list[_Camera] = []
    body: list[_Body] = []


@lru_cache(maxsize=2)
def _file_table(kinds: tuple[type[Marking], ...]) -> type[_File]:
    """The whole file where markings are of these kinds."""
    marking = ("marking", marking_table(kinds))
    rectangle = msgspec.defstruct("_Rectangle", [marking], bases=(_Rectangle,), kw_only=True)
    file = msgspec.defstruct("_File", [("rectangle", list[rectangle])], bases=(_File,), kw_only=True)
    assert issubclass(file, _File)
    return file


def file_type() -> type[_File]:
    """The whole file as a type: its fields are the keys, of markings those of the kinds that there are now."""
    return _file_table(tuple(marking_kinds().values()))


@dataclass(frozen=True, eq=False)
class CameraConfig:
    """One [[camera]] of rig.toml.

    topic: the recording's topic, None where the name is enough. source: a device number, stream, video or folder for
    rig record and rig setup. focal, principal_point (2,), distortion (5,): prior intrinsics in pixels, None where
    not given; fixed: they are the truth and stay. lens: which parameters are estimated.
    line_time: s from one row of its pictures to the next; None where not known.
    """

    name: str
    topic: str | None = None
    source: int | str | None = None
    focal: float | None = None
    principal_point: tuple[float, float] | None = None
    distortion: tuple[float, ...] = ()
    aspect: float = 1.0
    model: LensModel = "pinhole"
    fixed: bool = False
    lens: LensChoice = "auto"
    line_time: float | None = None

    def camera_input(self, width: int, height: int) -> CameraInput:
        """What is known of this camera, its pictures being width x height pixels."""
        lens: LensChoice = "fisheye" if self.model == "fisheye" and self.lens == "auto" else self.lens
        intrinsics = None
        if self.focal is not None:
            centre = np.array(self.principal_point) if self.principal_point else image_middle(width, height)
            distortion = np.zeros(5)
            distortion[: len(self.distortion)] = self.distortion
            intrinsics = Intrinsics(
                width, height, self.focal, centre, distortion, aspect=self.aspect, model=self.model
            )
        return CameraInput(self.name, width, height, intrinsics, self.fixed, lens, line_time=self.line_time)


@dataclass(frozen=True, eq=False)
class RigConfig:
    """A rig.toml: rectangles, what is known of cameras, and whose frame is the rig frame.

    cameras is empty where every image topic of the recording is a camera. text: the file as it was written.
    corners: what corners.toml beside it holds, for rectangles whose corners are given by hand.
    """

    rectangles: tuple[Rectangle, ...]
    cameras: tuple[CameraConfig, ...] = ()
    reference: str | None = None
    text: str = field(default="", repr=False)
    corners: tuple[PointedCorners, ...] = ()

    def camera(self, name: str) -> CameraConfig | None:
        """The [[camera]] of that name, None where there is none."""
        return next((camera for camera in self.cameras if camera.name == name), None)

    def camera_input(self, name: str, width: int, height: int) -> CameraInput:
        """What is known of a camera of the recording, by its name and the size of its pictures."""
        return (self.camera(name) or CameraConfig(name)).camera_input(width, height)


def read_config(path: Path | str) -> RigConfig:
    """The rig.toml at a path, with the corners.toml beside it where rectangles need one.

    Raises QuadrigError, one sentence with file, line and key, where it cannot be read or holds what it may not.
    """
    path = Path(path)
    try:
        text = read_text(path)
    except FileNotFoundError:
        raise QuadrigError(
            f"{path}: there is no such file; describe your rectangles in a rig.toml, or take one of examples/"
        ) from None
    except OSError as error:
        raise QuadrigError(f"{path}: cannot be read as text ({error}); give a rig.toml") from error
    config = parse_config(text, str(path))
    if not any(rectangle.marking.by_hand for rectangle in config.rectangles):
        return config
    return replace(config, corners=read_corners(corners_beside(path), config.rectangles))


def parse_config(text: str, name: str = "rig.toml") -> RigConfig:
    """The rig.toml of a text; name: what errors call it, and where files lie that it names. Raises QuadrigError as
    read_config does."""
    text = with_targets_read(text, Path(name).parent, name)
    tables = decoded(text, file_type(), name, read_quantities)
    if not tables.rectangle:
        raise QuadrigError(f"{name}: there is no [[rectangle]]; describe at least one that several cameras see")
    bodies = {table.name: table.moving for table in tables.body}
    rectangles = tuple(_rectangle(table, i, bodies, text, name) for i, table in enumerate(tables.rectangle))
    cameras = tuple(_camera(table, i, text, name) for i, table in enumerate(tables.camera))
    _check_unique("rectangle", [r.name for r in rectangles], text, name)
    _check_unique("camera", [c.name for c in cameras], text, name)
    _check_topics(cameras, text, name)
    _check_unique("body", [body.name for body in tables.body], text, name)
    _check_markings(rectangles, text, name)
    _check_bodies(rectangles, tables.body, text, name)
    _check_reference(tables.reference, rectangles, cameras, text, name)
    return RigConfig(rectangles, cameras, tables.reference, text)


def _rectangle(table: _Rectangle, index: int, bodies: Mapping[str, bool], text: str, name: str) -> Rectangle:
    """bodies: which of the [[body]] tables moves, by name."""
    where = partial(locate, name, text, f"$.rectangle[{index}]")
    try:
        marking = marking_of(table.marking)
    except (ValueError, QuadrigError) as error:
        raise QuadrigError(f"{where('marking')}: rectangle {table.name!r}: {error}") from error
    table = _with_known_size(table, where)
    own_width, own_height = marking.size or (None, None)
    width, height = _side(table, "width", own_width, where), _side(table, "height", own_height, where)
    body, given = _on_body(table, where)
    pose = given and _given_pose(
        table.name, "world_from_rect" if table.body_from_rect is None else "body_from_rect", given, where
    )
    sigma = (0.0, 0.0) if given is None else (float(np.radians(given.sigma_deg)), float(given.sigma))
    moving = table.moving or bodies.get(body, False)
    try:
        return Rectangle(table.name, width, height, marking, moving, table.back, table.scale_sigma, body, pose, sigma)
    except QuadrigError as error:
        sides = (("width", width), ("height", height))
        broken = [key for key, length in sides if not (np.isfinite(length) and length > 0)]
        keys = ("back", "body_from_rect", "scale_sigma")
        side = broken[0] if broken else next((key for key in keys if key in str(error)), "body_from_rect")
        raise QuadrigError(f"{where(side)}: {error}") from error


def _on_body(table: _Rectangle, where: Callable[[str], str]) -> tuple[str, _GivenPose | None]:
    """The body that a rectangle stands on, and its pose there where that is given: world_from_rect is its pose on the
    surveyed world."""
    world, own = table.world_from_rect, table.body_from_rect
    if own is not None and table.body is None:
        raise QuadrigError(
            f"{where('body_from_rect')}: rectangle {table.name!r} has body_from_rect and no body; give its name"
        )
    if world is None:
        return table.body or "", own
    if table.body not in (None, WORLD):
        raise QuadrigError(
            f"{where('body')}: rectangle {table.name!r} is of two bodies, {table.body!r} and the world "
            "(world_from_rect); a rectangle is fixed to one: keep one of them"
        )
    if own is not None and own != world:
        raise QuadrigError(
            f"{where('body_from_rect')}: rectangle {table.name!r} has two poses on the world, world_from_rect and "
            "body_from_rect, which contradict each other; keep one of them"
        )
    return WORLD, world


def _with_known_size(table: _Rectangle, where: Callable[[str], str]) -> _Rectangle:
    """The table with the width and height of the size that it names, if it does."""
    if table.size is None:
        return table
    if table.width is not None or table.height is not None:
        raise QuadrigError(
            f"{where('size')}: rectangle {table.name!r} has a size by name and a width or height; keep one of them"
        )
    try:
        known = known_size(table.size)
    except QuadrigError as error:
        raise QuadrigError(f"{where('size')}: rectangle {table.name!r}: {error}") from error
    return msgspec.structs.replace(table, width=known.width, height=known.height)


def _side(table: _Rectangle, side: str, follows: float | None, where: Callable[[str], str]) -> float:
    """A side of the rectangle as it is given, or as it follows from the marking; where: file and line of a key."""
    given: float | None = getattr(table, side)
    if follows is None:
        if given is not None:
            return float(given)
        raise QuadrigError(
            f"{where('')}: rectangle {table.name!r} has no {side}; give it in metres, outer edge of the marking, "
            'or the name of a size that everybody has, as size = "A4"'
        )
    if given is not None and not abs(given - follows) <= _SIDE_TOLERANCE:
        raise QuadrigError(
            f"{where(side)}: rectangle {table.name!r}: {side} is {given} m, but {follows:g} m by the size of the "
            f"marking's squares; leave {side} out or mend one of them"
        )
    return follows


def _given_pose(rectangle: str, key: str, table: _GivenPose, where: Callable[[str], str]) -> Pose:
    def wrong(what: str) -> QuadrigError:
        return QuadrigError(f"{where(key)}: rectangle {rectangle!r}: {what}")

    if table.angles_deg is None and table.quaternion_xyzw is None:
        raise wrong(f"{key} needs translation and one of angles_deg and quaternion_xyzw")
    numbers = (*table.translation, *(table.angles_deg or ()), *(table.quaternion_xyzw or ()))
    if not np.abs(numbers).max() <= _FARTHEST:
        raise wrong(f"{key} holds {max(numbers, key=lambda n: abs(n) if n == n else np.inf):g}, which is no pose")
    angles = None if table.angles_deg is None else rotation_from_angles(*np.radians(table.angles_deg))
    if table.quaternion_xyzw is None:
        assert angles is not None
        return Pose(angles, np.array(table.translation, float))
    quaternion = np.array(table.quaternion_xyzw, float)
    if not abs(np.linalg.norm(quaternion) - 1) <= _UNIT_TOLERANCE:
        raise wrong(f"quaternion_xyzw has length {np.linalg.norm(quaternion):.3g}; a rotation has length 1")
    rotation = rotation_from_quaternion(quaternion)
    if angles is not None and np.abs(angles - rotation).max() > _UNIT_TOLERANCE:
        apart = np.degrees(np.linalg.norm(vector_from_rotation(angles.T @ rotation)))
        raise wrong(
            f"{key} is given twice, by angles_deg and by quaternion_xyzw, and they are {apart:.3g} degrees apart; "
            "keep one of them"
        )
    return Pose(rotation, np.array(table.translation, float))


def _camera(table: _Camera, index: int, text: str, name: str) -> CameraConfig:
    if table.focal is None and (table.fixed or table.principal_point or table.distortion):
        raise QuadrigError(
            f"{locate(name, text, f'$.camera[{index}]')}: camera {table.name!r} has prior intrinsics without focal; "
            "give focal in pixels, or leave principal_point, distortion and fixed out"
        )
    distortion = tuple(table.distortion or ())
    if any(distortion[_COEFFICIENTS:]):
        raise QuadrigError(
            f"{locate(name, text, f'$.camera[{index}]', 'distortion')}: camera {table.name!r} has {len(distortion)} "
            f"coefficients, but the lenses here have the first {_COEFFICIENTS} of OpenCV (k1 k2 p1 p2 k3): those "
            "behind must be zero; calibrate it without CALIB_RATIONAL_MODEL, CALIB_THIN_PRISM_MODEL and "
            "CALIB_TILTED_MODEL, or give its focal alone as a first guess"
        )
    return CameraConfig(
        table.name,
        table.topic,
        table.source,
        table.focal,
        table.principal_point,
        distortion[:_COEFFICIENTS],
        table.aspect,
        table.model,
        table.fixed,
        table.lens,
        None if table.line_time is None else float(table.line_time),
    )


def _check_unique(kind: str, names: list[str], text: str, name: str) -> None:
    seen: set[str] = set()
    for index, one in enumerate(names):
        if plain_name(one) != one:
            raise QuadrigError(
                f"{locate(name, text, f'$.{kind}[{index}]', 'name')}: a {kind} is called {plain_name(one)!r}, with "
                "control characters or too many letters; give it a name that can be read"
            )
        if one in seen:
            raise QuadrigError(
                f"{locate(name, text, f'$.{kind}[{index}]', 'name')}: two {kind}s are called {one!r}; "
                "give each a name of its own"
            )
        seen.add(one)


def _check_topics(cameras: tuple[CameraConfig, ...], text: str, name: str) -> None:
    owners: dict[str, str] = {}
    for index, camera in enumerate(cameras):
        if camera.topic is None:
            continue
        if camera.topic in owners:
            raise QuadrigError(
                f"{locate(name, text, f'$.camera[{index}]', 'topic')}: cameras {owners[camera.topic]!r} and "
                f"{camera.name!r} have the same topic, {camera.topic}; give each its own"
            )
        owners[camera.topic] = camera.name


def _check_bodies(rectangles: tuple[Rectangle, ...], bodies: list[_Body], text: str, name: str) -> None:
    members: dict[str, list[int]] = {}
    for index, rectangle in enumerate(rectangles):
        if rectangle.body:
            members.setdefault(rectangle.body, []).append(index)
    for index, body in enumerate(bodies):
        if body.name not in members:
            raise QuadrigError(
                f"{locate(name, text, f'$.body[{index}]', 'name')}: no rectangle stands on body {body.name!r}; give "
                f'its rectangles body = "{body.name}", or leave it out'
            )
    for body, own in members.items():
        if len(own) == 1 and rectangles[own[0]].body_from_rect is None:
            where = locate(name, text, f"$.rectangle[{own[0]}]", "body")
            raise QuadrigError(
                f"{where}: body {body!r} has one rectangle, {rectangles[own[0]].name!r}; a body is two or more that "
                "are fixed to each other: leave body out, or give it to the others"
            )
    try:
        check_bodies(rectangles)
    except QuadrigError as error:
        wrong = next((own[0] for body, own in members.items() if f"body {body!r}" in str(error)), 0)
        raise QuadrigError(f"{locate(name, text, f'$.rectangle[{wrong}]', 'body')}: {error}") from error


def _check_markings(rectangles: tuple[Rectangle, ...], text: str, name: str) -> None:
    owners: dict[Hashable, Rectangle] = {}
    for index, rectangle in enumerate(rectangles):
        for mark in rectangle.marking.marks:
            if mark in owners:
                raise QuadrigError(
                    f"{locate(name, text, f'$.rectangle[{index}]', 'marking')}: rectangles {owners[mark].name!r} and "
                    f"{rectangle.name!r} look alike ({rectangle.marking.description}); give one another marking"
                )
            owners[mark] = rectangle


def _check_reference(
    reference: str | None,
    rectangles: tuple[Rectangle, ...],
    cameras: tuple[CameraConfig, ...],
    text: str,
    name: str,
) -> None:
    rectangle = next((r for r in rectangles if r.name == reference), None)
    if reference is None or any(c.name == reference for c in cameras):
        return
    # Where none names its topic, the tables only add what is known: the recording's other cameras are used as well.
    if rectangle is None and any(camera.topic is not None for camera in cameras):
        known = ", ".join([*(c.name for c in cameras), *(r.name for r in rectangles if not r.moving)])
        raise QuadrigError(
            f"{locate(name, text, '$', 'reference')}: reference is {reference!r}, which is neither a camera nor a "
            f"rectangle here; choose one of {known}"
        )
    if rectangle is not None and rectangle.moving:
        raise QuadrigError(
            f"{locate(name, text, '$', 'reference')}: reference is {reference!r}, which moves; choose a camera or a "
            "rectangle that stands still"
        )


def refuse_reference(config: RigConfig, cameras: Sequence[str]) -> None:
    """Raises QuadrigError where the reference is none of these cameras, nor a rectangle that stands still."""
    names = [*cameras, *(one.name for one in config.rectangles if not one.moving)]
    if config.reference is not None and config.reference not in names:
        raise QuadrigError(
            f"reference is {config.reference!r}, which is none of {', '.join(names)}; take one of them"
        )


def write_config(config: RigConfig, path: Path | str) -> None:
    """Write a rig.toml, whole or not at all. Raises QuadrigError where it cannot be written."""
    write_text(path, config_text(config))


def config_text(config: RigConfig) -> str:
    """The rig.toml of a config, which parse_config reads back to the same values."""
    tables = [
        "\n".join(["[[rectangle]]", *(toml_line(k, v) for k, v in _rectangle_values(rectangle).items())])
        for rectangle in config.rectangles
    ]
    for camera in config.cameras:
        values = msgspec.structs.asdict(_camera_table(camera))
        defaults = msgspec.structs.asdict(_Camera(name=""))
        kept = {k: v for k, v in values.items() if v is not None and v != defaults[k]}
        tables.append("\n".join(["[[camera]]", *(toml_line(k, v) for k, v in kept.items())]))
    moving = sorted({rectangle.body for rectangle in config.rectangles if rectangle.body and rectangle.moving})
    tables = ["\n".join(["[[body]]", toml_line("name", body), "moving = true"]) for body in moving] + tables
    head = [] if config.reference is None else [toml_line("reference", config.reference)]
    return "\n\n".join([*head, *tables]) + "\n"


def _rectangle_values(rectangle: Rectangle) -> dict[str, object]:
    values: dict[str, object] = {"name": rectangle.name}
    if rectangle.marking.size is None:
        values |= {"width": rectangle.width, "height": rectangle.height}
    if rectangle.moving and not rectangle.body:
        values["moving"] = True
    if rectangle.back:
        values["back"] = True
    if rectangle.scale_sigma != PRINT_SCALE_SIGMA:
        values["scale_sigma"] = rectangle.scale_sigma
    values["marking"] = marking_keys(rectangle.marking)
    if rectangle.body:
        values["body"] = rectangle.body
    if rectangle.body_from_rect is not None:
        rotation, position = rectangle.layout_sigma
        pose: dict[str, object] = {
            "translation": rectangle.body_from_rect.translation.tolist(),
            "quaternion_xyzw": rectangle.body_from_rect.quaternion().tolist(),
        }
        known = {"sigma": position, "sigma_deg": float(np.degrees(rotation))}
        values["body_from_rect"] = pose | {key: sigma for key, sigma in known.items() if sigma}
    return values


def _camera_table(camera: CameraConfig) -> _Camera:
    return _Camera(
        name=camera.name,
        topic=camera.topic,
        source=camera.source,
        focal=camera.focal,
        principal_point=camera.principal_point,
        distortion=list(camera.distortion) or None,
        aspect=camera.aspect,
        model=camera.model,
        fixed=camera.fixed,
        lens=camera.lens,
        line_time=None if camera.line_time is None else LineTime(camera.line_time),
    )
