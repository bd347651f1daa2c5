"""COLMAP's text model. Its images hold cam_from_world (our camera_from_rig) as QW QX QY QZ TX TY TZ, and its pixels
begin at the corner of the top-left pixel, so that its principal points are half a pixel larger than ours."""

from quadrig.io.formats.format import Options
from quadrig.rig.result import Camera, Rig

_HALF_PIXEL = 0.5


def colmap_files(rig: Rig, _options: Options) -> dict[str, str]:
    """cameras.txt, images.txt (one image for each camera, by its name) and an empty points3D.txt."""
    cameras = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    images = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[] as (X, Y, POINT3D_ID)"]
    for number, camera in enumerate(rig.cameras, start=1):
        cameras.append(f"{number} {_lens(camera)}")
        camera_from_rig = camera.rig_from_camera.inverse()
        x, y, z, w = camera_from_rig.quaternion().tolist()
        numbers = " ".join(repr(value) for value in [w, x, y, z, *camera_from_rig.translation.tolist()])
        images += [f"{number} {numbers} {number} {camera.name}.jpg", ""]
    return {
        "cameras.txt": "\n".join([*cameras, ""]),
        "images.txt": "\n".join([*images, ""]),
        "points3D.txt": "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n",
    }


def _lens(camera: Camera) -> str:
    """FULL_OPENCV holds k1 k2 p1 p2 k3 k4 k5 k6, of which ours are the first five; OPENCV_FISHEYE k1 to k4."""
    lens = camera.intrinsics
    k, matrix = lens.distortion.tolist(), lens.camera_matrix
    head = [matrix[0, 0], matrix[1, 1], matrix[0, 2] + _HALF_PIXEL, matrix[1, 2] + _HALF_PIXEL]
    model, tail = ("FULL_OPENCV", [*k, 0.0, 0.0, 0.0]) if lens.model == "pinhole" else ("OPENCV_FISHEYE", k[:4])
    numbers = " ".join(repr(float(value)) for value in [*head, *tail])
    return f"{model} {lens.width} {lens.height} {numbers}"
