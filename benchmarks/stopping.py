"""When `rig setup --until 1mm` stops, is the rig that good? Simulated rooms, the first solution below the limit
against the first two in a row.

    python benchmarks/stopping.py [ROOMS]

The rooms and the two people of examples/06_coached_setup.py, with lenses that bend as webcams' do; pixels are drawn,
not rendered. The truth: root mean square distance of points of the covered volume, triangulated by the rig, from
where they are, the frame fitted.
"""

import importlib.util
import sys
from dataclasses import replace
from multiprocessing import Pool
from pathlib import Path
from types import ModuleType

import numpy as np
from rich.console import Console
from rich.table import Table

from quadrig.rig.calibration import calibrate
from quadrig.rig.coach.advice import Situation, advise
from quadrig.rig.coach.conversation import Coach
from quadrig.rig.problem.camera_input import CameraInput
from quadrig.rig.result import Rig
from quadrig.single.arrays import Floats
from quadrig.single.errors import QuadrigError
from quadrig.single.lens import Intrinsics
from quadrig.single.pose import Pose
from quadrig.single.view import View

TARGET, MOST_FRAMESETS = 0.001, 60
# px a coordinate: what the fit of a printed tag leaves, lens model and paper included.
NOISE = 0.15


def example() -> ModuleType:
    """examples/06_coached_setup.py as a module."""
    path = Path(__file__).parents[1] / "examples" / "06_coached_setup.py"
    spec = importlib.util.spec_from_file_location("coached_setup", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["coached_setup"] = module
    spec.loader.exec_module(module)
    return module


def bent(room, rng: np.random.Generator):
    """The room with distorted lenses whose axes stray."""
    lenses = [
        Intrinsics(
            lens.width,
            lens.height,
            lens.focal,
            lens.principal_point + rng.normal(0, 0.008 * lens.width, 2),
            np.array([rng.uniform(-0.2, 0.05), rng.uniform(-0.03, 0.06), 0.0, 0.0, 0.0]),
        )
        for lens in room.lenses
    ]
    return replace(room, lenses=tuple(lenses))


def views_of(room, sheet, world_from_rect: Pose, frameset: int, rng: np.random.Generator) -> list[View]:
    """Where each camera sees the sheet, which is found where it is whole, from the front and large enough."""
    views = []
    for name, lens, pose in zip(room.names, room.lenses, room.world_from_cameras, strict=True):
        corners = lens.project((pose.inverse() @ world_from_rect).transform(sheet.corners))
        sight = world_from_rect.translation - pose.translation
        facing = sight @ world_from_rect.rotation[:, 2] / np.linalg.norm(sight)
        inside = (
            np.isfinite(corners).all() and ((corners > 12) & (corners < [lens.width - 12, lens.height - 12])).all()
        )
        if inside and facing > 0.4:
            views.append(
                View(sheet.name, sheet.corners, corners + rng.normal(0, NOISE, (4, 2)), name, frameset, sigma=NOISE)
            )
    return views


def session(task: tuple[int, str]) -> dict[str, tuple[int, float]]:
    """For each rule: framesets until it stops, and the true error, m, then."""
    seed, person = task
    coached = example()
    rng = np.random.default_rng(seed)
    room = bent(coached.a_room(rng), rng)
    inputs = [CameraInput(name, lens.width, lens.height) for name, lens in zip(room.names, room.lenses, strict=True)]
    views: list[View] = []
    placed: list[Pose] = []
    coach, rig, shown, below = Coach(), None, frozenset[str](), 0
    stopped: dict[str, tuple[int, float]] = {}
    for frameset in range(MOST_FRAMESETS):
        if person == "obeys":
            situation = Situation(
                room.names, (coached.SHEET,), tuple(views), rig, None, coach.refused, coach.refused_pairs
            )
            coach = coach.hear(advise(situation), shown, coached.SECONDS_A_HOLD * frameset)
        pose = getattr(coached, person)(rng, room, coach.advice, rig)
        placed.append(pose)
        new = views_of(room, coached.SHEET, pose, frameset, rng)
        views += new
        shown = frozenset(view.camera for view in new)
        try:
            rig = calibrate(inputs, [coached.SHEET], views)
        except (QuadrigError, np.linalg.LinAlgError):
            rig = None
        good = rig is not None and len(rig.cameras) == len(room.names) and rig.working_accuracy <= TARGET
        below = below + 1 if good else 0
        for count in (1, 2, 3):
            if rig is not None and below >= count and str(count) not in stopped:
                stopped[str(count)] = frameset + 1, true_error(coached, room, rig, placed)
        if "3" in stopped:
            break
    return stopped


def true_error(coached: ModuleType, room, rig: Rig, placed: list[Pose]) -> float:
    """Root mean square distance, m, of the sheets' corners where the rig sees them from where they are."""
    world: Floats = np.concatenate([pose.transform(coached.SHEET.corners) for pose in placed])
    found = [(coached.triangulated(room, rig, point), point) for point in world]
    a = np.array([place for place, _ in found if place is not None])
    b = np.array([point for place, point in found if place is not None])
    u, _, vt = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    turn = (u * [1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    return float(np.sqrt((((a - a.mean(0)) @ turn - (b - b.mean(0))) ** 2).sum(1).mean()))


def main() -> None:
    """Print, for each rule and person, how many framesets and how far off."""
    rooms = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    table = Table(title=f"stopped at {1000 * TARGET:g} mm, {rooms} rooms")
    for name in (
        "person",
        "solutions below",
        "framesets",
        "true error: median",
        "90 %",
        "within 1 mm",
        "within 2 mm",
    ):
        table.add_column(name, justify="left" if name == "person" else "right")
    with Pool(2) as pool:
        for person in ("waves", "obeys"):
            ended = pool.map(session, [(seed, person) for seed in range(rooms)], chunksize=1)
            for rule in ("1", "2", "3"):
                rows = np.array([stopped[rule] for stopped in ended if rule in stopped])
                error = 1000 * rows[:, 1]
                shares = [f"{100 * np.mean(error <= limit):.0f} %" for limit in (1.0, 2.0)]
                middle, most = np.percentile(error, [50, 90])
                table.add_row(person, rule, f"{rows[:, 0].mean():.1f}", f"{middle:.2f} mm", f"{most:.2f} mm", *shares)
    Console().print(table)


if __name__ == "__main__":
    main()
