"""A Rig as a person likes to read it: the headline, a line for each camera, what is weak, who is missing."""

import sys

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from quadrig.rig.result import Camera, Rig
from quadrig.rig.words import counted, length, with_sigma

# In a file or a pipe no line is broken.
_UNBROKEN = 200


def console() -> Console:
    """stdout, as wide as the terminal; in a file or pipe wide enough for every table."""
    return Console(width=None if sys.stdout.isatty() else _UNBROKEN, highlight=False)


def print_rig(rig: Rig, where: Console | None = None) -> None:
    """Print a Rig on stdout."""
    where = where or console()
    where.print(f"[bold]working accuracy {length(rig.working_accuracy)}[/] where the rectangles were seen")
    where.print(escape(summary(rig)))
    where.print()
    where.print(camera_table(rig))
    for heading, sentences in (("weak", rig.weak), ("missing", tuple(rig.missing.values()))):
        if sentences:
            where.print(f"\n[bold]{heading}[/]")
        for sentence in sentences:
            where.print(f"  {escape(sentence)}", soft_wrap=not sys.stdout.isatty())


def summary(rig: Rig) -> str:
    """The second line: how many of everything, and how well all of it fits."""
    used = [fit for fit in rig.fits if not fit.rejected]
    framesets = len({fit.view.frameset for fit in used})
    return (
        f"{counted(len(rig.cameras), 'camera')}, {counted(len(rig.rectangles), 'rectangle')}, "
        f"{counted(framesets, 'frameset')}, {len(used)} of {counted(len(rig.fits), 'View')}; "
        f"RMS {rig.rms:.3f} px, on framesets held out of the fit {rig.held_out_rms:.3f} px; rig frame {rig.reference}"
    )


def camera_table(rig: Rig) -> Table:
    """Per camera: focal, position, rotation with their sigmas, RMS of the fit and held out, Views used, the lens."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("camera", no_wrap=True)
    for heading in ("focal px", "position m", "\u00b1 mm", "rotation \u00b1 deg", "RMS px", "held out", "Views"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("lens", no_wrap=True)
    for camera in rig.cameras:
        table.add_row(*_cells(rig, camera))
    return table


def _cells(rig: Rig, camera: Camera) -> list[str]:
    stands = camera.name == rig.reference
    position = " ".join(f"{value:.4f}" for value in camera.rig_from_camera.translation + 0.0)
    return [
        escape(camera.name),
        with_sigma(camera.intrinsics.focal, rig.focal_sigma(camera.name)),
        position,
        "rig frame" if stands else f"{1e3 * rig.position_sigma(camera.name):.2f}",
        "" if stands else f"{np.degrees(rig.rotation_sigma(camera.name)):.4f}",
        f"{camera.rms:.3f}",
        "" if np.isnan(camera.held_out_rms) else f"{camera.held_out_rms:.3f}",
        str(camera.views),
        lens_words(camera),
    ]


def lens_words(camera: Camera) -> str:
    """The lens parameters that were estimated: "f c k1 k2"; "given" where none was."""
    names = ["f" if name == "focal" else name for name in camera.free_lens]
    short = " ".join(["c" if name == "cx" else name for name in names if name != "cy"])
    model = "" if camera.intrinsics.model == "pinhole" else f"{camera.intrinsics.model} "
    return model + (short or "given")
