"""From a recording and its rig.toml to a Rig in Python, and a point triangulated by it.

rig demo && python examples/04_recording_to_rig.py rig-demo
"""

import argparse
from pathlib import Path

import numpy as np

from quadrig.io import calibrate_searched, read_config, search_recording


def main() -> None:
    """Print the rig, and where the first View's first corner is by all cameras that saw it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="with recording.mcap and rig.toml")
    folder = parser.parse_args().folder

    searched = search_recording(folder / "recording.mcap", read_config(folder / "rig.toml"))
    rig = calibrate_searched(searched)
    for camera in rig.cameras:
        print(f"{camera.name}: focal {camera.intrinsics.focal:.1f} +- {rig.focal_sigma(camera.name):.1f} px")

    first = searched.views[0]
    same = [v for v in searched.views if (v.rectangle, v.frameset) == (first.rectangle, first.frameset)]
    origins, rays = [], []
    for view in same:
        camera = rig.camera(view.camera)
        origins.append(camera.rig_from_camera.translation)
        rays.append(camera.rig_from_camera.rotation @ camera.intrinsics.unproject(view.pixels[0]))
    # The point nearest to all rays: each ray sees what lies across it.
    across = [np.eye(3) - np.outer(ray, ray) for ray in rays]
    point = np.linalg.solve(sum(across), sum(a @ o for a, o in zip(across, origins, strict=True)))
    misses = [np.linalg.norm(a @ (point - o)) for a, o in zip(across, origins, strict=True)]
    print(
        f"corner of {first.rectangle!r} by {len(same)} cameras: {point.round(4)} m, rays miss by {max(misses):.5f} m"
    )


if __name__ == "__main__":
    main()
