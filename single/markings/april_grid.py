"""AprilGrids, as Kalibr prints them: tags in a grid, a black square in each gap where four of them meet."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from quadrig.single.arrays import Floats, Mask, Picture
from quadrig.single.detect.dictionaries import canonical_dictionary, check_tag_ids, dictionary_size, tag_cells
from quadrig.single.detect.tagged_board import TaggedBoard
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.boards import check_length
from quadrig.single.markings.tag import cell_patches
from quadrig.single.markings.tagged import TaggedMarking
from quadrig.single.patch import INK, Patch
from quadrig.single.rectangle import Metres, Rectangle, TagFamily, Tags, rectangle_corners

# Where a square of the gap is dark at the top left of a tag's corner, in the order of Eq. 4: at the bottom right it
# is the tag itself.
_SIGNS = (1, -1, 1, -1)


@dataclass(frozen=True)
class AprilGridMarking(TaggedMarking):
    """A grid of columns x rows tags of side `tag` metres, `spacing` times that apart, as Kalibr prints it.

    Ids count from first_id at the bottom left, row by row upwards. border: cells of its black edge (Kalibr: 2).
    The rectangle reaches to the outer edges of the squares in the gaps, which stand around the tags too.
    Raises QuadrigError where a length is none, or the dictionary has too few tags.
    """

    columns: int
    rows: int
    tag: Metres
    spacing: float
    dictionary: str = "apriltag_36h11"
    first_id: int = 0
    border: int = 2

    kind: ClassVar[str] = "aprilgrid"
    noun: ClassVar[str] = "board"

    def __post_init__(self) -> None:
        for side, count in (("columns", self.columns), ("rows", self.rows), ("border", self.border)):
            if count < 1:
                raise QuadrigError(f"{side} is {count}; give one or more")
        check_length("tag", self.tag)
        if not 0 < self.spacing <= 1:
            raise QuadrigError(
                f"spacing is {self.spacing:g}; give the gap between two tags over a tag's side, such as 0.3"
            )
        check_tag_ids(self.dictionary, self.first_id, self.first_id + self.columns * self.rows - 1)
        object.__setattr__(self, "dictionary", canonical_dictionary(self.dictionary))

    @property
    def description(self) -> str:
        return f"an AprilGrid of {self.dictionary}"

    @property
    def size(self) -> tuple[float, float]:
        return self._extent(self.columns), self._extent(self.rows)

    @property
    def tags(self) -> Tags:
        ids = frozenset(range(self.first_id, self.first_id + self.columns * self.rows))
        return Tags(TagFamily(self.dictionary, border=self.border), ids)

    @property
    def board(self) -> TaggedBoard:
        cells, gap = len(self._cells(self.first_id)), self.spacing * self.tag
        corners = self._corners
        return TaggedBoard(
            corners.reshape(-1, 2),
            np.tile(_SIGNS, len(corners)),
            self.tag + gap,
            gap,
            min(self.border * self.tag / cells / gap, 1.0),
            # The dictionary's tags stand on their heads against Kalibr's, whose bottom right is thus their top left.
            {self.first_id + offset: quad for offset, quad in enumerate(corners)},
            self.tags.family,
        )

    def meant_instead(self, _grey: Picture, /) -> "list[AprilGridMarking]":
        near = sorted({side + more for side in (self.columns, self.rows) for more in (-1, 0, 1)} - {0})
        most = dictionary_size(self.dictionary) - self.first_id
        return [
            replace(self, columns=columns, rows=rows, border=border)
            for border in dict.fromkeys((self.border, 1, 2))
            for columns in near
            for rows in near
            if columns * rows <= most
        ]

    def scaled(self, scale: float, /) -> Self:
        return replace(self, tag=round(self.tag * scale, 6))

    def points(self, _rectangle: Rectangle, /) -> Floats:
        return np.pad(self._corners.reshape(-1, 2), ((0, 0), (0, 1)))

    def quiet_zone(self, _rectangle: Rectangle, /) -> float:
        return self.spacing * self.tag

    def patches(self, _rectangle: Rectangle, sheet: Patch, /) -> list[Patch]:
        gap, step = self.spacing * self.tag, (1 + self.spacing) * self.tag
        left, top = -self.size[0] / 2, -self.size[1] / 2
        patches = [sheet]
        for row in range(self.rows + 1):
            for column in range(self.columns + 1):
                x, y = left + column * step, top + row * step
                patches.append(Patch(x, y, x + gap, y + gap, INK))
        for offset, quad in enumerate(self._corners):
            x, y = quad.mean(axis=0).tolist()
            patches += cell_patches(self._cells(self.first_id + offset), (x, y), (self.tag, self.tag))
        return patches

    @property
    def _corners(self) -> Floats:
        """Corners (N, 4, 2) metres of each tag in the order of ids and of Eq. 4."""
        row, column = np.indices((self.rows, self.columns), dtype=float).reshape(2, -1)
        step = (1 + self.spacing) * self.tag
        middles = step * np.column_stack([column - (self.columns - 1) / 2, (self.rows - 1) / 2 - row])
        return middles[:, None] + rectangle_corners(self.tag, self.tag)[:, :2]

    def _extent(self, count: int) -> float:
        return (count + (count + 1) * self.spacing) * self.tag

    def _cells(self, tag_id: int) -> Mask:
        return np.rot90(tag_cells(self.dictionary, tag_id, self.border), 2)
