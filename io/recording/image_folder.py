"""A folder of images, or the images of a pattern, as one camera's recording."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from glob import glob
from pathlib import Path

import numpy as np

from quadrig.io.recording.decode_image import UndecodableImage, decode_file, read_picture_file
from quadrig.io.recording.image_source import even_batches
from quadrig.io.recording.picture_header import HEADER_BYTES, PictureHeader, read_header
from quadrig.single.arrays import Ints, Picture
from quadrig.single.errors import QuadrigError

IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"}

# A number of sixteen digits or more can only be a time: microseconds (16) or nanoseconds (19) since 1970.
_MICROSECOND_DIGITS = 16
_NANOSECOND_DIGITS = 18


@dataclass(frozen=True, eq=False)
class ImageFiles:
    """Image files in the order of their numbers. numbers (N,): of their names, or 0, 1, 2... where they have none.

    taken (N,): ns since 1970 by EXIF, 0 where it does not say. numbered: whether the names have numbers.
    """

    paths: tuple[Path, ...]
    numbers: Ints
    taken: Ints
    numbered: bool = True

    def __len__(self) -> int:
        return len(self.paths)

    @property
    def encoding(self) -> str:
        """The files' kind: jpg, png..."""
        return self.paths[0].suffix.lower().lstrip(".")

    @property
    def files(self) -> tuple[Path, ...]:
        """As ImageSource has it."""
        return self.paths

    @property
    def timed(self) -> bool:
        """As ImageSource has it: whether the numbers of the names are times."""
        return self._unit() > 0

    def stamps(self) -> Ints:
        """As ImageSource has it: times where the names are times, else image number k at k seconds."""
        return self.numbers * (self._unit() or 10**9)

    def quick_stamps(self) -> Ints:
        """As ImageSource has it."""
        return self.stamps()

    def part(self, indices: Ints) -> "ImageFiles":
        """As ImageSource has it."""
        paths = tuple(self.paths[k] for k in indices)
        return ImageFiles(paths, self.numbers[indices], self.taken[indices], self.numbered)

    def images(self, gray: bool = True, shrink: int = 1) -> Iterator[Picture | None]:
        """As ImageSource has it."""
        for path in self.paths:
            try:
                yield decode_file(read_picture_file(path), gray, shrink)
            except UndecodableImage:
                yield None

    def why_unreadable(self, index: int) -> str:
        """As ImageSource has it."""
        try:
            decode_file(read_picture_file(self.paths[index]))
        except UndecodableImage as error:
            return str(error)
        return ""

    def batches(self, indices: Ints, size: int) -> list[Ints]:
        """As ImageSource has it."""
        return even_batches(indices, size)

    def _unit(self) -> int:
        """Nanoseconds of one in the names' numbers, 0 where those are no times."""
        digits = len(str(int(self.numbers.max(initial=0))))
        return 1 if digits >= _NANOSECOND_DIGITS else 1000 if digits >= _MICROSECOND_DIGITS else 0


def image_files(paths: Sequence[Path], name: str, notes: list[str]) -> ImageFiles:
    """These files as one camera, in the order of the numbers in their names.

    Those of another size than most, or turned otherwise by EXIF, are left out: another size is another lens.
    notes: takes a sentence for each such thing. name: of the camera, in words for a person.
    """
    paths = sorted(paths)
    headers = [file_header(path) for path in paths]
    shapes = Counter((one.size, one.turned) for one in headers if one is not None)
    if shapes:
        most, _ = shapes.most_common(1)[0]
        others = [k for k, one in enumerate(headers) if one is not None and (one.size, one.turned) != most]
        if most[1]:
            notes.append(f"{name}: its pictures are {most[1]}, as their EXIF says; its lens is that of such pictures")
        if others:
            notes.append(f"{name}: {_another(len(others), paths[others[0]], headers[others[0]], most)}")
        keep = [k for k in range(len(paths)) if k not in set(others)]
        paths, headers = [paths[k] for k in keep], [headers[k] for k in keep]
    numbers = _numbers([path.stem for path in paths])
    if numbers is None and _several_cameras([path.stem for path in paths]):
        notes.append(
            f"{name}: the last number in its files' names repeats; where there are several cameras in one folder, "
            "give a pattern: 'FOLDER/camera_{camera}_*.jpg'"
        )
    taken = np.array([(one.taken if one is not None else None) or 0 for one in headers], np.int64)
    given = np.arange(len(paths), dtype=np.int64) if numbers is None else numbers
    order = np.argsort(given, kind="stable")
    return ImageFiles(tuple(paths[k] for k in order), given[order], taken[order], numbers is not None)


