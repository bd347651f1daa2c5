"""USD cameras (usda text), under a prim /Rig that carries the rig frame into a world with y up; in metres.

A USD camera looks along -z with y up and knows no distortion; its aperture is the picture, from corner to corner.
"""

import json
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from quadrig.io.formats.format import GRAPHICS, HALF_PIXEL, Files, Held, Options, camera_matrix, lens_of, pose_of
from quadrig.rig.result import Camera, Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics
from quadrig.single.pose import Pose

# Width of the film that every camera is given, in tenths of a scene unit as USD counts it: only ratios show.
_APERTURE = 0.36


def usd_files(rig: Rig, _options: Options) -> Files:
    """rig.usda. The rig's lenses have no distortion, as `ideal` says."""
    cameras = "".join(_prim(camera) for camera in rig.cameras)
    return {
        "rig.usda": '#usda 1.0\n(\n    defaultPrim = "Rig"\n    metersPerUnit = 1\n    upAxis = "Y"\n)\n\n'
        f'def Xform "Rig"\n{{\n{_transform(GRAPHICS)}{cameras}}}\n'
    }


def _prim(camera: Camera) -> str:
    lens = camera.intrinsics
    height = _APERTURE * lens.height / lens.width
    across, down = (lens.principal_point + HALF_PIXEL) / (lens.width, lens.height) - 0.5
    values = {
        "float horizontalAperture": _APERTURE,
        "float verticalAperture": height,
        "float horizontalApertureOffset": -across * _APERTURE,
        "float verticalApertureOffset": down * height,
        "float focalLength": lens.focal * _APERTURE / lens.width,
        "float2 clippingRange": (0.01, 1000.0),
        "custom int2 quadrig:imageSize": (lens.width, lens.height),
        "custom string quadrig:name": camera.name,
    }
    lines = "".join(f"        {key} = {_usda(value)}\n" for key, value in values.items())
    pose = _transform(camera.rig_from_camera @ GRAPHICS, "        ")
    return f'\n    def Camera "{camera.name}"\n    {{\n{lines}{pose}    }}\n'


def _transform(pose: Pose, indent: str = "    ") -> str:
    """USD multiplies rows from the left, so that its matrices are ours transposed."""
    rows = ", ".join(_usda(tuple(row)) for row in pose.matrix().T.tolist())
    order = f'{indent}uniform token[] xformOpOrder = ["xformOp:transform"]\n'
    return f"{indent}matrix4d xformOp:transform = ({rows})\n{order}"


def _usda(value: object) -> str:
    match value:
        case tuple():
            return f"({', '.join(_usda(each) for each in value)})"
        case str():
            return json.dumps(value, ensure_ascii=False)
        case _:
            return repr(float(value) if isinstance(value, np.floating) else value)


def is_usd(path: Path, head: bytes) -> bool:
    """Whether a file is USD, as text, as crate or as archive."""
    return head.startswith((b"#usda", b"PXR-USDC")) or path.suffix.lower() == ".usdz"


def read_usd(path: Path) -> Held:
    """Lenses and poses of the stage's cameras, in the frame of /Rig or else of its world.

    Raises QuadrigError where usd-core is not installed, or a camera does not say its picture's size.
    """
    try:
        # Its modules have no types.
        tf, usd = (import_module(f"pxr.{name}") for name in ("Tf", "Usd"))
    except ImportError as error:
        raise QuadrigError(f"{path}: USD needs usd-core; install it with: pip install 'quadrig[usd]'") from error
    try:
        return _read_stage(usd.Stage.Open(str(path)), path)
    except tf.ErrorException as error:
        raise ValueError("it is no USD stage, or a damaged one") from error


def _read_stage(stage: Any, path: Path) -> Held:
    usd, geometry = (import_module(f"pxr.{name}") for name in ("Usd", "UsdGeom"))
    places = geometry.XformCache(usd.TimeCode.EarliestTime())
    carrier = stage.GetPrimAtPath("/Rig")
    world_from_rig = np.array(places.GetLocalToWorldTransform(carrier)).T if carrier else np.eye(4)
    lenses, poses = {}, {}
    for prim in stage.Traverse():
        if prim.IsA(geometry.Camera):
            size, name = prim.GetAttribute("quadrig:imageSize").Get(), prim.GetAttribute("quadrig:name").Get()
            name, where = name or prim.GetName(), f"{path}: camera {prim.GetPath()}"
            if size is None:
                raise QuadrigError(f"{where} does not say its picture's size; give it an int2 quadrig:imageSize")
            seen = geometry.Camera(prim).GetCamera(usd.TimeCode.EarliestTime())
            lenses[name] = _lens_of(seen, (size[0], size[1]), where)
            world_from_graphics = np.array(places.GetLocalToWorldTransform(prim)).T
            rig_from_graphics = np.asarray(np.linalg.solve(world_from_rig, world_from_graphics), float)
            poses[name] = pose_of(rig_from_graphics, where) @ GRAPHICS
    metres = geometry.GetStageMetersPerUnit(stage) if geometry.StageHasAuthoredMetersPerUnit(stage) else None
    return Held(lenses, poses, unit=metres)


def _lens_of(seen: Any, size: tuple[int, int], where: str) -> Intrinsics:
    width, height = size
    across, down = seen.horizontalAperture / width, seen.verticalAperture / height
    middle = np.array([width, height]) / 2 - HALF_PIXEL
    offset = np.array([-seen.horizontalApertureOffset / across, seen.verticalApertureOffset / down])
    cx, cy = middle + offset
    return lens_of(size, camera_matrix(seen.focalLength / across, seen.focalLength / down, cx, cy), (), where)
