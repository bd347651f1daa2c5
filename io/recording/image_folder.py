"""A folder of images, or the images of a pattern, as one camera's recording."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from quadrig.io.recording.decode_image import UndecodableImage, decode_file
from quadrig.io.recording.image_source import even_batches
from quadrig.single.arrays import Ints, Picture
from quadrig.single.errors import QuadrigError

IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"}

# A number of sixteen digits or more can only be a time: microseconds (16) or nanoseconds (19) since 1970.
_MICROSECOND_DIGITS = 16
_NANOSECOND_DIGITS = 18


@dataclass(frozen=True, eq=False)
class ImageFiles:
    """Image files in the order of their numbers. numbers (N,): of their names, or 0, 1, 2... where they have none."""

    paths: tuple[Path, ...]
    numbers: Ints

    def __len__(self) -> int:
        return len(self.paths)

    @property
    def encoding(self) -> str:
        """The files' kind: jpg, png..."""
        return self.paths[0].suffix.lower().lstrip(".")

    def stamps(self) -> Ints:
        """As ImageSource has it: times where the names are times, else image number k at k seconds."""
        digits = len(str(int(self.numbers.max(initial=0))))
        if digits >= _NANOSECOND_DIGITS:
            return self.numbers
        return self.numbers * (1000 if digits >= _MICROSECOND_DIGITS else 10**9)

    def quick_stamps(self) -> Ints:
        """As ImageSource has it."""
        return self.stamps()

    def part(self, indices: Ints) -> "ImageFiles":
        """As ImageSource has it."""
        return ImageFiles(tuple(self.paths[k] for k in indices), self.numbers[indices])

    def images(self, gray: bool = True, shrink: int = 1) -> Iterator[Picture | None]:
        """As ImageSource has it."""
        for path in self.paths:
            try:
                yield decode_file(path.read_bytes(), gray, shrink)
            except (UndecodableImage, OSError):
                yield None

    def batches(self, indices: Ints, size: int) -> list[Ints]:
        """As ImageSource has it."""
        return even_batches(indices, size)


def image_files(paths: Sequence[Path]) -> ImageFiles:
    """These files as one camera, in the order of the numbers in their names.

    Image k of every camera is the same instant; where one lacks a number, that instant lacks that camera.
    """
    paths = sorted(paths)
    numbers = _numbers([path.stem for path in paths])
    order = np.argsort(numbers, kind="stable")
    return ImageFiles(tuple(paths[k] for k in order), numbers[order])


def one_image(path: Path) -> ImageFiles:
    """One image as a camera. Such images are of one instant, whatever numbers their names bear."""
    return ImageFiles((path,), np.zeros(1, np.int64))


def folder_images(folder: Path) -> list[Path]:
    """The image files in a folder, not those of its subfolders."""
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and not p.name.startswith("."))


def read_image_folder(folder: Path) -> ImageFiles:
    """The images of a folder as one camera. Raises QuadrigError where it has none."""
    paths = folder_images(folder)
    if not paths:
        kinds = ", ".join(sorted(suffix.lstrip(".") for suffix in IMAGE_SUFFIXES))
        raise QuadrigError(f"{folder}: no image in this folder; give a folder with {kinds} files")
    return image_files(paths)


def _numbers(stems: Sequence[str]) -> Ints:
    """The number that distinguishes the images: the last group of digits that differs in every one."""
    groups = [re.findall(r"\d+", stem) for stem in stems]
    counts = {len(group) for group in groups}
    if len(counts) == 1:
        for column in range(counts.pop() - 1, -1, -1):
            values = [int(group[column]) for group in groups]
            if len(set(values)) == len(values) and max(values) < 2**63:
                return np.array(values, np.int64)
    return np.arange(len(stems), dtype=np.int64)
