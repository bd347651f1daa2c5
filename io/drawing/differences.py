"""How two rigs differ, camera by camera, as every table of it shows it, and in sentences."""

import numpy as np

from quadrig.rig.comparison import CameraDifference, Comparison
from quadrig.rig.words import Column, listed, with_sigma

ALONG = (
    "± is one sigma along the difference. Chance: that any part of any camera differs so much where both rigs are "
    "right; below 1 % it is called a difference."
)
"""Stands beside every table of differences."""

_LEAST = 0.01


def difference_columns(found: Comparison) -> list[Column]:
    """The second rig minus the first: focal, shift and turn of each camera beside their sigmas, and how likely the
    least likely of its parts is."""
    every = found.cameras
    names = Column("camera", "", tuple(one.name for one in every), words=True)
    focal = Column("focal", "px", tuple(_focal(one) for one in every))
    chance = Column("chance", "%", tuple(_per_cent(found.chance(one)) for one in every))
    # One camera is aligned on itself.
    if len(every) == 1:
        return [names, focal, chance]
    return [
        names,
        focal,
        Column("position", "mm", tuple(_position(one) for one in every)),
        Column("rotation", "deg", tuple(_rotation(one) for one in every)),
        chance,
    ]


def difference_sentences(found: Comparison) -> list[str]:
    """Whether the rigs agree, where they do not, and who was not compared; in the figures of the table."""
    sentences = [_headline(found)]
    differing = [one for one in found.cameras if one.differs]
    for one in differing:
        parts = listed([_part(one, part) for part in one.differs])
        sentences.append(f"{one.name} differs in {parts}: by chance in {_per_cent(found.chance(one))} %.")
    moved = [one for one in differing if {*one.differs} & {"position", "rotation", "pose"}]
    if len(found.cameras) == len(moved) == 2:
        sentences.append("Of two cameras nobody can say which of them it was.")
    other = [
        one.name for one in found.cameras if np.isnan(one.apart["focal"].chance) and np.isfinite(one.focal_sigma)
    ]
    if other:
        sentences.append(f"Not compared, as models or sizes of pictures differ: the lenses of {listed(other)}.")
    for which, names in (("first", found.only_first), ("second", found.only_second)):
        if names:
            sentences.append(f"Only in the {which}: {', '.join(names)}.")
    return sentences


def _headline(found: Comparison) -> str:
    if not found.tests:
        return "Whether the rigs agree cannot be said: one of them does not state how sure it is."
    differing = [one.name for one in found.cameras if one.differs]
    if differing:
        return f"The rigs differ by more than their sigmas allow, at {listed(differing)}."
    worst, chance = found.worst, found.chance(found.worst)
    if chance == 1:
        return "The rigs agree within their sigmas."
    return (
        f"The rigs agree within their sigmas; what differs most is {worst.name} in "
        f"{_part(worst, worst.least_likely[0])}, and so much or more by chance in {_per_cent(chance)} %."
    )


def _part(one: CameraDifference, part: str) -> str:
    return {
        "focal": f"focal ({_focal(one)} px)",
        "lens": "its lens as a whole",
        "position": f"position ({_position(one)} mm)",
        "rotation": f"rotation ({_rotation(one)} deg)",
        "pose": "position and rotation together",
    }[part]


def _focal(one: CameraDifference) -> str:
    return with_sigma(one.focal, one.focal_sigma, signed=True)


def _position(one: CameraDifference) -> str:
    return with_sigma(1e3 * one.shift, 1e3 * one.shift_sigma)


def _rotation(one: CameraDifference) -> str:
    return with_sigma(np.degrees(one.rotation), np.degrees(one.rotation_sigma))


def _per_cent(chance: float) -> str:
    if not np.isfinite(chance):
        return "unknown"
    share = 100 * chance
    return f"<{_LEAST}" if share < _LEAST else f"{share:.2g}" if share < 10 else f"{share:.0f}"
