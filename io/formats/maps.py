"""Where each pixel of an undistorted picture lies in the picture as it was taken, for OpenCV's and FFmpeg's remap."""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from quadrig.io.formats.format import Files, Options
from quadrig.rig.result import CAMERA_PARAMETERS, Rig
from quadrig.single.arrays import Floats
from quadrig.single.lens import LENS_PARAMETERS, Intrinsics

# FFmpeg's remap takes whole pixels; a place outside of every picture is left empty.
_NOWHERE = 65535
_OUTSIDE = -1e4
# The inverse of a lens is found to 1e-9; a second ray of the same pixel lies whole degrees away.
_SAME_RAY = 1e-6


def ideal_lens(lens: Intrinsics) -> Intrinsics:
    """The pinhole of undistorted pictures: the same size, focal along x and principal point, and square pixels."""
    return replace(lens, distortion=np.zeros(5), aspect=1.0, model="pinhole")


def ideal_rig(rig: Rig) -> Rig:
    """The rig as undistorted pictures show it. How far those are from a pinhole is not known: nan."""
    covariance = rig.covariance.copy()
    lens = np.arange(len(covariance)) % CAMERA_PARAMETERS < len(LENS_PARAMETERS)
    covariance[lens] = covariance[:, lens] = np.nan
    cameras = tuple(replace(one, intrinsics=ideal_lens(one.intrinsics)) for one in rig.cameras)
    return replace(rig, cameras=cameras, covariance=covariance, apart=tuple(map(ideal_rig, rig.apart)))


def undistortion_map(lens: Intrinsics) -> Floats:
    """Pixels (H, W, 2) of the picture as taken for each pixel of the undistorted one; nan where it shows nothing."""
    across, down = np.meshgrid(np.arange(lens.width, dtype=float), np.arange(lens.height, dtype=float))
    rays = ideal_lens(lens).unproject(np.stack([across, down], axis=-1))
    places = lens.project(rays)
    inside = np.all((places >= -1) & (places <= (lens.width, lens.height)), axis=-1)
    # Past the angle where its polynomial turns back, a lens would show the picture's edge a second time.
    back = lens.unproject(places[inside])
    inside[inside] = np.abs(back - rays[inside]).max(axis=-1, initial=0.0) < _SAME_RAY
    return np.where(inside[..., None], places, np.nan)


def remap_tables(lens: Intrinsics) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Columns and rows (H, W) as cv2.remap takes them; far outside of the picture where it shows nothing."""
    places = np.nan_to_num(undistortion_map(lens), nan=_OUTSIDE).astype(np.float32)
    return np.ascontiguousarray(places[..., 0]), np.ascontiguousarray(places[..., 1])


def opencv_map_files(rig: Rig, _options: Options) -> Files:
    """NAME_x.tiff and NAME_y.tiff of each camera, float32, as cv2.remap takes them after cv2.imread unchanged."""
    files: Files = {}
    for camera in rig.cameras:
        for letter, table in zip("xy", remap_tables(camera.intrinsics), strict=True):
            files[f"{camera.name}_{letter}.tiff"] = _encoded(".tiff", table)
    return files


def ffmpeg_map_files(rig: Rig, _options: Options) -> Files:
    """NAME_x.pgm and NAME_y.pgm of each camera, 16 bits, for: ffmpeg -i in -i x.pgm -i y.pgm -lavfi remap out."""
    files: Files = {}
    for camera in rig.cameras:
        lens = camera.intrinsics
        places = np.nan_to_num(np.rint(undistortion_map(lens)), nan=-1.0)
        inside = np.all((places >= 0) & (places < (lens.width, lens.height)), axis=-1)
        whole = np.where(inside[..., None], places, _NOWHERE).astype(np.uint16)
        for axis, letter in enumerate("xy"):
            files[f"{camera.name}_{letter}.pgm"] = _encoded(".pgm", whole[..., axis])
    return files


def _encoded(suffix: str, values: np.ndarray) -> bytes:
    done, content = cv2.imencode(suffix, np.ascontiguousarray(values))
    assert done
    return content.tobytes()
