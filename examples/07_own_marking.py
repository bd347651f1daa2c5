"""A marking of your own: a grid of tags, which quadrig does not bring, found in a picture and calibrated from.

    python examples/07_own_marking.py

A kind of marking is one class: what it looks like, which tags it bears, how it is found. Once it is registered,
rig.toml may name it, the renderer draws it, and whatever asks for Views finds it.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from quadrig.io import parse_config
from quadrig.single import (
    Capture,
    Floats,
    FoundTags,
    Intrinsics,
    Marking,
    Patch,
    Picture,
    Pose,
    Rectangle,
    Sheet,
    TagFamily,
    Tags,
    View,
    calibrate_views,
    detect_views,
    rectangle_corners,
    register,
    render_image,
)
from quadrig.single.detect.dictionaries import tag_cells
from quadrig.single.detect.tag import EQ4_FROM_OPENCV, refine_tags, toned_corners
from quadrig.single.markings.tag import tag_patches

RIG_TOML = """
[[rectangle]]
name = "grid"
moving = true
marking = { kind = "tag_grid", columns = 4, rows = 3, tag = 0.04, gap = 0.016, dictionary = "apriltag_36h11" }
"""


@register
@dataclass(frozen=True)
class TagGridMarking(Marking):
    """columns x rows tags of side `tag`, `gap` metres apart, their ids from 0 on, row by row from the top left."""

    columns: int
    rows: int
    tag: float
    gap: float
    dictionary: str

    kind: ClassVar[str] = "tag_grid"
    noun: ClassVar[str] = "grid"

    @property
    def size(self) -> tuple[float, float]:
        """Outer edge to outer edge, metres."""
        step = self.tag + self.gap
        return self.columns * step - self.gap, self.rows * step - self.gap

    @property
    def tags(self) -> Tags:
        return Tags(TagFamily(self.dictionary), frozenset(range(self.columns * self.rows)))

    @property
    def middles(self) -> Floats:
        """Middles (N, 2) of the tags in the order of their ids, metres."""
        row, column = np.indices((self.rows, self.columns), dtype=float).reshape(2, -1)
        from_middle = np.column_stack([column - (self.columns - 1) / 2, row - (self.rows - 1) / 2])
        return from_middle * (self.tag + self.gap)

    def points(self, _rectangle: Rectangle, /) -> Floats:
        """Four corners of every tag (4 N, 3), each in Eq. 4's order."""
        middles = np.column_stack([self.middles, np.zeros(len(self.middles))])
        return (middles[:, None] + rectangle_corners(self.tag, self.tag)).reshape(-1, 3)

    def quiet_zone(self, _rectangle: Rectangle, /) -> float:
        return self.gap

    def patches(self, _rectangle: Rectangle, sheet: Patch, /) -> list[Patch]:
        drawn = [sheet]
        for tag, (x, y) in enumerate(self.middles.tolist()):
            drawn += tag_patches(self.dictionary, tag, (x, y), (self.tag, self.tag))
        return drawn

    def find(self, grey: Picture, rectangle: Rectangle, found: FoundTags, /) -> View | None:
        seen = np.array([tag for tag in sorted(self.tags.ids) if len(found.get(tag, [])) == 1], int)
        if not len(seen):
            return None
        rough = np.stack([found[tag][0] for tag in seen.tolist()])
        cells = np.array([tag_cells(self.dictionary, tag) for tag in seen.tolist()])
        outlines = refine_tags(grey, rough, cells.shape[1])
        sure = outlines.sure
        if not sure.any():
            return None
        # A camera's tone curve makes tags larger: what of it the picture leaves open is an error common to them all.
        toned = toned_corners(grey, outlines, cells)
        pixels, common = (part[sure][:, EQ4_FROM_OPENCV].reshape(-1, 2) for part in toned)
        points = self.points(rectangle).reshape(-1, 4, 3)[seen[sure]].reshape(-1, 3)
        return View(rectangle.name, points, pixels, sigma=float(outlines.sigma[sure].mean()), common=common)


def main() -> None:
    """Print the focal and k1 found from four pictures of the grid beside the truth."""
    (grid,) = parse_config(RIG_TOML).rectangles
    lens = Intrinsics(1280, 720, 900.0, np.array([645.0, 356.0]), np.array([-0.12, 0.0, 0.0, 0.0, 0.0]))
    rng = np.random.default_rng(7)
    views = []
    for turn in ([0.6, 0.0, 0.0], [-0.4, 0.5, 0.1], [0.0, -0.6, 0.0], [0.3, 0.4, 1.5]):
        camera_from_grid = Pose.from_vectors(np.array(turn), np.array([*rng.uniform(-0.04, 0.04, 2), 0.35]))
        sheet, capture = Sheet(grid, Pose.identity()), Capture(blur=0.6, noise=1.5)
        views += detect_views(render_image(lens, camera_from_grid, [sheet], capture=capture, rng=rng), [grid])

    found = calibrate_views(views, (lens.width, lens.height))
    sigma = np.sqrt(np.diagonal(found.lens_covariance))
    print(f"focal {found.intrinsics.focal:.1f} +- {sigma[0]:.1f} px, truth {lens.focal:.1f}")
    print(f"bend, thousandths: {1e3 * found.intrinsics.distortion[0]:.1f} +- {1e3 * sigma[3]:.1f}, truth -120.0")


if __name__ == "__main__":
    main()
