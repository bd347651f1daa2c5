"""Names of tag dictionaries: "apriltag_36h11", "aruco_4x4_50"; OpenCV's own DICT_ names are read too."""

from functools import lru_cache

import cv2
import numpy as np

from quadrig.single.arrays import Mask
from quadrig.single.errors import QuadrigError


@lru_cache(maxsize=1)
def dictionary_names() -> dict[str, int]:
    """OpenCV's number of every dictionary by our name of it, in lower case."""
    opencv = {name: getattr(cv2.aruco, name) for name in dir(cv2.aruco) if name.startswith("DICT_")}
    return {_our_name(name): number for name, number in sorted(opencv.items())}


def _our_name(name: str) -> str:
    bare = name.lower().removeprefix("dict_")
    return bare if bare.startswith(("apriltag_", "aruco_")) else f"aruco_{bare}"


def canonical_dictionary(name: str) -> str:
    """Our name of a dictionary that is called "aruco_4x4_50", "DICT_4X4_50", "tag36h11" or the like.

    Raises QuadrigError, with the names that exist, where there is none of that name.
    """
    plain = name.strip().lower().replace("-", "_").replace(" ", "_")
    guesses = (plain, _our_name(plain), f"apriltag_{plain.removeprefix('dict_').removeprefix('tag')}")
    for guess in guesses:
        if guess in dictionary_names():
            return guess
    raise QuadrigError(f"there is no tag dictionary {name!r}; choose one of {', '.join(dictionary_names())}")


@lru_cache(maxsize=64)
def tag_dictionary(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of a name. Raises QuadrigError where there is none."""
    return cv2.aruco.getPredefinedDictionary(dictionary_names()[canonical_dictionary(name)])


def dictionary_size(name: str) -> int:
    """How many tags the dictionary holds: ids are 0 to this, less one."""
    return len(tag_dictionary(name).bytesList)


def tag_cells(name: str, tag_id: int, border: int = 1) -> Mask:
    """Which cells (n, n) of a tag are white, its black border of so many cells included."""
    dictionary = tag_dictionary(name)
    side = dictionary.markerSize + 2 * border
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, tag_id, side, borderBits=border)) > 127


def check_tag_ids(name: str, *tag_ids: int) -> None:
    """Raises QuadrigError where the dictionary has no tag of one of these ids."""
    size = dictionary_size(name)
    for tag_id in tag_ids:
        if not 0 <= tag_id < size:
            known = canonical_dictionary(name)
            raise QuadrigError(f"the dictionary {known} has no tag {tag_id}; choose an id from 0 to {size - 1}")
