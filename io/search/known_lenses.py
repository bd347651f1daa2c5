"""Lenses known before a recording, from files of any format: what is known of its cameras beside its pictures."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from quadrig.io.formats.any_file import KnownLens, read_any_lenses
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError


def read_known_lenses(files: Sequence[str]) -> dict[str, KnownLens]:
    """The lenses of files by camera, each FILE, or NAME=FILE where the one lens of a file is that of camera NAME.

    Raises QuadrigError where a file cannot be read, has several lenses for one NAME, or a camera is in two files.
    """
    lenses: dict[str, KnownLens] = {}
    for text in files:
        name, _, path = text.rpartition("=") if not Path(text).exists() else ("", "", text)
        found = read_any_lenses(path)
        if name and len(found) > 1 and name not in found:
            raise QuadrigError(f"{path}: has the lenses of {', '.join(found)}; give one of one lens for {name}")
        if name:
            found = {name: found.get(name) or next(iter(found.values()))}
        twice = sorted(lenses.keys() & found.keys())
        if twice:
            raise QuadrigError(f"{path}: camera {twice[0]!r} is in an earlier file too; give each lens once")
        lenses |= found
    return lenses


def with_known_lenses(
    inputs: Sequence[CameraInput], lenses: Mapping[str, KnownLens], keep: bool = False
) -> tuple[list[CameraInput], list[str]]:
    """The cameras with the lenses that are known of them, and a sentence for each whose doubt is not known.

    keep: as they are, not to be estimated. Raises QuadrigError where none is of these cameras, or one is of another
    size of picture.
    """
    if lenses and not any(camera.name in lenses for camera in inputs):
        raise QuadrigError(
            f"the lenses given are of {', '.join(lenses)}, the cameras are {', '.join(c.name for c in inputs)}; "
            "give a lens as NAME=FILE, with the camera's name"
        )
    known, notes = [], []
    for camera in inputs:
        lens = lenses.get(camera.name)
        if lens is None:
            known.append(camera)
            continue
        size = (lens.intrinsics.width, lens.intrinsics.height)
        if size != (camera.width, camera.height):
            raise QuadrigError(
                f"camera {camera.name!r} has pictures of {camera.width}x{camera.height}, its lens is known for "
                f"{size[0]}x{size[1]}; give a lens for this size"
            )
        # What Views said is for a lens that is estimated with it; one that is kept is held against its own doubt.
        evidence = None if keep else lens.evidence
        covariance = None if evidence is not None else _stated(lens.covariance)
        if evidence is None and covariance is None and not keep:
            notes.append(
                f"camera {camera.name!r}: its file does not say how sure its lens is, which is a first guess"
            )
        known.append(
            replace(
                camera,
                intrinsics=lens.intrinsics,
                lens_covariance=covariance,
                lens_evidence=evidence,
                fixed=keep,
            )
        )
    kept = ", ".join(camera.name for camera in known if keep and camera.name in lenses)
    if kept:
        notes.append(f"the lenses of {kept} are kept as they are: no sigma holds their doubt")
    return known, notes


def _stated(covariance: Floats) -> Floats | None:
    """A covariance (9, 9) that claims no more than a file states; None where it states no sigmas."""
    if np.isfinite(covariance).all():
        return covariance
    variance = np.diag(covariance)
    if not np.isfinite(variance).all():
        return None
    # However the parameters hang together, their covariance is no larger than their number times its diagonal.
    return np.diag(variance * np.count_nonzero(variance))
