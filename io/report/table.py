"""A Rig as a person likes to read it: the headline, a line for each camera, what is weak."""

import sys
from collections.abc import Callable, Sequence

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from quadrig.rig.doubt.lens_accuracy import lens_accuracy
from quadrig.rig.doubt.verdict import verdict
from quadrig.rig.doubt.weaknesses import coverage
from quadrig.rig.result import Camera, Rig
from quadrig.rig.words import counted, figure, with_sigma

# In a file or a pipe no line is broken.
_UNBROKEN = 200
# Up to this width of the terminal the columns are left out that few people need.
_NARROW = 110
_WIDE = ("lens \u00b1 px", "held out", "lens")


def console() -> Console:
    """stdout, as wide as the terminal; in a file or pipe wide enough for every table."""
    return Console(width=None if sys.stdout.isatty() else _UNBROKEN, highlight=False)


def print_rig(rig: Rig, where: Console | None = None) -> None:
    """Print a Rig on stdout."""
    where = where or console()
    judged = verdict(rig)
    where.print(f"[bold]{escape(judged.headline)}[/]")
    where.print(escape(summary(rig)))
    if len(rig.cameras) > 1:
        where.print()
        where.print(camera_table(rig, wide=where.width > _NARROW))
    alone = lenses_alone(rig)
    if alone:
        where.print("\n[bold]lens only[/]" if rig.apart else "")
        where.print(lens_table(alone))
    if judged.weak:
        where.print("\n[bold]what is weak, and what to do[/]")
    for sentence in judged.weak:
        where.print(f"  {escape(sentence)}", soft_wrap=not sys.stdout.isatty())


def lenses_alone(rig: Rig) -> list[tuple[Rig, Camera]]:
    """The cameras of which only the lens is known, each with the rig that has it."""
    own = [(rig, rig.cameras[0])] if len(rig.cameras) == 1 else []
    return [*own, *rig.lens_only]


def summary(rig: Rig) -> str:
    """The second line: how many of everything, and how well all of it fits."""
    used = [fit for fit in rig.fits if not fit.rejected]
    framesets = len({fit.view.frameset for fit in used})
    held_out = "" if np.isnan(rig.held_out_rms) else f", on framesets held out of the fit {rig.held_out_rms:.3f} px"
    return (
        f"{counted(len(rig.cameras), 'camera')}, {counted(len(rig.rectangles), 'rectangle')}, "
        f"{counted(framesets, 'frameset')}, {len(used)} of {counted(len(rig.fits), 'View')}; "
        f"RMS {figure(rig.rms, 3)} px{held_out}; rig frame {rig.reference}"
    )


def camera_table(rig: Rig, wide: bool = True) -> Table:
    """Per camera: focal, position, rotation with their sigmas, RMS of the fit, Views used; where there is room, what
    the lens is good for, RMS of framesets held out, and what of the lens was estimated."""
    columns = [
        ("camera", [escape(camera.name) for camera in rig.cameras]),
        ("focal px", [_focal(rig, camera) for camera in rig.cameras]),
        ("lens \u00b1 px", [_lens_accuracy(rig, camera) for camera in rig.cameras]),
        ("position m", [_position(rig, camera) for camera in rig.cameras]),
        ("\u00b1 mm", [_unless_frame(rig, camera, _position_sigma) for camera in rig.cameras]),
        ("\u00b1 deg", [_unless_frame(rig, camera, _rotation_sigma) for camera in rig.cameras]),
        ("RMS px", [_px(camera.rms) for camera in rig.cameras]),
        ("held out", [_px(camera.held_out_rms) for camera in rig.cameras]),
        ("Views", [str(camera.views) for camera in rig.cameras]),
        ("lens", [lens_words(camera) for camera in rig.cameras]),
    ]
    return _table([column for column in columns if wide or column[0] not in _WIDE])


def lens_table(alone: Sequence[tuple[Rig, Camera]]) -> Table:
    """Per camera: focal and principal point with their sigmas, what the lens is good for, RMS, Views, coverage."""
    return _table(
        [
            ("camera", [escape(camera.name) for _, camera in alone]),
            ("focal px", [_focal(rig, camera) for rig, camera in alone]),
            ("centre px", ["{:.1f} {:.1f}".format(*camera.intrinsics.principal_point) for _, camera in alone]),
            ("lens \u00b1 px", [_lens_accuracy(rig, camera) for rig, camera in alone]),
            ("RMS px", [_px(camera.rms) for _, camera in alone]),
            ("held out", [_px(camera.held_out_rms) for _, camera in alone]),
            ("Views", [str(camera.views) for _, camera in alone]),
            ("covered", [f"{100 * coverage(rig)[camera.name]:.0f} %" for rig, camera in alone]),
        ]
    )


def _table(columns: Sequence[tuple[str, Sequence[str]]]) -> Table:
    """A table of columns of words: all but names are read from the right."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading, _ in columns:
        table.add_column(heading, justify="left" if heading in ("camera", "lens") else "right", no_wrap=True)
    for row in zip(*(cells for _, cells in columns), strict=True):
        table.add_row(*row)
    return table


def _focal(rig: Rig, camera: Camera) -> str:
    return with_sigma(camera.intrinsics.focal, rig.focal_sigma(camera.name))


def _lens_accuracy(rig: Rig, camera: Camera) -> str:
    accuracy = lens_accuracy(rig, camera.name)
    return f"{accuracy:.2g}" if np.isfinite(accuracy) else "unknown"


def _position(rig: Rig, camera: Camera) -> str:
    if camera.name == rig.reference:
        return "rig frame"
    return " ".join(f"{value:.4f}" for value in camera.rig_from_camera.translation + 0.0)


def _unless_frame(rig: Rig, camera: Camera, figure: Callable[[Rig, Camera], str]) -> str:
    return "" if camera.name == rig.reference else figure(rig, camera)


def _position_sigma(rig: Rig, camera: Camera) -> str:
    return figure(1e3 * rig.position_sigma(camera.name), 2)


def _rotation_sigma(rig: Rig, camera: Camera) -> str:
    return figure(np.degrees(rig.rotation_sigma(camera.name)), 4)


def _px(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.3f}"


def lens_words(camera: Camera) -> str:
    """The lens parameters that were estimated: "f c k1 k2"; "given" where none was."""
    names = ["f" if name == "focal" else name for name in camera.free_lens]
    short = " ".join(["c" if name == "cx" else name for name in names if name != "cy"])
    model = "" if camera.intrinsics.model == "pinhole" else f"{camera.intrinsics.model} "
    return model + (short or "given")
