"""`rig compare`: two calibrations of one rig."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from quadrig.io.drawing.difference_columns import difference_columns
from quadrig.io.formats.any_file import read_any_rig
from quadrig.io.formats.rig_json import json_text
from quadrig.io.viewer import show as rerun_show
from quadrig.rig.comparison import CameraDifference, Comparison
from quadrig.rig.comparison import compare as compare_rigs
from quadrig.rig.result import Rig
from quadrig.rig.words import ONE_SIGMA

# A difference this unlikely by chance is called one.
_UNLIKELY = 0.01


def compare(
    first: Annotated[Path, typer.Argument(help="A rig.mcap, or any format that is read.", metavar="A")],
    second: Annotated[Path, typer.Argument(help="Another of the same cameras.", metavar="B")],
    save: Annotated[Path | None, typer.Option(help="Write both, aligned, to an .rrd file for rerun.")] = None,
    web: Annotated[bool, typer.Option("--web", help="Serve that to a browser on this machine.")] = False,
    screenshot: Annotated[Path | None, typer.Option(help="Write a .png or .jpg of that; needs no screen.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The differences as JSON.")] = False,
) -> None:
    """Compare two calibrations of one rig: aligned, with each difference beside its sigma.

    Example: rig compare monday.mcap friday.mcap --save difference.rrd
    """
    a, b = read_any_rig(first), read_any_rig(second)
    found = compare_rigs(a, b)
    if as_json:
        print(json_text(comparison_values(found)))
    else:
        _print(found)
    if web or save or screenshot:
        rerun_show.show(_shown(a, b, found), save, web, screenshot)


def comparison_values(found: Comparison) -> dict:
    """The differences for programs, B minus A in A's frame."""
    return {
        "cameras": {one.name: _values(one) for one in found.cameras},
        "a_from_b": found.first_from_second.matrix().tolist(),
        "only_a": list(found.only_first),
        "only_b": list(found.only_second),
        "chance": found.chance,
    }


def summary(found: Comparison) -> list[str]:
    """The comparison in sentences."""
    sentences = []
    if np.isnan(found.chance):
        sentences.append("Whether the rigs agree cannot be said: one of them does not state how sure it is.")
    elif found.chance < _UNLIKELY:
        worst = max(found.cameras, key=lambda one: one.sigmas)
        sentences.append(
            f"The rigs differ by more than their sigmas allow, most at {worst.name} ({worst.sigmas:.1f} sigmas)."
        )
    else:
        sentences.append("The rigs agree within their sigmas.")
    for which, names in (("first", found.only_first), ("second", found.only_second)):
        if names:
            sentences.append(f"Only in the {which}: {', '.join(names)}.")
    return sentences


def _print(found: Comparison) -> None:
    from quadrig.io.plain_words import console
    from quadrig.io.report.terminal import print_sentence, print_table

    where = console()
    styles = ["bold red" if one.chance < _UNLIKELY else None for one in found.cameras]
    print_table(difference_columns(found), where, "second minus first, in the frame of the first", styles)
    for line in (ONE_SIGMA, *summary(found)):
        print_sentence(line, where)


def _values(one: CameraDifference) -> dict:
    return {
        "focal_px": one.focal,
        "focal_sigma_px": one.focal_sigma,
        "shift_mm": 1e3 * one.shift,
        "shift_sigma_mm": 1e3 * one.shift_sigma,
        "turn_deg": np.degrees(one.rotation),
        "turn_sigma_deg": np.degrees(one.rotation_sigma),
        "sigmas": one.sigmas,
        "chance": one.chance,
    }


def _shown(first: Rig, second: Rig, found: Comparison) -> rerun_show.Shown:
    from quadrig.io.viewer.inspect.comparison import comparison_blueprint, log_comparison

    return rerun_show.Shown(
        comparison_blueprint(first),
        lambda stream, _one_look: log_comparison(stream, first, second, found, summary(found)),
    )
