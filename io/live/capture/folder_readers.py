"""Folders of pictures: played in the order of their names, or watched while pictures fall into them."""

import time
from pathlib import Path

from quadrig.io.live.capture.reader import NETWORK_PATIENCE, PictureData, SourceLostError
from quadrig.io.recording.decode_image import UndecodableImage, decode_file, read_picture_file
from quadrig.io.recording.image_folder import IMAGE_SUFFIXES
from quadrig.single.errors import QuadrigError

# Folders of pictures carry no clock: they play at a rate a person can follow.
_FOLDER_PERIOD_NS = 100_000_000


class FolderReader:
    """The pictures of a folder in the order of their names."""

    live = False

    def __init__(self, folder: Path) -> None:
        self._paths = sorted(p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
        self._next = 0
        if not self._paths:
            raise QuadrigError(f"{folder}: no pictures ({', '.join(sorted(IMAGE_SUFFIXES))}) in this folder")

    def read(self) -> tuple[int, PictureData] | None:
        if self._next >= len(self._paths):
            return None
        stamp, path = self._next * _FOLDER_PERIOD_NS, self._paths[self._next]
        self._next += 1
        return stamp, _picture_file(path)

    def close(self) -> None:
        pass


class WatchReader:
    """A folder into which pictures fall: each is read once its size has stood still between two looks."""

    live = True
    _LOOK_EVERY = 0.05

    def __init__(self, folder: Path) -> None:
        self._folder, self._seen, self._sizes = folder, set[str](), dict[str, int]()
        if not folder.is_dir():
            raise SourceLostError(f"folder {folder} is not there")

    def read(self) -> tuple[int, PictureData] | None:
        until = time.monotonic() + NETWORK_PATIENCE
        while time.monotonic() < until:
            path = self._next_settled()
            if path is not None:
                self._seen.add(path.name)
                return 0, _picture_file(path)
            time.sleep(self._LOOK_EVERY)
        return 0, b""

    def _next_settled(self) -> Path | None:
        try:
            found = sorted(p for p in self._folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
        except OSError:
            raise SourceLostError(f"folder {self._folder} is not there") from None
        for path in found:
            if path.name in self._seen:
                continue
            size = path.stat().st_size if path.exists() else -1
            if size > 0 and self._sizes.get(path.name) == size:
                return path
            self._sizes[path.name] = size
        return None

    def close(self) -> None:
        pass


def _picture_file(path: Path) -> PictureData:
    try:
        data = read_picture_file(path)
        return data if path.suffix.lower() in (".jpg", ".jpeg", ".png") else decode_file(data, gray=False)
    except UndecodableImage:
        return b""
