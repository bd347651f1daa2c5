"""One thing wrong in an otherwise good rig: is the rig of the others right, and is the culprit named?

Lenses come from the table of real ones and sheets are printed with real faults (benchmarks/worlds.py). right: all
other cameras are placed, none of their poses or focals beyond five sigmas; inside: share of their poses inside the
95 % region; named: a sentence names the culprit and what to check; others: share of rigs in which somebody else is
accused. Of clean rigs, which come first, nobody is to be accused; nor of lenses that are 0 or 1 % off.

    python benchmarks/culprits.py [RIGS] [--fault FAULT] [--world WORLD]
"""

import argparse
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from coverage import quantile
from rich.console import Console
from rich.table import Table
from simulated import HEIGHT, WIDTH, Simulated
from worlds import WORLDS, draw, given_lens

from quadrig.rig.calibration import calibrate
from quadrig.rig.doubt.verdict import verdict
from quadrig.rig.problem.build import build_problem
from quadrig.rig.problem.connectivity import components
from quadrig.rig.result import Rig
from quadrig.single.errors import QuadrigError
from quadrig.single.pose import Pose
from quadrig.single.view import View

# The quantile of a Gaussian five sigmas off, on both sides.
_FIVE_SIGMAS = 1 - 5.7e-7
FAULT_WORLDS = ("rich", "few Views", "one sheet")
# Words that only an accusation has.
ACCUSING = (
    "lens that was given",
    "size that was given",
    "mirrored",
    "contradicts the other cameras",
    "no pictures of",
    "another size",
    "outside of its picture",
    "in no picture",
)


@dataclass(frozen=True)
class Planted:
    """A rig with a fault. culprit: the name that a sentence must bear, None where nothing can be known; words: one of
    which it must bear; spoilt: the camera whose own pose is not asked for, None where all are to be right."""

    made: Simulated
    culprit: str | None
    words: tuple[str, ...] = ()
    spoilt: str | None = None


def clean(_rng: np.random.Generator, made: Simulated) -> Planted:
    """Nothing wrong."""
    return Planted(made, None)


def lens_off(factor: float, fixed: bool = False) -> Callable[[np.random.Generator, Simulated], Planted]:
    """A lens given with its focal times a factor."""

    def planted(rng: np.random.Generator, made: Simulated) -> Planted:
        camera = int(rng.integers(len(made.inputs)))
        given = given_lens(made, camera, factor)
        inputs = [replace(one, fixed=fixed and n == camera) for n, one in enumerate(given.inputs)]
        name = made.inputs[camera].name
        wrong = abs(factor - 1) > 0.05
        return Planted(replace(given, inputs=tuple(inputs)), name if wrong else None, ("lens that was given",))

    return planted


def other_lens(fixed: bool = False) -> Callable[[np.random.Generator, Simulated], Planted]:
    """The lens of another camera, of those the one whose focal is least alike."""

    def planted(rng: np.random.Generator, made: Simulated) -> Planted:
        camera = int(rng.integers(len(made.inputs)))
        log = np.log(made.lenses[:, 0])
        other = int(np.argmax(abs(log - log[camera])))
        known = given_lens(made, other).inputs[other].intrinsics
        inputs = [replace(o, intrinsics=known, fixed=fixed) if n == camera else o for n, o in enumerate(made.inputs)]
        name = made.inputs[camera].name if abs(log[other] - log[camera]) > 0.05 else None
        return Planted(replace(made, inputs=tuple(inputs)), name, ("lens that was given",))

    return planted


def wrong_size(rng: np.random.Generator, made: Simulated) -> Planted:
    """A rectangle 5 % larger or smaller than given; of several not the one that most Views are of."""
    seen = {r.name: sum(v.rectangle == r.name for v in made.views) for r in made.rectangles}
    names = sorted(name for name, count in seen.items() if count)
    name = str(rng.choice([n for n in names if n != max(names, key=seen.__getitem__)] or names))
    factor = 1.05 ** rng.choice([-1, 1])
    rectangles = [
        replace(r, width=r.width * factor, height=r.height * factor) if r.name == name else r for r in made.rectangles
    ]
    views = [replace(v, points=v.points * factor) if v.rectangle == name else v for v in made.views]
    made = replace(made, rectangles=tuple(rectangles), views=tuple(views))
    moving = next(r.moving for r in rectangles if r.name == name)
    seen = {(v.frameset if moving else 0, v.camera) for v in views if v.rectangle == name}
    joining = len(names) > 1 and max(Counter(frameset for frameset, _ in seen).values()) > 1
    if len(names) == 1:
        # No picture shows it: all lengths follow the sheet.
        poses = made.world_from_camera
        made = replace(made, world_from_camera=Pose(poses.rotation, poses.translation * factor))
    return Planted(made, name if joining else None, ("size that was given",))