def _another(count: int, path: Path, header: PictureHeader | None, most: tuple[tuple[int, int], str]) -> str:
    assert header is not None
    (width, height), turned = most
    shape = f"{header.size[0]}x{header.size[1]}, not {width}x{height}"
    if header.size == (width, height):
        shape = f"{header.turned or 'upright'} by its EXIF, not {turned or 'upright'}"
    if count == 1:
        return f"1 picture of another size is left out ({path.name} is {shape})"
    return f"{count} pictures of another size are left out (the first, {path.name}, is {shape})"


def file_header(path: Path) -> PictureHeader | None:
    """What a file says of itself, None where it is no picture."""
    try:
        with path.open("rb") as stream:
            begin = stream.read(HEADER_BYTES)
            try:
                return read_header(begin)
            except ValueError:
                return read_header(read_picture_file(path)) if len(begin) == HEADER_BYTES else None
    except (OSError, ValueError):
        return None


def one_image(path: Path) -> ImageFiles:
    """One image as a camera. Such images are of one instant, whatever numbers their names bear."""
    return ImageFiles((path,), np.zeros(1, np.int64), np.zeros(1, np.int64))


def pattern_images(pattern: Path) -> dict[str, list[Path]]:
    """The image files of each camera that a pattern such as pictures/camera_{camera}_*.jpg matches.

    {camera} stands for the camera's name, without slashes; * and ? are those of a shell.
    """
    text = str(pattern)
    pieces = {"{camera}": "(?P<camera>[^/]+?)", "*": "[^/]*", "?": "[^/]"}
    expression = "".join(pieces.get(part, re.escape(part)) for part in re.split(r"(\{camera\}|\*|\?)", text))
    # A second {camera} is the same name again.
    first, camera, rest = expression.partition(pieces["{camera}"])
    matches = re.compile(first + camera + rest.replace(camera, "(?P=camera)"))
    cameras: dict[str, list[Path]] = {}
    for found in sorted(glob(text.replace("{camera}", "*"))):
        match = matches.fullmatch(found)
        if match is not None and Path(found).suffix.lower() in IMAGE_SUFFIXES:
            cameras.setdefault(match["camera"], []).append(Path(found))
    return cameras


def folder_images(folder: Path) -> list[Path]:
    """The image files in a folder, not those of its subfolders."""
    files = (p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith("."))
    # What is a pipe would be waited for.
    return sorted(p for p in files if p.is_file())


def read_image_folder(folder: Path, notes: list[str]) -> ImageFiles:
    """The images of a folder as one camera; notes: as image_files has it. Raises QuadrigError where it has none."""
    paths = folder_images(folder)
    if not paths:
        kinds = ", ".join(sorted(suffix.lstrip(".") for suffix in IMAGE_SUFFIXES))
        raise QuadrigError(f"{folder}: no image in this folder; give a folder with {kinds} files")
    return image_files(paths, f"camera {folder.name!r}", notes)


def _numbers(stems: Sequence[str]) -> Ints | None:
    """The number that distinguishes the images: the last group of digits that differs in every one; None without."""
    groups = [re.findall(r"\d+", stem) for stem in stems]
    counts = {len(group) for group in groups}
    if len(counts) == 1:
        for column in range(counts.pop() - 1, -1, -1):
            values = [int(group[column]) for group in groups]
            if len(set(values)) == len(values) and max(values) < 2**63:
                return np.array(values, np.int64)
    return None


def _several_cameras(stems: Sequence[str]) -> bool:
    """Whether each of the last numbers in the names comes as often as every other, more than once."""
    last = Counter((re.findall(r"\d+", stem) or [""])[-1] for stem in stems)
    return len(last) > 1 and min(last.values()) > 1 and len(set(last.values())) == 1
