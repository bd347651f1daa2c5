"""Rigs in the formats of other programs: one registry, one file each."""

from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

import numpy as np

from quadrig.io.formats.blender import blender_files
from quadrig.io.formats.colmap import colmap_binary_files, colmap_files, is_colmap, read_colmap
from quadrig.io.formats.format import Files, Format, Options, opencv_names, plain_names
from quadrig.io.formats.kalibr import is_kalibr, kalibr_files, read_kalibr
from quadrig.io.formats.maps import ffmpeg_map_files, ideal_lens, opencv_map_files
from quadrig.io.formats.mrcal import is_mrcal, mrcal_files, read_mrcal
from quadrig.io.formats.nerfstudio import is_nerfstudio, nerfstudio_files, read_nerfstudio
from quadrig.io.formats.opencv import is_opencv, opencv_files, read_opencv
from quadrig.io.formats.rig_json import is_rig_json, json_files, read_json
from quadrig.io.formats.ros import (
    FRAMES,
    is_camera_info,
    is_frames,
    read_camera_info,
    read_frames,
    ros_files,
    tf_files,
    urdf_files,
)
from quadrig.io.formats.toml_rigs import (
    anipose_files,
    caliscope_files,
    freemocap_files,
    is_toml_rig,
    numbered,
    pose2sim_files,
    read_toml,
)
from quadrig.io.formats.usd import is_usd, read_usd, usd_files
from quadrig.io.plain_words import LONGEST_NAME, plain, plain_name
from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics

_DOUBT = "sigmas, rectangles"


@dataclass(frozen=True, eq=False)
class Export:
    """A rig in a format: its files by name, and in sentences what the format could not take as it was."""

    files: Files
    notes: tuple[str, ...] = ()


def export_rig(rig: Rig, name: str, options: Options | None = None) -> Export:
    """A rig in a format. Raises QuadrigError where there is no such format or it cannot hold the rig."""
    if name not in FORMATS:
        raise QuadrigError(f"there is no format {name!r}; there are {', '.join(FORMATS)}")
    form, options = FORMATS[name], options or Options()
    if form.write is None or not rig.cameras:
        raise QuadrigError(f"{name} is only read" if form.write is None else "the rig has no camera to export")
    for camera in rig.cameras:
        if not np.isfinite(camera.rig_from_camera.matrix()).all():
            raise QuadrigError(f"camera {camera.name!r} is not placed; export a rig whose cameras all have poses")
        if form.ideal and not _is_ideal(camera.intrinsics):
            raise QuadrigError(
                f"{name} has no place for the distortion or the aspect of camera {camera.name!r}; export with "
                "--undistorted, and use it with the pictures that `rig undistort` makes"
            )
    if plain_names([options.base]) != [options.base]:
        raise QuadrigError(
            f"no frame can be called {options.base!r}; give --base letters, digits and _, a letter first"
        )
    rig, left_out = _with_lenses(rig, form, name)
    fitted, notes = _renamed(rig, form, name, options.base)
    return Export(form.write(fitted, options), (*left_out, *notes))


def export_files(rig: Rig, name: str, options: Options | None = None) -> Files:
    """The files of a rig in a format, by name. Raises QuadrigError as export_rig does."""
    return export_rig(rig, name, options).files


def _readable(name: str) -> str:
    """A name as it is, but for control characters and thousands of letters."""
    return name if plain(name) == name and len(name) <= LONGEST_NAME else plain_name(name)


def _with_lenses(rig: Rig, form: Format, name: str) -> tuple[Rig, tuple[str, ...]]:
    """The rig with the cameras of which only the lens is known, where the format has a place for them; and who they
    are that it has none for."""
    alone = [camera for _, camera in rig.lens_only]
    if form.lenses:
        return replace(rig, cameras=(*rig.cameras, *alone)), ()
    names = ", ".join(camera.name for camera in alone)
    return rig, (f"{name} holds no camera without a pose: without {names}",) if alone and name != "json" else ()


def _is_ideal(lens: Intrinsics) -> bool:
    return lens.model == "pinhole" and np.array_equal(lens.parameters, ideal_lens(lens).parameters)


