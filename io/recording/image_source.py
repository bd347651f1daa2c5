"""Where a camera's images come from: a topic, a video, a folder. Small to send to another process."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from quadrig.io.recording.decode_image import decode_image
from quadrig.io.recording.messages.mcap_messages import McapMessages
from quadrig.single.arrays import Ints, Picture


class ImageSource(Protocol):
    """The images of one camera in the order of their arrival.

    Frozen and picklable: a part of it is what a worker process gets.
    """

    def __len__(self) -> int: ...

    @property
    def encoding(self) -> str:
        """How the images are stored: jpeg, png, bgr8, h264..."""
        ...

    @property
    def timed(self) -> bool:
        """Whether a clock gave the stamps, not the order of files."""
        ...

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that hold the images."""
        ...

    def stamps(self) -> Ints:
        """Time of each image (N,) int64 ns: the message's own stamp, else the time of its recording."""
        ...

    def quick_stamps(self) -> Ints:
        """As stamps, but of what needs no reading of the images: the time of recording may have to do."""
        ...

    def part(self, indices: Ints) -> "ImageSource":
        """The images of these rising indices alone."""
        ...

    def images(self, gray: bool = True, shrink: int = 1) -> Iterator[Picture | None]:
        """Every image (H, W) or (H, W, 3) BGR uint8 in turn, one in memory at a time; None where it is unreadable.

        shrink: at 1/2, 1/4 or 1/8 of its size, for a quick look.
        """
        ...

    def why_unreadable(self, index: int, /) -> str:
        """Why an image is None among images(), in words; "" where it is none, or only what is around it says why."""
        ...

    def batches(self, indices: Ints, size: int) -> list[Ints]:
        """Split rising indices into parts of about `size`, where the images can be entered well."""
        ...


def even_batches(indices: Ints, size: int) -> list[Ints]:
    """Parts of `size` indices."""
    return [indices[start : start + size] for start in range(0, len(indices), size)]


@dataclass(frozen=True, eq=False)
class McapImages:
    """Images of a topic, each by itself in one message."""

    messages: McapMessages
    encoding: str
    timed: bool = True

    def __len__(self) -> int:
        return len(self.messages)

    @property
    def files(self) -> tuple[Path, ...]:
        """As ImageSource has it."""
        return self.messages.paths

    def stamps(self) -> Ints:
        """As ImageSource has it."""
        return self.messages.stamps()

    def quick_stamps(self) -> Ints:
        """As ImageSource has it."""
        return self.messages.quick_stamps()

    def part(self, indices: Ints) -> "McapImages":
        """As ImageSource has it."""
        return McapImages(self.messages.part(indices), self.encoding)

    def images(self, gray: bool = True, shrink: int = 1) -> Iterator[Picture | None]:
        """As ImageSource has it."""
        with self.messages.opened() as opened:
            for index in range(len(self)):
                try:
                    yield decode_image(opened.image(index), gray, shrink)
                except ValueError:
                    yield None

    def why_unreadable(self, index: int) -> str:
        """As ImageSource has it."""
        try:
            with self.messages.opened() as opened:
                decode_image(opened.image(index))
        except ValueError as error:
            return str(error)
        return ""

    def batches(self, indices: Ints, size: int) -> list[Ints]:
        """As ImageSource has it."""
        return even_batches(indices, size)


@dataclass(frozen=True, eq=False)
class Stamped:
    """A source with other time stamps (N,) int64 ns."""

    source: ImageSource
    given: Ints
    timed: bool = True

    def __len__(self) -> int:
        return len(self.source)

    @property
    def encoding(self) -> str:
        """As ImageSource has it."""
        return self.source.encoding

    @property
    def files(self) -> tuple[Path, ...]:
        """As ImageSource has it."""
        return self.source.files

    def stamps(self) -> Ints:
        """As ImageSource has it."""
        return self.given

    def quick_stamps(self) -> Ints:
        """As ImageSource has it."""
        return self.given

    def part(self, indices: Ints) -> "Stamped":
        """As ImageSource has it."""
        return Stamped(self.source.part(indices), self.given[indices], self.timed)

    def images(self, gray: bool = True, shrink: int = 1) -> Iterator[Picture | None]:
        """As ImageSource has it."""
        return self.source.images(gray, shrink)

    def why_unreadable(self, index: int) -> str:
        """As ImageSource has it."""
        return self.source.why_unreadable(index)

    def batches(self, indices: Ints, size: int) -> list[Ints]:
        """As ImageSource has it."""
        return self.source.batches(indices, size)
