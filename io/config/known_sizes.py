"""Rectangles that everybody has: papers, courts and what is marked inside them, by name, from their rule books.

Width runs along the length of a court or pitch, height across it; papers lie across, "upright" turns them. `edge`
says which edge of the lines is meant: where a line of 5 cm is taken by its wrong edge, a length is 5 or 10 cm off.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from quadrig.single.errors import QuadrigError

_UPRIGHT = " upright"


@dataclass(frozen=True)
class KnownSize:
    """A rectangle of known size. width, height: metres; edge: what its corners are; source: who says so."""

    width: float
    height: float
    edge: str
    source: str


# ISO 216: the trimmed sizes of the A series, mm.
_ISO = {
    "A0": (1189, 841),
    "A1": (841, 594),
    "A2": (594, 420),
    "A3": (420, 297),
    "A4": (297, 210),
    "A5": (210, 148),
    "A6": (148, 105),
}
PAPER_SIZES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {name: (width / 1000, height / 1000) for name, (width, height) in _ISO.items()}
    | {"letter": (0.2794, 0.2159), "legal": (0.3556, 0.2159)}
)
"""Width and height in metres of papers lying across (ISO 216; ANSI in inches of 25.4 mm)."""

_TENNIS = "ITF Rules of Tennis, rule 1"
_PADEL = "FIP Rules of Padel, the court"
_BASKETBALL = "FIBA Official Basketball Rules, article 2"
_FOOTBALL = "IFAB Laws of the Game, law 1"
_VOLLEYBALL = "FIVB Official Volleyball Rules, rule 1"
_BEACH = "FIVB Official Beach Volleyball Rules, rule 1"
_BADMINTON = "BWF Laws of Badminton, law 1"
_OUTER = "outer edges of the lines"

_COURTS = {
    "tennis court": KnownSize(23.77, 10.97, _OUTER, _TENNIS),
    "tennis singles court": KnownSize(23.77, 8.23, _OUTER, _TENNIS),
    "tennis service area": KnownSize(
        12.80, 8.23, "both service lines' edges away from the net, outer edges of the singles sidelines", _TENNIS
    ),
    "tennis service box": KnownSize(
        6.40,
        4.115,
        "the service line's edge away from the net, the singles sideline's outer edge, the middle of the centre "
        "service line, the ground below the middle of the net",
        _TENNIS,
    ),
    "padel court": KnownSize(20.0, 10.0, "inner faces of the walls at the ground", _PADEL),
    "padel service area": KnownSize(
        13.90, 10.0, "middles of both service lines (the rule names no edge), inner faces of the walls", _PADEL
    ),
    "basketball court": KnownSize(28.0, 15.0, "inner edges of the boundary lines", _BASKETBALL),
    "basketball key": KnownSize(
        5.80,
        4.90,
        "inner edge of the end line, the free-throw line's edge away from it, outer edges of the key's sides",
        _BASKETBALL,
    ),
    "football pitch": KnownSize(
        105.0, 68.0, f"{_OUTER}; the law allows other sizes, this is the one of large stadiums", _FOOTBALL
    ),
    "football penalty area": KnownSize(16.50, 40.32, _OUTER, _FOOTBALL),
    "football goal area": KnownSize(5.50, 18.32, _OUTER, _FOOTBALL),
    "football goal": KnownSize(
        7.32, 2.44, "inner edges of the posts, lower edge of the crossbar, the ground", _FOOTBALL
    ),
    "volleyball court": KnownSize(18.0, 9.0, _OUTER, _VOLLEYBALL),
    "volleyball front zone": KnownSize(
        6.0, 9.0, "both attack lines' edges away from the net, outer edges of the sidelines", _VOLLEYBALL
    ),
    "beach volleyball court": KnownSize(16.0, 8.0, _OUTER, _BEACH),
    "badminton court": KnownSize(13.40, 6.10, _OUTER, _BADMINTON),
    "badminton singles court": KnownSize(13.40, 5.18, _OUTER, _BADMINTON),
    "badminton front area": KnownSize(
        3.96,
        6.10,
        "both short service lines' edges towards the net, outer edges of the doubles sidelines",
        _BADMINTON,
    ),
    "badminton doubles service area": KnownSize(
        11.88,
        6.10,
        "both doubles long service lines' edges away from the net, outer edges of the doubles sidelines",
        _BADMINTON,
    ),
}

KNOWN_SIZES: Mapping[str, KnownSize] = MappingProxyType(
    {
        name: KnownSize(*size, "edges of the paper", "ISO 216" if name in _ISO else "ANSI/ASME Y14.1")
        for name, size in PAPER_SIZES.items()
    }
    | _COURTS
)
"""Every rectangle known by name."""


def known_size(name: str) -> KnownSize:
    """The rectangle of a name, in whatever letters; "A4 upright" is a paper on its short side.

    Raises QuadrigError where none is called so.
    """
    plain = " ".join(name.lower().split())
    upright = plain.endswith(_UPRIGHT)
    plain = plain.removesuffix(_UPRIGHT)
    found = next((size for one, size in KNOWN_SIZES.items() if one.lower() == plain), None)
    if found is None:
        known = ", ".join(KNOWN_SIZES)
        raise QuadrigError(f"no size is called {name!r}; known are {known}; or give width and height")
    return KnownSize(found.height, found.width, found.edge, found.source) if upright else found
