"""A small PDF writer: filled rectangles, lines and text in millimetres, exact to a thousandth of one."""

import itertools
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

_POINTS_PER_MM = 72 / 25.4
# Share of the radius at which the knots of a quarter circle's Bezier curve lie.
_KAPPA = 4 / 3 * (2**0.5 - 1)


@dataclass
class PdfPage:
    """A page of width x height mm; the origin is its top left corner, y runs down."""

    width: float
    height: float
    commands: list[str] = field(default_factory=list)

    def fill(self, boxes: Iterable[tuple[float, float, float, float]], grey: float = 0.0) -> None:
        """Boxes (left, top, right, bottom) in one tone, 0 black to 1 white; boxes that touch show no seam."""
        paths = [f"{a:.4f} {b:.4f} {c - a:.4f} {d - b:.4f} re" for a, b, c, d in boxes]
        self.commands.append(f"{grey:.3f} g {' '.join(paths)} f")

    def fill_ellipses(self, boxes: Iterable[tuple[float, float, float, float]], grey: float = 0.0) -> None:
        """The ellipses within boxes (left, top, right, bottom), in one tone."""
        self.commands.append(f"{grey:.3f} g {' '.join(_ellipse(*box) for box in boxes)} f")

    def line(self, start: tuple[float, float], end: tuple[float, float], thickness: float = 0.1) -> None:
        """A black line, thickness in mm."""
        self.commands.append(f"0 G {thickness:.3f} w {start[0]:.4f} {start[1]:.4f} m {end[0]:.4f} {end[1]:.4f} l S")

    def text(self, x: float, y: float, words: str, size: float = 3.0, mono: bool = False) -> None:
        """Black text whose baseline begins at (x, y); size: of the type, mm. Only the Latin letters are there."""
        safe = words.encode("latin-1", "replace").decode("latin-1")
        for sign in "\\()":
            safe = safe.replace(sign, "\\" + sign)
        font = "F2" if mono else "F1"
        self.commands.append(f"BT 0 g /{font} {size:.3f} Tf 1 0 0 -1 {x:.4f} {y:.4f} Tm ({safe}) Tj ET")


def _ellipse(left: float, top: float, right: float, bottom: float) -> str:
    """Four Bezier curves, off by 3 of 10,000 of the radius at most."""
    x, y, a, b = (left + right) / 2, (top + bottom) / 2, (right - left) / 2, (bottom - top) / 2
    path = f"{right:.4f} {y:.4f} m"
    for (c, s), (d, t) in itertools.pairwise([(1, 0), (0, 1), (-1, 0), (0, -1), (1, 0)]):
        knots = (c + _KAPPA * d, s + _KAPPA * t), (d + _KAPPA * c, t + _KAPPA * s), (d, t)
        path += " " + " ".join(f"{x + a * u:.4f} {y + b * v:.4f}" for u, v in knots) + " c"
    return path


def pdf_bytes(pages: Sequence[PdfPage], title: str) -> bytes:
    """The file. It asks viewers to print at its own size."""
    objects: list[bytes] = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Courier /Encoding /WinAnsiEncoding >>",
        f"<< /Title ({title}) /Producer (quadrig) >>".encode("latin-1", "replace"),
    ]
    kids = []
    for page in pages:
        stream = zlib.compress(_content(page).encode("latin-1"))
        objects.append(b"<< /Length %d /Filter /FlateDecode >>\nstream\n" % len(stream) + stream + b"\nendstream")
        box = f"{page.width * _POINTS_PER_MM:.4f} {page.height * _POINTS_PER_MM:.4f}"
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {box}] /Contents {len(objects)} 0 R "
            "/Resources << /Font << /F1 3 0 R /F2 4 0 R >> >> >>".encode()
        )
        kids.append(f"{len(objects)} 0 R")
    objects[1] = f"<< /Type /Pages /Count {len(kids)} /Kids [{' '.join(kids)}] >>".encode()
    return _file(objects)


def _content(page: PdfPage) -> str:
    scale = _POINTS_PER_MM
    # Millimetres, y down, from here on.
    return f"{scale:.8f} 0 0 {-scale:.8f} 0 {page.height * scale:.4f} cm\n" + "\n".join(page.commands)


def _file(objects: Sequence[bytes]) -> bytes:
    result = bytearray(b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n")
    starts = []
    for number, body in enumerate(objects, start=1):
        starts.append(len(result))
        result += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = len(result)
    result += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    result += b"".join(b"%010d 00000 n \n" % start for start in starts)
    result += b"trailer\n<< /Size %d /Root 1 0 R /Info 5 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (
        len(objects) + 1,
        table,
    )
    return bytes(result)
