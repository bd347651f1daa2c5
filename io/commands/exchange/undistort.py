"""`rig undistort`: pictures and videos as a pinhole would have taken them."""

from collections.abc import Iterator
from contextlib import contextmanager
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
from quadrig.io.recording.decode_image import UndecodableImage, decode_unchanged
from quadrig.io.recording.image_folder import IMAGE_SUFFIXES, folder_images
from quadrig.io.recording.video import VIDEO_SUFFIXES, VideoFile, import_av, read_video
from quadrig.io.whole_file import written_beside
from quadrig.single.arrays import Picture
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics

Tables = tuple[NDArray[np.float32], NDArray[np.float32]]

# x264's scale of quality: below 18 the loss is not seen.
_CRF = "16"


def undistort(
    rig: Annotated[Path, typer.Argument(help="The lenses: a rig.mcap, or any format that is read.")],
    inputs: Annotated[list[Path], typer.Argument(help="Pictures, folders of them, and videos.", metavar="INPUT...")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder to write to.")] = Path("undistorted"),
    camera: Annotated[
        str | None, typer.Option(help="The camera that took them; else the one they are called after.")
    ] = None,
) -> None:
    """Take the lens's distortion out of pictures and videos.

    They keep their size, and the lens its principal point and its focal length along x; pixels become square.
    `rig export --undistorted` says these lenses.

    Examples: rig undistort rig.mcap cam0/ cam1.mp4 -o flat; rig undistort camchain.yaml shot.png --camera left
    """
    lenses = {name: known.intrinsics for name, known in read_any_lenses(rig).items()}
    for given in inputs:
        if not given.exists():
            raise QuadrigError(f"there is no {given}; give pictures, folders of pictures, or videos")
    output.mkdir(parents=True, exist_ok=True)
    for given in inputs:
        name = _camera(given, camera, lenses)
        tables = remap_tables(lenses[name])
        if given.suffix.lower() in VIDEO_SUFFIXES and given.is_file():
            print(_video(given, output / f"{given.stem}.mp4", lenses[name], tables))
            continue
        pictures = folder_images(given) if given.is_dir() else [given]
        if not pictures or any(one.suffix.lower() not in IMAGE_SUFFIXES for one in pictures):
            raise QuadrigError(f"{given}: it is no picture, video or folder of pictures; give one of those")
        folder = output / given.name if given.is_dir() else output
        folder.mkdir(exist_ok=True)
        with progress_bar(name, len(pictures), "pictures") as advance:
            for picture in pictures:
                _picture(picture, folder / picture.name, lenses[name], tables)
                advance(1)
        print(folder if given.is_dir() else folder / given.name)


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


def _remapped(image: Picture, lens: Intrinsics, tables: Tables, where: Path) -> Picture:
    height, width = image.shape[:2]
    if (width, height) != (lens.width, lens.height):
        raise QuadrigError(
            f"{where}: it is {width}x{height}, the lens was calibrated at {lens.width}x{lens.height}; give pictures "
            "of that size"
        )
    return np.asarray(cv2.remap(image, *tables, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT), image.dtype)


def _picture(source: Path, target: Path, lens: Intrinsics, tables: Tables) -> None:
    _refuse_same(source, target)
    try:
        image = decode_unchanged(source.read_bytes())
    except UndecodableImage as error:
        raise QuadrigError(f"{source}: cannot be read as a picture ({error}); leave it out") from error
    done, encoded = cv2.imencode(target.suffix, _remapped(image, lens, tables, source))
    if not done:
        raise QuadrigError(f"{target}: pictures cannot be written as {target.suffix}; give PNG or JPEG files")
    with written_beside(target) as beside:
        beside.write_bytes(encoded.tobytes())


def _video(source: Path, target: Path, lens: Intrinsics, tables: Tables) -> Path:
    _refuse_same(source, target)
    video, av = read_video(source), import_av()
    with (
        written_beside(target) as beside,
        _stream(av, beside, lens, video) as write,
        progress_bar(source.name, len(video)) as advance,
    ):
        for time, image in zip(video.times.tolist(), video.images(gray=False), strict=True):
            if image is not None:
                write(_remapped(image, lens, tables, source), time)
            advance(1)
    return target


@contextmanager
def _stream(av, path: Path, lens: Intrinsics, video: VideoFile) -> Iterator:
    """Writes pictures with their times, in units of the video's time base, as H.264."""
    base = Fraction(video.time_base).limit_denominator(1_000_000)
    with av.open(str(path), "w") as container:
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
