"""ChArUco boards: a chessboard with tags in its light squares."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from quadrig.single.arrays import Floats, Picture
from quadrig.single.detect.dictionaries import canonical_dictionary, check_tag_ids, dictionary_size
from quadrig.single.detect.tag import EQ4_FROM_OPENCV
from quadrig.single.detect.tagged_board import TaggedBoard
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.boards import BoardMarking, board_points, check_length
from quadrig.single.markings.tag import tag_patches
from quadrig.single.markings.tagged import TaggedMarking
from quadrig.single.patch import INK, PAPER, Patch
from quadrig.single.rectangle import Metres, Rectangle, TagFamily, Tags, rectangle_corners


@dataclass(frozen=True)
class CharucoMarking(TaggedMarking, BoardMarking):
    """A ChArUco board of columns x rows squares of side `square`, tags of side `marker`, metres.

    legacy: OpenCV's pattern before 4.6 (a board of even rows starts with a tag). inverted: white on black.
    first_id: the id of the board's first tag; the others count on from it, row by row.
    Raises QuadrigError where the dictionary has too few tags, or a tag does not fit into its square.
    """

    marker: Metres
    dictionary: str
    legacy: bool = False
    inverted: bool = False
    first_id: int = 0

    kind: ClassVar[str] = "charuco"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_length("marker", self.marker)
        if self.marker >= self.square:
            raise QuadrigError(
                f"marker is {self.marker} m and square {self.square} m; the tag must be smaller than its square"
            )
        check_tag_ids(self.dictionary, self.first_id, self.first_id + len(self.tag_squares) - 1)
        object.__setattr__(self, "dictionary", canonical_dictionary(self.dictionary))

    @property
    def description(self) -> str:
        return f"a ChArUco board of {self.dictionary}"

    @property
    def starts_with_tag(self) -> bool:
        """Whether the top left square of the board holds a tag instead of ink."""
        return self.legacy and self.rows % 2 == 0

    @property
    def tag_squares(self) -> list[tuple[int, int]]:
        """(column, row) of the squares that hold tags, in the order of their ids."""
        parity = 0 if self.starts_with_tag else 1
        return [(c, r) for r in range(self.rows) for c in range(self.columns) if (c + r) % 2 == parity]

    @property
    def tags(self) -> Tags:
        ids = frozenset(range(self.first_id, self.first_id + len(self.tag_squares)))
        return Tags(TagFamily(self.dictionary, self.inverted), ids)

    @property
    def board(self) -> TaggedBoard:
        row, column = np.indices((self.rows - 1, self.columns - 1))
        first = -1 if self.starts_with_tag != self.inverted else 1
        return TaggedBoard(
            board_points(self.columns, self.rows, self.square)[:, :2],
            (first * (1 - 2 * ((row + column) % 2))).ravel(),
            self.square,
            self.square,
            (1 - self.marker / self.square) / 2,
            self._tag_corners(),
            self.tags.family,
        )

    def meant_instead(self, _grey: Picture, /) -> "list[CharucoMarking]":
        sizes = [(self.columns, self.rows), (self.columns + 1, self.rows + 1), (self.rows, self.columns)]
        kinds = [(legacy, inverted) for inverted in (self.inverted, not self.inverted) for legacy in (False, True)]
        # Another dictionary may hold too few tags for the larger board.
        most = dictionary_size(self.dictionary) - self.first_id
        return [
            replace(self, columns=columns, rows=rows, legacy=legacy, inverted=inverted)
            for legacy, inverted in kinds
            for columns, rows in sizes
            # With odd rows the older pattern is the same picture.
            if (columns * rows + 1) // 2 <= most and (rows % 2 == 0 or legacy == self.legacy)
        ]

    def scaled(self, scale: float, /) -> Self:
        # Both at once: a tag that is still to be scaled may not fit into its square.
        return replace(self, square=round(self.square * scale, 6), marker=round(self.marker * scale, 6))

    def patches(self, _rectangle: Rectangle, sheet: Patch, /) -> list[Patch]:
        patches = [sheet, *self.ink_patches(first_ink=int(self.starts_with_tag))]
        for offset, square in enumerate(self.tag_squares):
            side = (self.marker, self.marker)
            patches += tag_patches(self.dictionary, self.first_id + offset, self.middle_of(*square), side)
        return [replace(p, tone=INK + PAPER - p.tone) for p in patches] if self.inverted else patches

    def _tag_corners(self) -> dict[int, Floats]:
        """Corners (4, 2) metres of each tag by its id, top left first."""
        square = rectangle_corners(self.marker, self.marker)[EQ4_FROM_OPENCV, :2]
        return {
            self.first_id + offset: square + self.middle_of(column, row)
            for offset, (column, row) in enumerate(self.tag_squares)
        }
