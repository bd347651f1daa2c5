"""A fault of the pictures, with its sentence."""

from dataclasses import dataclass
from typing import Literal

FaultKind = Literal[
    "blur",
    "motion",
    "too bright",
    "too dark",
    "held still",
    "wrong board",
    "wrong scale",
    "not static",
    "another size",
]


@dataclass(frozen=True)
class Fault:
    """Something that spoils a capture. sentence: what, where, what to do; camera "" where it concerns all."""

    kind: FaultKind
    sentence: str
    camera: str = ""