def _renamed(rig: Rig, form: Format, name: str, base: str) -> tuple[Rig, tuple[str, ...]]:
    """The rig with names that the format can hold, and what was changed."""
    old = [camera.name for camera in rig.cameras]
    new = form.names([_readable(name) for name in old])
    still = [placed.name for placed in rig.rectangles]
    # The base's name and those of the cameras' frames are taken before a rectangle's.
    taken = [base, *new, *(f"{name}_{frame}" for name in new for frame in FRAMES)]
    others = plain_names([*taken, *still])[len(taken) :] if form.names is plain_names else [*map(_readable, still)]
    cameras = [replace(camera, name=held) for camera, held in zip(rig.cameras, new, strict=True)]
    rectangles = [
        replace(placed, rectangle=replace(placed.rectangle, name=held))
        for placed, held in zip(rig.rectangles, others, strict=True)
    ]
    # Where a camera and a rectangle share a name, a View's camera and the rig frame are the camera.
    held_as = {**dict(zip(still, others, strict=True)), **dict(zip(old, new, strict=True))}
    views = [replace(fit.view, camera=held_as.get(fit.view.camera, fit.view.camera)) for fit in rig.fits]
    fitted = replace(
        rig,
        reference=held_as.get(rig.reference, rig.reference),
        cameras=tuple(cameras),
        rectangles=tuple(rectangles),
        fits=tuple(replace(fit, view=view) for fit, view in zip(rig.fits, views, strict=True)),
    )
    changed = [(a, b) for a, b in zip([*old, *still], [*new, *others], strict=True) if a != b]
    return fitted, tuple(f"{name} cannot hold the name {a!r}: it is {b!r} there" for a, b in changed)


_FORMATS: dict[str, Format] = {
    "json": Format(
        "cameras and rectangles, with the sigma of every parameter", "Views, verdict", json_files,
        (".json",), read_json, is_rig_json,
    ),
    "opencv": Format("OpenCV's FileStorage, YAML", _DOUBT, opencv_files, (".yml", ".yaml"), read_opencv, is_opencv,
        names=opencv_names,
    ),
    "opencv-xml": Format(
        "OpenCV's FileStorage, XML", _DOUBT, partial(opencv_files, suffix=".xml"), (".xml",), read_opencv,
        names=opencv_names,
    ),
    "opencv-json": Format(
        "OpenCV's FileStorage, JSON", _DOUBT, partial(opencv_files, suffix=".json"),
        (".opencv.json", ".json"), read_opencv, names=opencv_names,
    ),
    "ros": Format(
        "ROS camera_info, a file for each camera", f"poses (urdf, tf), {_DOUBT}", ros_files,
        read=read_camera_info, recognises=is_camera_info, names=plain_names, lenses=True,
    ),
    "urdf": Format(
        "URDF: links and fixed joints", "lenses (ros), sigmas, moving rectangles", urdf_files, (".urdf", ".xacro"),
        read_frames, is_frames, plain_names,
    ),
    "tf": Format(
        "ROS 2 launch file of static transforms", "lenses (ros), sigmas, moving rectangles", tf_files,
        (".launch.xml", ".launch"), read_frames, names=plain_names,
    ),
    "kalibr": Format(
        "Kalibr's camchain", f"k3, {_DOUBT}, a rig frame that is not the first camera's", kalibr_files,
        (".yaml", ".yml"), read_kalibr, is_kalibr, plain_names,
    ),
    "colmap": Format(
        "COLMAP's model as text, with rig and frame", _DOUBT, colmap_files, read=read_colmap, recognises=is_colmap,
        names=plain_names,
    ),
    "colmap-binary": Format(
        "COLMAP's model as binary", f"the unit, {_DOUBT}", colmap_binary_files, read=read_colmap, names=plain_names
    ),
    "anipose": Format("anipose's TOML", _DOUBT, anipose_files, (".anipose.toml", ".toml"), read_toml, is_toml_rig),
    "freemocap": Format(
        "freemocap's TOML, in millimetres", _DOUBT, freemocap_files,
        ("_camera_calibration.toml", ".toml"), read_toml,
    ),
    "pose2sim": Format("Pose2Sim's TOML", _DOUBT, pose2sim_files, ("Calib.toml", ".toml"), read_toml),
    "caliscope": Format(
        "caliscope's TOML", f"names, {_DOUBT}", caliscope_files, ("camera_array.toml", ".toml"), read_toml,
        names=numbered,
    ),
    "nerfstudio": Format(
        "nerfstudio's transforms.json", _DOUBT, nerfstudio_files, ("transforms.json", ".json"), read_nerfstudio,
        is_nerfstudio, plain_names,
    ),
    "mrcal": Format(
        "mrcal's cameramodels, a file for each camera", f"fisheyes, {_DOUBT}", mrcal_files,
        read=read_mrcal, recognises=is_mrcal, names=plain_names,
    ),
    "usd": Format(
        "USD cameras", f"distortion, {_DOUBT}", usd_files, (".usda",), read_usd, is_usd, plain_names, ideal=True
    ),
    "blender": Format(
        "Python script for Blender", f"distortion, {_DOUBT}", blender_files, (".py",), names=plain_names, ideal=True
    ),
    "maps": Format(
        "maps for OpenCV's remap, TIFF", f"poses, {_DOUBT}", opencv_map_files, names=plain_names, lenses=True
    ),
    "ffmpeg": Format(
        "maps for FFmpeg's remap, PGM", f"parts of pixels, poses, {_DOUBT}", ffmpeg_map_files, names=plain_names,
        lenses=True,
    ),
}  # fmt: skip

FORMATS = MappingProxyType(_FORMATS)
"""Every format by its name."""
