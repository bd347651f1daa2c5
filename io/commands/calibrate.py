"""`rig calibrate`: a recording and a rig.toml in, a rig.mcap and a table out."""

import math
import sys
from contextlib import ExitStack, nullcontext
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from quadrig.io.verbosity import note, say, timed
from quadrig.io.whole_file import place_held
from quadrig.single.errors import QuadrigError

if TYPE_CHECKING:
    from quadrig.io.batch.calibrate_one import CalibrateOne
    from quadrig.io.search.dry_run import SearchPlan
    from quadrig.io.search.whole_recording import Searched
    from quadrig.rig.result import Rig


def calibrate(
    recording: Annotated[
        list[Path],
        typer.Argument(help="MCAP files, videos, folders, or one picture a camera.", metavar="RECORDING"),
    ],
    config: Annotated[Path, typer.Option("--config", "-c", help="What stands in the room.")] = Path("rig.toml"),
    output: Annotated[Path, typer.Option("--output", "-o", help="The rig to write.")] = Path("rig.mcap"),
    only: Annotated[
        list[str] | None, typer.Option(help="Re-solve this camera; the others stay as --from has them; repeatable.")
    ] = None,
    before: Annotated[Path | None, typer.Option("--from", help="The rig.mcap from before a camera moved.")] = None,
    lenses: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[NAME=]FILE", help="Lenses known before, with their doubt, from a rig of any format; repeatable."
        ),
    ] = None,
    keep_lenses: Annotated[
        bool, typer.Option("--keep-lenses", help="Leave the lenses of --lenses as they are.")
    ] = False,
    all_cameras: Annotated[
        bool, typer.Option("--all-cameras", help="Fail, and write no rig, where a camera cannot be placed.")
    ] = False,
    tolerance: Annotated[float | None, typer.Option(help="Most that stamps of one instant differ, seconds.")] = None,
    rate: Annotated[
        float | None, typer.Option(help="Pictures a second, where image files carry no time of their own.")
    ] = None,
    share: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Search only this share of the framesets, the best ones.")
    ] = 1.0,
    cache: Annotated[
        Path | None,
        typer.Option(help="Where what was found is kept for the next run; else rig.detections.mcap beside rig.mcap."),
    ] = None,
    no_cache: Annotated[bool, typer.Option("--no-cache", help="Keep nothing, and search every image again.")] = False,
    workers: Annotated[int | None, typer.Option(min=1, help="Worker processes; else one a processor.")] = None,
    each: Annotated[
        bool,
        typer.Option("--each", help="Every RECORDING is a rig of its own; --output is their folder."),
    ] = False,
    dask: Annotated[str | None, typer.Option(help="With --each: a Dask scheduler, tcp://HOST:8786.")] = None,
    again: Annotated[bool, typer.Option("--again", help="With --each: those done before, too.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be searched and how long it takes; write nothing.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="The result as JSON, for programs.")] = False,
) -> None:
    """Calibrate the cameras of a recording.

    Finds the rectangles of rig.toml in every image, solves lenses and poses together, with how sure each is, and
    writes rig.mcap. Cameras that share no rectangle with the others are not placed: the reason is given, and they
    have their lens all the same, as one camera alone has. What was found is kept in rig.detections.mcap: the same
    command does not search again what was searched, also after Ctrl-C.

    Example: rig calibrate room.mcap --config rig.toml -o rig.mcap

    Corners clicked with `rig pick`, in corners.toml beside rig.toml: rig calibrate left.jpg middle.jpg right.jpg

    Boards shown to each camera, and a scene that all see: rig calibrate boards/ scene.mcap

    Lenses from the laboratory, poses on site: rig calibrate site.mcap --lenses laboratory.rig.mcap

    One camera was moved: rig calibrate new.mcap --only cam2 --from rig.mcap -o rig2.mcap

    Many recordings, one rig each: rig calibrate recordings/ --each -o rigs/
    """
    # What works is loaded when there is work: `--help` is not to wait for it.
    from quadrig.io.batch.calibrate_one import CalibrateOne
    from quadrig.io.config.rig_toml import read_config
    from quadrig.io.rig_file.rig_mcap import read_rig, refuse_no_rig, write_rig
    from quadrig.io.search.detection_file import detections_beside
    from quadrig.io.search.dry_run import plan_search
    from quadrig.io.search.effort import Effort
    from quadrig.io.search.known_lenses import read_known_lenses
    from quadrig.io.search.whole_recording import refuse_missing, search_recording

    described = read_config(config)
    if bool(only) != (before is not None):
        raise QuadrigError("--only and --from belong together: give the camera that moved and the rig from before")
    if keep_lenses and not lenses:
        raise QuadrigError("--keep-lenses without --lenses; give the file of the lenses that are to be kept")
    if cache is not None and (no_cache or each):
        other = "--each, which keeps what was found beside each result" if each else "--no-cache"
        raise QuadrigError(f"--cache does not go with {other}; leave one of them out")
    known = read_known_lenses(lenses or [])
    if each:
        calibrate_one = CalibrateOne(
            described.text,
            tolerance,
            share,
            all_cameras,
            keep=not no_cache,
            corners=described.corners,
            rate=rate,
            lenses=known,
            keep_lenses=keep_lenses,
        )
        if dry_run:
            _list_each(recording, output, again)
        else:
            _calibrate_each(recording, output, calibrate_one, workers, dask, again)
        return
    if dask is not None or again:
        option = "--dask" if dask is not None else "--again"
        raise QuadrigError(f"{option} is for many recordings; give them with --each")
    refuse_no_rig(output)
    if not no_cache:
        cache = cache or detections_beside(output)
    earlier = read_rig(before) if before is not None else None
    effort = Effort(tolerance, share, workers, cache, rate=rate)
    if dry_run:
        _show_plan(plan_search(recording, described, effort, lenses=known, keep_lenses=keep_lenses), as_json)
        return
    with ExitStack() as held:
        for place in (output, cache):
            if place is not None:
                held.enter_context(place_held(place))
        searched = search_recording(recording, described, effort, lenses=known, keep_lenses=keep_lenses)
        rig = _solve(searched, only or [], earlier, cache)
        if all_cameras:
            refuse_missing(rig)
        for sentence in rig.missing.values():
            print(f"not placed: {sentence}", file=sys.stderr)
        write_rig(output, rig, described.text, searched.times, recording)
    _show(rig, output, as_json)


def _solve(searched: "Searched", only: list[str], earlier: "Rig | None", cache: Path | None) -> "Rig":
    from quadrig.io.search.whole_recording import calibrate_searched

    for remark in searched.notes:
        note(remark)
    try:
        with timed(f"solving {len(searched.views)} Views of {len(searched.cameras)} cameras"):
            return calibrate_searched(searched) if earlier is None else _solve_again(searched, only, earlier)
    except KeyboardInterrupt:
        if cache is not None:
            print(f"stopped: what was found is kept in {cache}; the same command goes on from there", file=sys.stderr)
        raise


def _show_plan(plan: "SearchPlan", as_json: bool) -> None:
    from quadrig.io.plain_words import console
    from quadrig.io.report.terminal import print_sentence
    from quadrig.io.search.dry_run import plan_values, plan_words

    for remark in plan.notes:
        note(remark)
    if as_json:
        from quadrig.io.formats.rig_json import json_text

        print(json_text(plan_values(plan)))
        return
    where = console()
    for line in plan_words(plan).splitlines():
        print_sentence(line, where)


def _solve_again(searched: "Searched", only: list[str], earlier: "Rig") -> "Rig":
    from quadrig.rig.recalibration import recalibrate

    rig = recalibrate(earlier, only, searched.cameras, searched.rectangles, searched.views)
    # A camera of the earlier rig that this recording does not hold stays as it was: nothing is missing.
    held = {camera.name for camera in earlier.cameras}
    return replace(rig, missing={name: why for name, why in rig.missing.items() if name not in held})


def _list_each(recordings: list[Path], output: Path, again: bool) -> None:
    from quadrig.io.batch.fleet import find_jobs, is_done

    for job in find_jobs(recordings, output):
        kept = is_done(job) and not again
        print(f"{job.output}: {'kept' if kept else f'to be made from {job.recording[0]}'}")


def _calibrate_each(
    recordings: list[Path],
    output: Path,
    calibrate_one: "CalibrateOne",
    workers: int | None,
    dask: str | None,
    again: bool,
) -> None:
    from quadrig.io.batch.fleet import dask_executor, find_jobs, run_fleet

    if output.suffix == ".mcap":
        raise QuadrigError(f"--each writes many results and {output} is one file; give a folder with --output")
    jobs = find_jobs(recordings, output)
    output.mkdir(parents=True, exist_ok=True)
    failed = done = 0
    try:
        # Named as the results are: it is they that another run would make at the same time.
        with place_held(output / "*.rig.mcap"), dask_executor(dask) if dask else nullcontext() as executor:
            for outcome in run_fleet(calibrate_one, jobs, workers, executor, again):
                state = "failed: " if outcome.failed else "" if outcome.kept else f"{outcome.seconds:.0f} s: "
                print(f"{outcome.job.output}: {state}{outcome.message}", flush=True)
                failed += outcome.failed
                done += not outcome.failed
    except KeyboardInterrupt:
        print(f"stopped: {done} of {len(jobs)} rigs are made; the same command goes on from there", file=sys.stderr)
        raise
    if failed:
        raise QuadrigError(f"{failed} of {len(jobs)} recordings failed; their lines above say why")


def _show(rig: "Rig", output: Path, as_json: bool) -> None:
    if as_json:
        from quadrig.io.formats.rig_json import json_text

        print(json_text(result_values(rig)))
        return
    from quadrig.io.report.table import print_rig

    print_rig(rig)
    say(f"\n{output}: look at it with `rig inspect {output}`")


def result_values(rig: "Rig") -> dict[str, object]:
    """The values of `rig export --format json`, and with them how well all fits, what is weak, who is missing."""
    from quadrig.io.formats.rig_json import rig_values
    from quadrig.rig.doubt.verdict import verdict

    judged = verdict(rig)
    return {
        **rig_values(rig),
        "rms_px": rig.rms,
        "left_out_rms_px": rig.held_out_rms,
        "noise_px": rig.noise,
        "views": {camera.name: camera.views for camera in rig.cameras},
        "grade": judged.grade,
        "weak": list(judged.weak),
        "missing": dict(rig.missing),
        "relative": [_between(rig, one.name, two.name) for one, two in combinations(rig.cameras, 2)],
    }


def _between(rig: "Rig", one: str, two: str) -> dict[str, object]:
    """How far apart two cameras are, and how sure their relative pose is: sigmas of one direction and one axis."""
    variance = rig.relative_covariance(one, two).diagonal()
    step = rig.camera(one).rig_from_camera.translation - rig.camera(two).rig_from_camera.translation
    return {
        "cameras": [one, two],
        "distance_m": math.hypot(*step),
        "sigma": {
            "rotation_deg": math.degrees(math.sqrt(max(variance[:3].sum() / 3, 0.0))),
            "position_m": math.sqrt(max(variance[3:].sum() / 3, 0.0)),
        },
    }
