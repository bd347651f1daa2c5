"""`rig compare`: two calibrations of one rig."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from quadrig.io.drawing.differences import ALONG, difference_columns, difference_sentences
from quadrig.io.formats.any_file import read_any_rig
from quadrig.io.formats.rig_json import json_text
from quadrig.io.viewer import show as rerun_show
from quadrig.rig.comparison import CameraDifference, Comparison, renamed
from quadrig.rig.comparison import compare as compare_rigs
from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError


def compare(
    first: Annotated[Path, typer.Argument(help="A rig.mcap, or any format that is read.", metavar="A")],
    second: Annotated[Path, typer.Argument(help="Another of the same cameras.", metavar="B")],
    rename: Annotated[
        list[str] | None, typer.Option(metavar="OLD=NEW", help="Take B's camera OLD for A's NEW; repeatable.")
    ] = None,
    save: Annotated[Path | None, typer.Option(help="Write both, aligned, to an .rrd file for rerun.")] = None,
    web: Annotated[bool, typer.Option("--web", help="Serve that to a browser on this machine.")] = False,
    screenshot: Annotated[Path | None, typer.Option(help="Write a .png or .jpg of that; needs no screen.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The differences as JSON.")] = False,
) -> None:
    """Compare two calibrations of one rig: aligned, with each difference beside its sigma.

    Example: rig compare monday.mcap friday.mcap --save difference.rrd
    """
    a, b = read_any_rig(first), renamed(read_any_rig(second), _pairs(rename or []))
    found = compare_rigs(a, b)
    if as_json:
        print(json_text(comparison_values(found)))
    else:
        _print(found)
    if web or save or screenshot:
        rerun_show.show(_shown(a, b, found), save, web, screenshot)


def comparison_values(found: Comparison) -> dict:
    """The differences for programs, B minus A in A's frame. agree: null where nobody can say."""
    return {
        "agree": not any(one.differs for one in found.cameras) if found.tests else None,
        "cameras": {one.name: _values(found, one) for one in found.cameras},
        "a_from_b": found.first_from_second.matrix().tolist(),
        "only_a": list(found.only_first),
        "only_b": list(found.only_second),
        "chance": found.chance(found.worst),
    }


def _print(found: Comparison) -> None:
    from quadrig.io.plain_words import console
    from quadrig.io.report.terminal import print_sentence, print_table

    where = console()
    styles = ["bold red" if one.differs else None for one in found.cameras]
    print_table(difference_columns(found), where, "second minus first, in the frame of the first", styles)
    for line in (ALONG, *difference_sentences(found)):
        print_sentence(line, where)


def _values(found: Comparison, one: CameraDifference) -> dict:
    return {
        "focal_px": one.focal,
        "focal_sigma_px": one.focal_sigma,
        "shift_mm": 1e3 * one.shift,
        "shift_sigma_mm": 1e3 * one.shift_sigma,
        "turn_deg": np.degrees(one.rotation),
        "turn_sigma_deg": np.degrees(one.rotation_sigma),
        "chances": {part: apart.chance for part, apart in one.apart.items()},
        "chance": found.chance(one),
        "differs": list(one.differs),
    }


def _pairs(rename: Sequence[str]) -> dict[str, str]:
    """Names by the names of B that they replace. Raises QuadrigError where one is no pair."""
    pairs = {}
    for one in rename:
        old, _, new = one.partition("=")
        if not (old and new):
            raise QuadrigError(f"--rename {one!r} is no pair; give OLD=NEW, a camera of B and what A calls it")
        pairs[old] = new
    return pairs


def _shown(first: Rig, second: Rig, found: Comparison) -> rerun_show.Shown:
    from quadrig.io.viewer.inspect.comparison import comparison_blueprint, log_comparison

    return rerun_show.Shown(
        comparison_blueprint(first),
        lambda stream, _one_look: log_comparison(stream, first, second, found),
    )
