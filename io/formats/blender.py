"""A Python script that makes the rig's cameras in Blender, under an empty that turns the rig frame by half a turn
about x, so that its y, which often points down, points up. A camera there looks along -z with y up and knows no
distortion."""

from typing import Any

from quadrig.io.formats.format import GRAPHICS, HALF_PIXEL, Files, Options
from quadrig.rig.result import Camera, Rig

# The film that every camera is given, mm: full frame, as Blender does itself.
_SENSOR = 36.0

_SCRIPT = '''"""The cameras of a rig for Blender, in metres: blender --python rig_blender.py

A scene for each size of picture, with the size set; lenses have no distortion: show them undistorted pictures.
"""

import bpy
from mathutils import Matrix

WORLD_FROM_RIG = {world}
CAMERAS = {cameras}

carriers = {{}}
for camera in CAMERAS:
    width, height = camera["size"]
    if (width, height) not in carriers:
        scene = bpy.context.scene if not carriers else bpy.data.scenes.new(f"{{width}}x{{height}}")
        scene.render.resolution_x, scene.render.resolution_y = width, height
        scene.render.resolution_percentage = 100
        scene.render.pixel_aspect_x = scene.render.pixel_aspect_y = 1.0
        rig = bpy.data.objects.new("rig", None)
        rig.matrix_world = Matrix(WORLD_FROM_RIG)
        scene.collection.objects.link(rig)
        carriers[width, height] = scene, rig
    scene, rig = carriers[width, height]
    lens = bpy.data.cameras.new(camera["name"])
    lens.sensor_fit = "HORIZONTAL"
    lens.sensor_width = {sensor}
    lens.lens_unit = "MILLIMETERS"
    lens.lens = camera["lens"]
    lens.shift_x, lens.shift_y = camera["shift"]
    held = bpy.data.objects.new(camera["name"], lens)
    held.parent = rig
    held.matrix_local = Matrix(camera["rig_from_camera"])
    scene.collection.objects.link(held)
    if scene.camera is None or scene.camera.name not in {{each["name"] for each in CAMERAS}}:
        scene.camera = held
'''


def blender_files(rig: Rig, _options: Options) -> Files:
    """rig_blender.py. The rig's lenses have no distortion, as `ideal` says."""
    cameras = "[\n" + "".join(f"    {_values(camera)!r},\n" for camera in rig.cameras) + "]"
    world = GRAPHICS.matrix().tolist()
    return {"rig_blender.py": _SCRIPT.format(world=world, cameras=cameras, sensor=_SENSOR)}


def _values(camera: Camera) -> dict[str, Any]:
    """Blender shifts the film in parts of its width, also upwards."""
    lens = camera.intrinsics
    right, down = lens.principal_point + HALF_PIXEL
    return {
        "name": camera.name,
        "size": (lens.width, lens.height),
        "lens": lens.focal * _SENSOR / lens.width,
        "shift": (float(0.5 - right / lens.width), float((down - lens.height / 2) / lens.width)),
        "rig_from_camera": (camera.rig_from_camera @ GRAPHICS).matrix().tolist(),
    }