def _of_camera(change: Callable[[np.random.Generator, View], View], words: tuple[str, ...]):
    def planted(rng: np.random.Generator, made: Simulated) -> Planted:
        name = made.inputs[int(rng.integers(len(made.inputs)))].name
        views = [change(rng, v) if v.camera == name else v for v in made.views]
        return Planted(replace(made, views=tuple(views)), name, words, name)

    return planted


def _flipped(_rng: np.random.Generator, view: View) -> View:
    return replace(view, pixels=view.pixels * [-1, 1] + [WIDTH - 1, 0])


def _flipped_and_read_so(rng: np.random.Generator, view: View) -> View:
    return replace(_flipped(rng, view), points=view.points * [-1, 1, 1])


def _random(rng: np.random.Generator, view: View) -> View:
    return replace(view, pixels=rng.uniform([0, 0], [WIDTH - 1, HEIGHT - 1], (len(view.pixels), 2)))


def other_room(rng: np.random.Generator, made: Simulated) -> Planted:
    """A camera's Views from another room: what it saw of each rectangle, or at each instant, under another's name."""
    name = made.inputs[int(rng.integers(len(made.inputs)))].name
    views = [v for v in made.views if v.camera != name]
    for moving in (False, True):
        still = {r.name for r in made.rectangles if r.moving == moving}
        own = [v for v in made.views if v.camera == name and v.rectangle in still]
        keys = list(dict.fromkeys((v.rectangle, v.frameset if moving else 0) for v in own))
        other = (
            dict(zip(keys, np.roll(np.array(keys, object), 1, axis=0).tolist(), strict=True)) if len(keys) > 1 else {}
        )
        for v in own:
            rectangle, frameset = other.get((v.rectangle, v.frameset if moving else 0), (v.rectangle, v.frameset))
            views.append(replace(v, rectangle=rectangle, frameset=frameset if moving else v.frameset))
    seen = sum(v.camera == name for v in views)
    return Planted(replace(made, views=tuple(views)), name if seen > 1 else None, ("contradict",), name)


