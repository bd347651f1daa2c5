"""`rig setup`: calibrate live cameras, coached."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from quadrig.io.config.rig_toml import read_config
from quadrig.io.formats.rig_json import json_text
from quadrig.io.live.capture.chosen_sources import named_sources
from quadrig.io.live.capture.source import Pace
from quadrig.io.live.display import Screen
from quadrig.io.live.plan import SetupPlan, SetupResult, check_plan
from quadrig.io.live.session import run_setup
from quadrig.io.live.terminal import enter_pressed
from quadrig.io.plain_words import console
from quadrig.io.rig_file.rig_mcap import refuse_no_rig, write_rig
from quadrig.io.verbosity import note, say
from quadrig.io.whole_file import place_held
from quadrig.rig.words import read_length
from quadrig.single.errors import QuadrigError

# m; as millimetres, so little would be less than a sheet of paper bends.
_BARE_ACCURACY = 0.01


def setup(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            help="Cameras: a number, /dev/video0, rtsp://..., http://..., a video, a folder of pictures or "
            "watch:FOLDER; NAME=SOURCE gives a name. Those of rig.toml where none is given.",
            metavar="[NAME=]SOURCE",
        ),
    ] = None,
    config: Annotated[Path, typer.Option(help="The rig.toml with the rectangles.")] = Path("rig.toml"),
    output: Annotated[Path, typer.Option("--output", "-o", help="The rig to write.")] = Path("rig.mcap"),
    until: Annotated[str, typer.Option(help="Stop at this accuracy, such as 1mm.", metavar="LENGTH")] = "",
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the recording that is there.")] = False,
    again: Annotated[bool, typer.Option("--again", help="Start again over a recording that is there.")] = False,
    web: Annotated[bool, typer.Option("--web", help="Show it in a browser, at 127.0.0.1.")] = False,
    no_viewer: Annotated[bool, typer.Option("--no-viewer", help="Show it on the terminal only.")] = False,
    save: Annotated[Path | None, typer.Option(help="Write what the viewer shows to an .rrd instead.")] = None,
    fast: Annotated[bool, typer.Option("--fast", help="Play files as fast as they can be searched.")] = False,
    tolerance: Annotated[
        float | None, typer.Option(help="Seconds between frames of one instant; from the rates where not given.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The result as JSON.")] = False,
) -> None:
    """Calibrate live cameras, coached: hold the sheet where it says until it says it is good.

    Stops at the accuracy of --until, on Enter, on Ctrl-C, or when every source has ended. Leaves the recording
    (OUTPUT-recording.mcap, written as it goes), the rig, and a report of it (OUTPUT.html).

    Examples: rig setup --until 1mm; rig setup left=0 right=1 -o desk.mcap;
    rig setup http://127.0.0.1:8080/video cam1.mp4 --no-viewer
    """
    wanted = read_length(until, _BARE_ACCURACY) if until else None
    rig_config = read_config(config)
    cameras = named_sources(sources or [], rig_config, config.parent)
    for remark in check_plan(rig_config, list(cameras)):
        note(remark)
    pace: Pace = "consumed" if fast else "real time"
    refuse_no_rig(output)
    with place_held(output):
        recording, earlier, replaced = _recordings(output, resume, again)
        plan = SetupPlan(rig_config, cameras, recording, wanted, pace, earlier, tolerance, replaced)
        result = _run(plan, web, no_viewer, save)
        if result.rig is None:
            kept = f"; the recording is {recording}, and --resume goes on from it" if recording.exists() else ""
            raise QuadrigError(f"{result.trouble}{kept}")
        write_rig(output, result.rig, rig_config.text, recordings=[recording])
        _write_report(output)
    if as_json:
        print(_as_json(result, output, plan))
    else:
        _print(result, output, plan)


def _write_report(output: Path) -> None:
    """The page that shows a person what the rig is good for, beside it."""
    from quadrig.io.report.page import report_html
    from quadrig.io.rig_file.rig_mcap import read_rig_file
    from quadrig.io.whole_file import write_text

    write_text(output.with_suffix(".html"), report_html(read_rig_file(output), output.name))


def _recordings(output: Path, resume: bool, again: bool) -> tuple[Path, tuple[Path, ...], tuple[Path, ...]]:
    """The recording to write, those to go on from, and those that it replaces.

    Raises QuadrigError where one would be lost.
    """
    first = output.with_name(f"{output.stem}-recording.mcap")
    parts = sorted(output.parent.glob(f"{output.stem}-recording-[0-9]*.mcap"), key=_part)
    earlier = tuple(path for path in (first, *parts) if path.exists())
    if resume:
        if not earlier:
            raise QuadrigError(f"{first}: there is no recording to go on from; leave --resume out")
        return output.with_name(f"{output.stem}-recording-{_part(earlier[-1]) + 1}.mcap"), earlier, ()
    if earlier and not again:
        raise QuadrigError(
            f"{earlier[0]} is there already; go on from it with --resume, or start again over it with --again"
        )
    return first, (), tuple(path for path in earlier if path != first)


def _part(path: Path) -> int:
    """The number of a part of a recording; the first has none."""
    number = path.stem.rsplit("-", 1)[-1]
    return int(number) if number.isdigit() else 1


def _run(plan: SetupPlan, web: bool, no_viewer: bool, save: Path | None) -> SetupResult:
    screens, viewer = _screens(plan, web, no_viewer, save)
    try:
        return run_setup(plan, screens, enter_pressed())
    finally:
        for screen in screens:
            screen.close()
        if viewer is not None:
            viewer.close()


def _screens(plan: SetupPlan, web: bool, no_viewer: bool, save: Path | None):
    """The terminal, and beside it a viewer where there is one; a window that cannot open is reported, not fatal."""
    from quadrig.io.live.terminal import PlainScreen, TerminalScreen

    screens: list[Screen] = []
    viewer = None
    if save is not None or not no_viewer:
        from quadrig.io.viewer.process import Viewer
        from quadrig.io.viewer.setup.screen import RerunScreen
        from quadrig.io.viewer.web_page import PageViewer

        try:
            if save is None:
                viewer = PageViewer() if web else Viewer()
                if isinstance(viewer, PageViewer):
                    say(f"look at {viewer.page}")
            screens.append(RerunScreen(tuple(plan.sources), plan.config.rectangles, viewer, save))
        except QuadrigError as error:
            if web:
                raise
            print(f"rig: {error}", file=sys.stderr)
    screens.append(TerminalScreen() if sys.stderr.isatty() else PlainScreen())
    return screens, viewer


def _print(result: SetupResult, output: Path, plan: SetupPlan) -> None:
    from quadrig.io.report.table import print_rig
    from quadrig.io.report.terminal import print_sentence

    rig, where = result.rig, console()
    assert rig is not None
    print_rig(rig, where)
    missing = _missing(result, plan)
    # What is missing of the rig itself stands among what is weak.
    sentences = [sentence for name, sentence in missing.items() if name not in rig.missing]
    if result.fault is not None:
        sentences.append(result.fault.sentence)
    if result.dropped:
        sentences.append(f"{result.dropped} frames were not recorded: the disk could not keep up")
    sentences.append(f"{result.kept} framesets kept of {result.framesets}, {result.ending}")
    where.print()
    for sentence in (*sentences, f"written: {output}, {output.with_suffix('.html')}, {plan.recording}"):
        print_sentence(sentence, where)


def _missing(result: SetupResult, plan: SetupPlan) -> dict[str, str]:
    """A sentence for each camera that is not in the rig, those that never gave a picture among them."""
    came = {camera.name for camera in result.cameras}
    blind = {name: f"{name} gave no picture; look at its source" for name in plan.sources if name not in came}
    return {**(result.rig.missing if result.rig else {}), **blind}


def _as_json(result: SetupResult, output: Path, plan: SetupPlan) -> str:
    rig = result.rig
    assert rig is not None
    latencies = sorted(result.latencies)
    return json_text(
        {
            "working_accuracy_mm": 1000 * rig.working_accuracy,
            "cameras": [camera.name for camera in rig.cameras],
            "missing": _missing(result, plan),
            "fault": result.fault.sentence if result.fault else None,
            "framesets": result.framesets,
            "kept": result.kept,
            "seconds": result.seconds,
            "framesets_per_second": result.framesets / max(result.seconds, 1e-9),
            "latency_ms": 1000 * latencies[len(latencies) // 2] if latencies else None,
            "latency_95_ms": 1000 * latencies[int(0.95 * len(latencies))] if latencies else None,
            "ending": result.ending,
            "dropped": result.dropped,
            "rig": str(output),
            "report": str(output.with_suffix(".html")),
            "recording": str(plan.recording),
        },
    )
