"""Wrong input, right answer: a tenth of the Views spoilt, errors against the clean ones, and whether they are named.

Three faults, each by itself on the same rigs, and all at once: a View under another rectangle's name, four corners
that begin at the wrong one, a single corner 20 px off. Board Views have no order to shift: tags and quads do.

    python benchmarks/wrong_input.py [RIGS]
"""

import sys
from collections import defaultdict
from dataclasses import replace
from multiprocessing import Pool

import numpy as np
from rich.console import Console
from rich.table import Table
from simulated import Errors, Simulated, errors, simulate, usual_scene

from quadrig.rig.calibration import calibrate
from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.view import View

FAULTS = ("wrong id", "order shifted", "corner 20 px off", "all three")
KINDS = {"board and tags": {"board": True}, "four corners": {"board": False, "distortion": False}}
SHARE = 0.1
_CORNER_OFF = 20.0


def _key(view: View) -> tuple[str, str, int]:
    return view.camera, view.rectangle, view.frameset


def spoilt(rng: np.random.Generator, made: Simulated, fault: str) -> tuple[Simulated, set, set]:
    """The rig with a tenth of its Views wrong; keys of those wrong as a whole, and of those with one wrong corner."""
    views, whole, single = list(made.views), set(), set()
    count = max(1, round(SHARE * len(views)))
    kinds = FAULTS[:3] if fault == "all three" else (fault,)
    order = [int(i) for i in rng.permutation(len(views))]
    for number in range(count):
        kind = kinds[number % len(kinds)]
        done = False
        for index in order:
            view = views[index]
            if _key(view) in whole | single:
                continue
            if kind == "wrong id":
                done = _renamed(rng, made, views, index, whole)
            elif kind == "order shifted" and len(view.pixels) == 4:
                views[index] = replace(view, pixels=np.roll(view.pixels, int(rng.integers(1, 4)), axis=0))
                whole.add(_key(view))
                done = True
            elif kind == "corner 20 px off":
                pixels, turn = view.pixels.copy(), rng.uniform(0, 2 * np.pi)
                pixels[rng.integers(len(pixels))] += _CORNER_OFF * np.array([np.cos(turn), np.sin(turn)])
                views[index] = replace(view, pixels=pixels)
                single.add(_key(view))
                done = True
            if done:
                break
    return replace(made, views=tuple(views)), whole, single


def _renamed(rng: np.random.Generator, made: Simulated, views: list[View], index: int, whole: set) -> bool:
    """Give the View's pixels to another rectangle, or frameset, that its camera did not see then."""
    view = views[index]
    taken = {_key(v) for v in views}
    still = not view.rectangle.startswith("sheet")
    names = [r.name for r in made.rectangles if not r.moving and r.name != view.rectangle] if still else ["sheet"]
    framesets = sorted({v.frameset for v in views if v.rectangle == "sheet"})
    for _ in range(20):
        if not names:
            return False
        other = str(rng.choice(names))
        frameset = view.frameset if still else int(rng.choice(framesets))
        if (view.camera, other, frameset) not in taken:
            views[index] = replace(view, rectangle=other, frameset=frameset)
            whole.add((view.camera, other, frameset))
            return True
    return False


def named(rig: Rig, made: Simulated, whole: set, single: set) -> tuple[int, int, int, int, int]:
    """How many wrong Views were thrown out; how many of those outnumbered, and how many these are; how many Views
    of a wrong corner were touched; and how many good Views were thrown out."""
    thrown = {_key(fit.view) for fit in rig.fits if fit.rejected}
    touched = {_key(fit.view) for fit in rig.fits if fit.rejected or not fit.used.all()}
    beaten = outnumbered(made, whole)
    return len(thrown & whole), len(thrown & beaten), len(beaten), len(touched & single), len(thrown - whole - single)


def outnumbered(made: Simulated, whole: set) -> set:
    """The wrong Views whose rectangle pose was seen rightly by two other cameras, the least that can say so."""
    moving = {r.name for r in made.rectangles if r.moving}
    right: dict[tuple[str, int], set[str]] = defaultdict(set)
    for view in made.views:
        if _key(view) not in whole:
            right[view.rectangle, view.frameset if view.rectangle in moving else -1].add(view.camera)
    return {
        (camera, rectangle, frameset)
        for camera, rectangle, frameset in whole
        if len(right[rectangle, frameset if rectangle in moving else -1] - {camera}) >= 2
    }


def one(task: tuple[int, str]) -> tuple[str, list]:
    """Errors of one rig, clean and with each fault."""
    seed, kind = task
    rng = np.random.default_rng([seed, list(KINDS).index(kind), 7])
    made = simulate(rng, usual_scene(rng, **KINDS[kind], tags=3))
    rows = []
    for fault in ("clean", *FAULTS):
        given, whole, single = (made, set(), set()) if fault == "clean" else spoilt(rng, made, fault)
        try:
            rig = calibrate(given.inputs, given.rectangles, given.views, reference="cam0")
        except (QuadrigError, np.linalg.LinAlgError) as error:
            rows.append((fault, None, str(error)[:80], len(whole), len(single)))
            continue
        rows.append((fault, errors(made, rig), named(rig, given, whole, single), len(whole), len(single)))
    return kind, rows


def main() -> None:
    """Print one table."""
    rigs = int(sys.argv[1]) if len(sys.argv) > 1 else 30
    gathered: dict[tuple[str, str], list] = defaultdict(list)
    with Pool(2) as pool:
        for kind, rows in pool.imap_unordered(one, [(seed, kind) for kind in KINDS for seed in range(rigs)]):
            for row in rows:
                gathered[kind, row[0]].append(row[1:])
    table = Table(title=f"{SHARE:.0%} of the Views wrong, {rigs} rigs of each kind: mean errors, over the clean ones")
    counts = ("Views named", "outnumbered ones", "corners named", "good ones out", "failed")
    for column in ("rigs", "fault", "focal %", "deg", "mm", "ratios", *counts):
        table.add_column(column, justify="right")
    for (kind, fault), rows in gathered.items():
        good = [row for row in rows if row[0] is not None]
        mean = _mean([row[0] for row in good])
        clean = _mean([row[0] for row in gathered[kind, "clean"] if row[0] is not None])
        ratios = " ".join(f"{a / b:.2f}" for a, b in zip(mean, clean, strict=True))
        found = np.sum([row[1] for row in good], axis=0)
        views, corners = sum(row[2] for row in good), sum(row[3] for row in good)
        table.add_row(
            kind,
            fault,
            *(f"{value:.3f}" for value in mean),
            ratios,
            f"{found[0]} of {views}",
            f"{found[1]} of {found[2]}",
            f"{found[3]} of {corners}",
            str(found[4]),
            str(len(rows) - len(good)),
        )
    console = Console(width=140)
    console.print(table)
    console.print("aim: ratios at most 1.3, every wrong View named")


def _mean(every: list[Errors]) -> tuple[float, float, float]:
    focal, rotation, centre = np.mean([(e.focal, e.rotation, e.centre) for e in every], axis=0).tolist()
    return focal, rotation, centre


if __name__ == "__main__":
    main()
