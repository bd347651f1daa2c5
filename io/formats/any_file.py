"""Rigs and lenses out of files of any format: known by what is in them."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
import yaml

from quadrig.io.formats.format import Held, rig_of
from quadrig.io.formats.registry import FORMATS
from quadrig.io.recording.messages.mcap_reader import is_mcap
from quadrig.io.rig_file.rig_mcap import read_rig
from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics
from quadrig.single.lens_prior import LensEvidence
from quadrig.single.pose import Pose

# Enough of a file to know it by: what distinguishes formats stands in the first camera.
_HEAD = 1 << 16
# A rig of a thousand cameras with its covariance is smaller; what is larger was not meant for this.
_LARGEST_FILE = 1 << 28
_DAMAGE = (
    *(ValueError, LookupError, TypeError, AttributeError, ArithmeticError, SyntaxError, RecursionError, MemoryError),
    *(msgspec.MsgspecError, yaml.YAMLError, cv2.error),
)


@dataclass(frozen=True, eq=False)
class KnownLens:
    """A lens known before, and its covariance (9, 9) in the order of LENS_PARAMETERS: nan where it is not known, zero
    along parameters that were held. evidence: what Views said of it, where the file has that."""

    intrinsics: Intrinsics
    covariance: Floats
    evidence: LensEvidence | None = None


def read_any_rig(*paths: Path | str, unit: float | None = None, size: tuple[int, int] | None = None) -> Rig:
    """The Rig of a rig.mcap, or of files of any format that quadrig reads; several files say each their part.

    unit: metres of one unit of lengths, size: width and height of the pictures, for files that do not say them.
    Covariances are nan where the files do not state them. Raises QuadrigError, one sentence, where a file is absent,
    damaged or of no known format, where nothing says unit or size, or where a camera has a lens and no pose.
    """
    held = _read_all(paths, unit, size)
    if held.rig is not None:
        return held.rig
    _refuse_unplaced(held, paths[0])
    return rig_of(held.lenses, held.poses, held.frame)


def read_any_lenses(*paths: Path | str, size: tuple[int, int] | None = None) -> dict[str, KnownLens]:
    """The lenses of cameras by name, from the same files, which may lack poses. Errors are those of read_any_rig."""
    held = _read_all(paths, 1.0, size)
    if held.rig is not None:
        known = [*((held.rig, camera) for camera in held.rig.cameras), *held.rig.lens_only]
        return {
            one.name: KnownLens(one.intrinsics, rig.lens_covariance(one.name), one.lens_evidence)
            for rig, one in known
        }
    if not held.lenses:
        raise QuadrigError(f"{paths[0]}: it holds no lens; give a file of lenses")
    return {name: KnownLens(lens, np.full((9, 9), np.nan)) for name, lens in held.lenses.items()}


def _read_all(paths: tuple[Path | str, ...], unit: float | None, size: tuple[int, int] | None) -> Held:
    files, each = [Path(path) for path in paths], []
    try:
        files = [file for path in files for file in _files_of(path)]
        for file in files:
            each.append(_read(file))
    except OSError as error:
        raise QuadrigError(f"{error.filename}: cannot be read ({error.strerror or error}); give another") from error
    if len(each) == 1 and each[0].rig is not None:
        return each[0]
    if any(held.rig is not None for held in each):
        raise QuadrigError(f"{paths[0]}: a file that holds a whole rig is read alone; give one file")
    placing = [file for file, held in zip(files, each, strict=True) if held.poses]
    # Files of one camera each are a set, as mrcal writes it; two of several are two rigs, each in a frame of its own.
    if len(placing) > 1 and any(len(held.poses) > 1 for held in each):
        raise QuadrigError(f"{placing[1]}: poses are in {placing[0]} too, in a frame of its own; give one of the two")
    lenses, poses = {}, {}
    for file, held in zip(files, each, strict=True):
        each_part = (lenses, _with_size(held, size, file)), (poses, _in_metres(held, unit, file))
        for mine, theirs in each_part:
            twice = sorted(mine.keys() & theirs.keys())
            if twice:
                raise QuadrigError(f"{file}: camera {twice[0]!r} is in an earlier file too; give each camera once")
            mine.update(theirs)
    return Held(lenses, poses, next((held.frame for held in each if held.frame), ""))


def _files_of(path: Path) -> list[Path]:
    """A path itself; of a folder that is no format's own, the files in it that are of some format."""
    if not path.is_dir() or _format_of(path, b"") is not None:
        return [path]
    files = sorted(file for file in path.iterdir() if file.is_file() and 0 < file.stat().st_size < _LARGEST_FILE)
    return [file for file in files if _format_of(file, _head(file)) is not None] or [path]


