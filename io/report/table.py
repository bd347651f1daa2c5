"""A Rig as a person likes to read it on a terminal: the headline, a line for each camera, what is weak."""

from collections.abc import Sequence

import numpy as np
from rich.console import Console

from quadrig.io.plain_words import console
from quadrig.io.report.terminal import print_sentence, print_table
from quadrig.rig.doubt.lens_accuracy import lens_accuracy
from quadrig.rig.doubt.verdict import verdict
from quadrig.rig.doubt.weaknesses import coverage
from quadrig.rig.result import Camera, Rig, body_columns, body_sentence, camera_columns, lens_columns
from quadrig.rig.words import ONE_SIGMA, Column, counted, pixels, sigma_figure
from quadrig.single.lens import LENS_PARAMETERS


def print_rig(rig: Rig, where: Console | None = None) -> None:
    """Print a Rig on stdout."""
    where = where or console()
    judged = verdict(rig)
    print_sentence(judged.headline, where, style="bold")
    for sentence in filter(None, (judged.holds, summary(rig))):
        print_sentence(sentence, where)
    if len(rig.cameras) > 1:
        print_table([*camera_columns(rig), *lens_figures([(rig, camera) for camera in rig.cameras])], where)
    alone = lenses_alone(rig)
    if alone:
        print_table([*lens_columns(alone), *lens_figures(alone)], where, "lens only" if rig.apart else "")
    for body in rig.bodies:
        where.print()
        print_sentence(body_sentence(body), where)
        print_table(body_columns(rig, body), where)
    if rig.is_doubt_known:
        print_sentence(ONE_SIGMA, where)
    if judged.weak:
        where.print("\n[bold]what is weak, and what to do[/]")
    for sentence in judged.weak:
        print_sentence(sentence, where, "- ")


def lenses_alone(rig: Rig) -> list[tuple[Rig, Camera]]:
    """The cameras of which only the lens is known, each with the rig that has it."""
    own = [(rig, rig.cameras[0])] if len(rig.cameras) == 1 else []
    return [*own, *rig.lens_only]


def summary(rig: Rig) -> str:
    """How many of everything, and how well all of it fits."""
    used = [fit for fit in rig.fits if not fit.rejected]
    framesets = len({fit.view.frameset for fit in used})
    held_out = "" if np.isnan(rig.held_out_rms) else f", on framesets held out of the fit {pixels(rig.held_out_rms)}"
    return (
        f"{counted(len(rig.cameras), 'camera')}, {counted(len(rig.rectangles), 'rectangle')}, "
        f"{counted(framesets, 'frameset')}, {len(used)} of {counted(len(rig.fits), 'View')}; "
        f"RMS {pixels(rig.rms)}{held_out}; rig frame {rig.reference}"
    )


def lens_figures(every: Sequence[tuple[Rig, Camera]]) -> list[Column]:
    """What a lens is good for, how much of its picture was covered, which of its parameters were estimated."""
    shares = {number: coverage(rig) for number, rig in {id(rig): rig for rig, _ in every}.items()}
    covered = [100 * shares[id(rig)][camera.name] for rig, camera in every]
    return [
        Column("lens", "± px", tuple(sigma_figure(lens_accuracy(rig, camera.name)) for rig, camera in every)),
        Column("covered", "%", tuple(f"{share:.0f}" for share in covered)),
        Column("estimated", "", tuple(lens_words(camera) for _, camera in every), words=True),
    ]


def lens_words(camera: Camera) -> str:
    """The lens parameters that were estimated: "all", "f c k1 k2"; "none" where they were given."""
    model = "" if camera.intrinsics.model == "pinhole" else f"{camera.intrinsics.model} "
    if set(camera.free_lens) >= set(LENS_PARAMETERS):
        return f"{model}all"
    names = ["f" if name == "focal" else name for name in camera.free_lens]
    short = " ".join(["c" if name == "cx" else name for name in names if name != "cy"])
    return model + (short or "none")