def half_pictures(rng: np.random.Generator, made: Simulated) -> Planted:
    """Pictures of half the size, with the lens of the whole ones."""
    planted = _of_camera(lambda _, v: replace(v, pixels=v.pixels / 2), ())(rng, made)
    assert planted.culprit is not None
    index = made.index(planted.culprit)
    inputs = [
        replace(one, width=WIDTH // 2, height=HEIGHT // 2) if n == index else one
        for n, one in enumerate(given_lens(planted.made, index).inputs)
    ]
    made = replace(planted.made, inputs=tuple(inputs))
    return replace(planted, made=made, words=("another size", "lens that was given"))


def half_frame(rng: np.random.Generator, made: Simulated) -> Planted:
    """The size of the pictures is given as half of what it is."""
    index = int(rng.integers(len(made.inputs)))
    inputs = [
        replace(one, width=WIDTH // 2, height=HEIGHT // 2) if n == index else one for n, one in enumerate(made.inputs)
    ]
    name = made.inputs[index].name
    return Planted(replace(made, inputs=tuple(inputs)), name, ("outside of its picture", "another size"), name)


def double_frame(rng: np.random.Generator, made: Simulated) -> Planted:
    """The size of the pictures is given as double of what it is."""
    return _of_camera(lambda _, v: replace(v, pixels=v.pixels / 2), ("another size",))(rng, made)


def absurd(size: float) -> Callable[[np.random.Generator, Simulated], Planted]:
    """One View of which the numbers are this many px."""

    def planted(rng: np.random.Generator, made: Simulated) -> Planted:
        seen = defaultdict(int)
        for view in made.views:
            seen[view.camera] += 1
        index = int(rng.choice([n for n, v in enumerate(made.views) if seen[v.camera] > 2]))
        views = list(made.views)
        views[index] = replace(views[index], pixels=size * (1 + rng.uniform(size=views[index].pixels.shape)))
        return Planted(
            replace(made, views=tuple(views)), views[index].camera, ("outside of its picture", "in no picture")
        )

    return planted


FAULTS: dict[str, Callable[[np.random.Generator, Simulated], Planted]] = {
    "clean": clean,
    "lens 0 %": lens_off(1.0),
    "lens 1 %": lens_off(1.01),
    "lens 5 %": lens_off(1.05),
    "lens 15 %": lens_off(1.15),
    "lens of another": other_lens(),
    "fixed, right": lens_off(1.0, fixed=True),
    "fixed 15 %": lens_off(1.15, fixed=True),
    "fixed of another": other_lens(fixed=True),
    "size 5 %": wrong_size,
    "mirrored": _of_camera(_flipped, ("mirrored",)),
    "mirrored, read so": _of_camera(_flipped_and_read_so, ("mirrored",)),
    "another room": other_room,
    "half pictures": half_pictures,
    "frame halved": half_frame,
    "frame doubled": double_frame,
    "random corners": _of_camera(_random, ("no pictures of", "contradict")),
    "a View 1e6 px": absurd(1e6),
    "a View 1e200 px": absurd(1e200),
}


def sentences(rig: Rig) -> list[str]:
    """All that is said against a rig."""
    return list(verdict(rig).weak)


def one(world: str, seed: int, fault: str) -> dict[str, list[float]]:
    """Figures of one rig."""
    planted = FAULTS[fault](np.random.default_rng([seed, 99]), draw(world, seed))
    made, found = planted.made, defaultdict(list)
    try:
        rig = calibrate(made.inputs, made.rectangles, made.views)
        said = sentences(rig)
    except (QuadrigError, np.linalg.LinAlgError, AssertionError) as error:
        rig, said = None, [str(error)]
    accused = [s for s in said if any(word in s for word in ACCUSING)]
    named = [s for s in accused if planted.culprit and planted.culprit in s and any(w in s for w in planted.words)]
    if planted.culprit:
        found["named"].append(bool(named))
    found["others"].append(bool([s for s in accused if not planted.culprit or planted.culprit not in s]))
    found["said"] = accused
    inside, right = poses_inside(made, rig, planted.spoilt) if rig else ([], False)
    found["inside"] += inside
    found["right"].append(right)
    return found


def poses_inside(made: Simulated, rig: Rig, spoilt: str | None) -> tuple[list[float], bool]:
    """Whether each pose of the others is inside its region, and whether all are placed and none is far off."""
    names = joined_without(made, spoilt)
    placed = [n for n in names if n in {c.name for c in rig.cameras}]
    inside, far = [], False
    for name in placed:
        off = rig.camera(name).intrinsics.focal - made.lenses[made.index(name), 0]
        variance = rig.lens_covariance(name)[0, 0]
        far |= bool(variance > 0 and off**2 > 25 * variance)
        if name != placed[0]:
            pose = rig.camera(placed[0]).rig_from_camera.inverse() @ rig.camera(name).rig_from_camera
            step = pose.step_to(made.rig_from_camera(placed[0], name))
            at = quantile(step, rig.relative_covariance(placed[0], name))
            inside.append(at < 0.95)
            far |= at > _FIVE_SIGMAS
    return inside, len(placed) == len(names) and not far


def joined_without(made: Simulated, spoilt: str | None) -> list[str]:
    """The most cameras that shared rectangles still join without one of them."""
    views = [view for view in made.views if view.camera != spoilt]
    problem = build_problem(made.inputs, made.rectangles, views)
    return [problem.cameras[i].name for i in components(problem)[0]]


def main() -> None:
    """Print one table."""
    parser = argparse.ArgumentParser(description="one thing wrong in a rig: right all the same, and named?")
    parser.add_argument("rigs", nargs="?", type=int, default=20)
    parser.add_argument("--fault", choices=list(FAULTS))
    parser.add_argument("--world", choices=list(WORLDS))
    parser.add_argument("--say", action="store_true", help="print each accusation")
    asked = parser.parse_args()
    began = time.perf_counter()
    table = Table(title=f"one fault in a rig, {asked.rigs} rigs each")
    for column in ("fault", "world", "right", "poses inside", "named", "others accused"):
        table.add_column(column, justify="left" if column in ("fault", "world") else "right")
    for fault in FAULTS if asked.fault is None else [asked.fault]:
        worlds = FAULT_WORLDS if fault != "clean" else ("rich", "few Views", "one sheet", "clicked", "imperfect")
        for world in [w for w in worlds if asked.world in (None, w)]:
            found = defaultdict(list)
            for seed in range(asked.rigs):
                for name, values in one(world, seed, fault).items():
                    found[name] += values if name != "said" else [f"{seed}: {v}" for v in values]
            table.add_row(fault, world, *(share(found[name]) for name in ("right", "inside", "named", "others")))
            print(
                fault,
                world,
                *(share(found[name]) for name in ("right", "inside", "named", "others")),
                sep="\t",
                file=sys.stderr,
                flush=True,
            )
            if asked.say:
                print(f"{fault}, {world}:", *found["said"], sep="\n  ")
    console = Console(width=120)
    console.print(table)
    console.print(f"{time.perf_counter() - began:.0f} s; aims: 95 % each where it can be known, nobody else accused")


def share(values: list[float]) -> str:
    """ "95 % of 20"; "" of none."""
    return f"{100 * np.mean(values):.0f} % of {len(values)}" if values else ""


if __name__ == "__main__":
    main()