def _format_of(path: Path, head: bytes) -> str | None:
    found = (name for name, form in FORMATS.items() if form.read is not None and form.recognises(path, head))
    return next(found, None)


def _with_size(held: Held, size: tuple[int, int] | None, path: Path | str) -> dict[str, Intrinsics]:
    if size is None and any(lens.width == 0 or lens.height == 0 for lens in held.lenses.values()):
        raise QuadrigError(f"{path}: nothing in it says the size of the pictures; give --size, such as 1920x1080")
    return {
        name: replace(lens, width=size[0], height=size[1]) if size and not (lens.width and lens.height) else lens
        for name, lens in held.lenses.items()
    }


def _in_metres(held: Held, unit: float | None, path: Path | str) -> dict[str, Pose]:
    metres = unit if held.unit is None else held.unit
    if metres is None:
        if not held.poses:
            return {}
        raise QuadrigError(f"{path}: nothing in it says the unit of lengths; `rig import` it with --unit m, cm or mm")
    if not 0 < metres < np.inf:
        raise QuadrigError(
            f"{path}: its unit of lengths is {metres:g} m, which is none; give the file its unit again"
        )
    for name, pose in held.poses.items():
        if not np.isfinite(pose.matrix()).all():
            raise QuadrigError(f"{path}: the pose of {name!r} is not made of finite numbers; write the file again")
    return {name: replace(pose, translation=pose.translation * metres) for name, pose in held.poses.items()}


def _read(path: Path) -> Held:
    if not path.exists():
        raise QuadrigError(f"there is no {path}; give a rig.mcap, or a file of another program (docs/formats.md)")
    if path.is_file() and is_mcap(path):
        return Held(rig=read_rig(path))
    name = _format_of(path, b"" if path.is_dir() else _head(path))
    reader = None if name is None else FORMATS[name].read
    if reader is None:
        known = ", ".join(name for name, form in FORMATS.items() if form.read is not None)
        what = "folder" if path.is_dir() else "file"
        raise QuadrigError(f"{path}: the {what} is in none of the formats that quadrig reads: rig.mcap, {known}")
    try:
        with np.errstate(all="ignore"):
            return reader(path)
    # Damage shows as whatever the parsers of YAML, JSON, TOML, XML and USD stumble over.
    except _DAMAGE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise QuadrigError(f"{path}: cannot be read as {name} ({reason}); write it again") from error


def _head(path: Path) -> bytes:
    size = path.stat().st_size
    if not 0 < size < _LARGEST_FILE and path.suffix != ".bin":
        raise QuadrigError(f"{path}: has {size} bytes, which no file of cameras has; give the file of a rig")
    with path.open("rb") as stream:
        return stream.read(_HEAD)


def _refuse_unplaced(held: Held, path: Path | str) -> None:
    without = [name for name in held.lenses if name not in held.poses]
    if without or not held.lenses:
        what = f"camera {without[0]!r} has a lens and no pose" if without else "no camera has a lens"
        raise QuadrigError(f"{path}: {what}; give the file with its {'pose' if without else 'lens'} too")
