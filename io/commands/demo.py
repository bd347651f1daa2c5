"""`rig demo`: a rendered room into a recording, through the very path of `rig calibrate`, and beside the truth."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from quadrig.io.commands.calibrate import result_values
from quadrig.io.config.rig_toml import read_config, write_config
from quadrig.io.demo.rendered_recording import demo_config, write_demo_recording
from quadrig.io.demo.scene import Scene, demo_scene
from quadrig.io.demo.truth import TruthCheck, all_within, compare_with_truth
from quadrig.io.plain_words import console
from quadrig.io.report.table import print_rig
from quadrig.io.report.terminal import print_sentence, print_table
from quadrig.io.rig_file.rig_mcap import read_rig_file, write_rig
from quadrig.io.search.effort import Effort
from quadrig.io.search.whole_recording import calibrate_searched, refuse_missing, search_recording
from quadrig.io.verbosity import say
from quadrig.rig.result import Rig
from quadrig.rig.words import Column, sigma_figure, with_sigma
from quadrig.single.errors import QuadrigError


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder to write to.")] = Path("rig-demo"),
    framesets: Annotated[int, typer.Option(min=4, help="How many instants are recorded.")] = 24,
    workers: Annotated[int | None, typer.Option(min=1, help="Worker processes; else one a processor.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The result as JSON, for programs.")] = False,
) -> None:
    """Render a room with four distorted cameras, calibrate them, and compare with the truth.

    Leaves a folder with the recording, its rig.toml, the result rig.mcap, and demo.rrd to open in rerun.

    Example: rig demo -o rig-demo
    """
    began = time.monotonic()
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise QuadrigError(f"{output}: cannot be made a folder ({error.strerror}); choose another place") from error
    scene = demo_scene(framesets)
    recording, described = output / "recording.mcap", output / "rig.toml"
    write_demo_recording(recording, scene, workers)
    write_config(demo_config(scene), described)
    rig = _calibrate(recording, described, output / "rig.mcap", workers)
    from quadrig.io.commands.inspect import save_rrd

    save_rrd(output / "demo.rrd", read_rig_file(output / "rig.mcap"), [recording])
    written = [recording, described, output / "rig.mcap", output / "demo.rrd"]
    _show(rig, scene, written, as_json)
    say(f"{time.monotonic() - began:.0f} s in all")


def _calibrate(recording: Path, described: Path, result: Path, workers: int | None) -> Rig:
    config = read_config(described)
    searched = search_recording([recording], config, Effort(workers=workers))
    rig = calibrate_searched(searched)
    refuse_missing(rig)
    write_rig(result, rig, config.text, searched.times, [recording])
    return rig


def _show(rig: Rig, scene: Scene, written: Sequence[Path], as_json: bool) -> None:
    compared = compare_with_truth(rig, scene)
    if as_json:
        from quadrig.io.formats.rig_json import json_text

        values = result_values(rig) | {"truth": {one.camera: _truth_values(one) for one in compared}}
        print(json_text(values))
        return
    where = console()
    print_rig(rig, where)
    print_table(_truth_columns(rig, compared), where, "beside the truth")
    figures = 3 * len(compared)
    held = figures if all_within(compared) else sum(sum(one.within) for one in compared)
    many = f"all {figures}" if held == figures else f"{held} of {figures}"
    print_sentence(f"the truth lies within the sigmas (99.7 %) in {many} figures", where)
    where.print()
    print_sentence("written: " + ", ".join(str(path) for path in written), where)


def _truth_values(one: TruthCheck) -> dict[str, object]:
    return {
        "focal_px": one.focal_truth,
        "position_error_m": one.position_error,
        "rotation_error_deg": float(np.degrees(one.rotation_error)),
        "within_sigma": dict(zip(("focal", "position", "rotation"), one.within, strict=True)),
    }


def _truth_columns(rig: Rig, compared: Sequence[TruthCheck]) -> list[Column]:
    def of_pose(figure: Callable[[TruthCheck], str]) -> tuple[str, ...]:
        return tuple("" if one.camera == rig.reference else figure(one) for one in compared)

    return [
        Column("camera", "", tuple(one.camera for one in compared), words=True),
        Column("focal", "px", tuple(with_sigma(one.focal, one.focal_sigma) for one in compared)),
        Column("truth", "px", tuple(f"{one.focal_truth:.2f}" for one in compared)),
        Column("off by", "mm", of_pose(lambda one: sigma_figure(1e3 * one.position_error))),
        Column("position", "± mm", of_pose(lambda one: sigma_figure(1e3 * one.position_sigma))),
        Column("off by", "deg", of_pose(lambda one: sigma_figure(np.degrees(one.rotation_error)))),
        Column("rotation", "± deg", of_pose(lambda one: sigma_figure(np.degrees(one.rotation_sigma)))),
        Column("truth within", "sigma", tuple(_verdict(one) for one in compared)),
    ]


def _verdict(one: TruthCheck) -> str:
    outside = [n for n, w in zip(("focal", "position", "rotation"), one.within, strict=True) if not w]
    return "not " + ", ".join(outside) if outside else "yes"
