"""`rig undistort`: pictures and videos as a pinhole would have taken them."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from numpy.typing import NDArray

from quadrig.io.formats.any_file import read_any_lenses
from quadrig.io.formats.maps import remap_tables
from quadrig.io.progress import progress_bar
from quadrig.io.recording.decode_image import UndecodableImage, decode_unchanged, read_picture_file
from quadrig.io.recording.image_folder import IMAGE_SUFFIXES, file_header, folder_images
from quadrig.io.recording.video import VIDEO_SUFFIXES, VideoFile, read_video
from quadrig.io.whole_file import written_beside
from quadrig.single.arrays import Picture
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics

Tables = tuple[NDArray[np.float32], NDArray[np.float32]]

# x264's scale of quality: below 18 the loss is not seen.
_CRF = "16"


def undistort(
    rig: Annotated[Path, typer.Argument(help="The lenses: a rig.mcap, or any format that is read.", metavar="RIG")],
    inputs: Annotated[list[Path], typer.Argument(help="Pictures, folders of them, and videos.", metavar="INPUT")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder to write to.")] = Path("undistorted"),
    camera: Annotated[
        str | None, typer.Option(help="The camera that took them; else the one they are called after.")
    ] = None,
) -> None:
    """Take the lens's distortion out of pictures and videos.

    They keep their size, and the lens its principal point and its focal length along x; pixels become square.
    `rig export --undistorted` says these lenses.

    Examples: rig undistort rig.mcap cam0/ cam1.mp4 -o flat; rig undistort camchain.yaml shot.png --camera cam0
    """
    lenses = {name: known.intrinsics for name, known in read_any_lenses(rig).items()}
    # All that can be refused is, before anything is written.
    works = [_work(given, output, camera, lenses) for given in inputs]
    _refuse_shared(works)
    tables = {work.camera: remap_tables(lenses[work.camera]) for work in works}
    output.mkdir(parents=True, exist_ok=True)
    for work in works:
        lens, table = lenses[work.camera], tables[work.camera]
        if work.video:
            _video(*work.pairs[0], lens, table)
        else:
            work.pairs[0][1].parent.mkdir(exist_ok=True)
            with progress_bar(work.camera, len(work.pairs), "pictures") as advance:
                for source, target in work.pairs:
                    _picture(source, target, lens, table)
                    advance(1)
        print(work.target)


@dataclass(frozen=True)
class _Work:
    """What is made of one INPUT: each file with where it goes, and target, the file or folder of all of them."""

    camera: str
    pairs: list[tuple[Path, Path]]
    target: Path
    video: bool = False


def _work(given: Path, output: Path, asked: str | None, lenses: dict[str, Intrinsics]) -> _Work:
    """Raises QuadrigError where it cannot be done, as far as that can be seen before it is."""
    if not given.exists():
        raise QuadrigError(f"there is no {given}; give pictures, folders of pictures, or videos")
    name = _camera(given, asked, lenses)
    if given.suffix.lower() in VIDEO_SUFFIXES and given.is_file():
        target = output / f"{given.stem}.mp4"
        _refuse_same(given, target)
        return _Work(name, [(given, target)], target, video=True)
    pictures = folder_images(given) if given.is_dir() else [given]
    if not pictures or any(one.suffix.lower() not in IMAGE_SUFFIXES for one in pictures):
        raise QuadrigError(f"{given}: it is no picture, video or folder of pictures; give one of those")
    folder = output / given.name if given.is_dir() else output
    pairs = [(picture, folder / picture.name) for picture in pictures]
    for source, target in pairs:
        _refuse_same(source, target)
        header = file_header(source)
        if header is None:
            raise QuadrigError(f"{source}: cannot be read as a picture; leave it out")
        _refuse_size(header.size, lenses[name], source)
    return _Work(name, pairs, folder if given.is_dir() else folder / given.name)


def _refuse_shared(works: list[_Work]) -> None:
    """Raises QuadrigError where two files would be written to one."""
    sources: dict[Path, Path] = {}
    for source, target in (pair for work in works for pair in work.pairs):
        if target in sources:
            raise QuadrigError(
                f"{sources[target]} and {source} would both become {target}; do them one by one with -o"
            )
        sources[target] = source


def _camera(given: Path, asked: str | None, lenses: dict[str, Intrinsics]) -> str:
    """The camera asked for, else the one that the file or its folder is called after, else the only one."""
    names = (
        [asked] if asked is not None else [given.name if given.is_dir() else given.stem, given.resolve().parent.name]
    )
    found = next((name for name in names if name in lenses), None)
    if found is None and asked is None and len(lenses) == 1:
        return next(iter(lenses))
    if found is None:
        raise QuadrigError(f"{given}: which camera took it? Give --camera, one of {', '.join(lenses)}")
    return found


def _refuse_size(size: tuple[int, int], lens: Intrinsics, where: Path) -> None:
    if size != (lens.width, lens.height):
        raise QuadrigError(
            f"{where}: it is {size[0]}x{size[1]}, the lens was calibrated at {lens.width}x{lens.height}; give "
            "pictures of that size"
        )


def _remapped(image: Picture, lens: Intrinsics, tables: Tables, where: Path) -> Picture:
    _refuse_size((image.shape[1], image.shape[0]), lens, where)
    return np.asarray(cv2.remap(image, *tables, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT), image.dtype)


def _picture(source: Path, target: Path, lens: Intrinsics, tables: Tables) -> None:
    try:
        image = decode_unchanged(read_picture_file(source))
    except UndecodableImage as error:
        raise QuadrigError(f"{source}: cannot be read as a picture ({error}); leave it out") from error
    done, encoded = cv2.imencode(target.suffix, _remapped(image, lens, tables, source))
    if not done:
        raise QuadrigError(f"{target}: pictures cannot be written as {target.suffix}; give PNG or JPEG files")
    with written_beside(target) as beside:
        beside.write_bytes(encoded.tobytes())


def _video(source: Path, target: Path, lens: Intrinsics, tables: Tables) -> None:
    import av

    video = read_video(source)
    with (
        written_beside(target) as beside,
        _stream(av, beside, lens, video) as write,
        progress_bar(source.name, len(video)) as advance,
    ):
        for time, image in zip(video.times.tolist(), video.images(gray=False), strict=True):
            if image is not None:
                write(_remapped(image, lens, tables, source), time)
            advance(1)


@contextmanager
def _stream(av, path: Path, lens: Intrinsics, video: VideoFile) -> Iterator:
    """Writes pictures with their times, in units of the video's time base, as H.264."""
    base = Fraction(video.time_base).limit_denominator(1_000_000)
    with av.open(str(path), "w") as container:
        container.metadata["comment"] = "quadrig"
        stream = container.add_stream("libx264", options={"crf": _CRF})
        stream.width, stream.height, stream.time_base, stream.codec_context.time_base = (
            lens.width,
            lens.height,
            base,
            base,
        )
        # Half as many samples of colour need an even number of pixels.
        stream.pix_fmt = "yuv444p" if lens.width % 2 or lens.height % 2 else "yuv420p"

        def write(image: Picture, time: int) -> None:
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            frame.pts, frame.time_base = time, base
            container.mux(stream.encode(frame))

        yield write
        container.mux(stream.encode())


def _refuse_same(source: Path, target: Path) -> None:
    if target.exists() and target.samefile(source):
        raise QuadrigError(f"{source} would be written over; name another folder with -o")
