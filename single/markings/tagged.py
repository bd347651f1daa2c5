"""What boards with tags share: found by their tags, fitted where four squares meet."""

from abc import abstractmethod

import numpy as np

from quadrig.single.arrays import Picture
from quadrig.single.detect.image_search import search_tags
from quadrig.single.detect.pictures import window_around
from quadrig.single.detect.tag import EQ4_FROM_OPENCV
from quadrig.single.detect.tagged_board import TaggedBoard, find_board, seen_tags
from quadrig.single.markings.tag import ROUGH_SIGMA
from quadrig.single.rectangle import FoundTags, Marking, Rectangle
from quadrig.single.view import View

# Fewest tags of a board that distinguish it from somebody else's.
_LEAST_TAGS = 2


class TaggedMarking(Marking):
    """A board whose tags say where its corners are."""

    @property
    @abstractmethod
    def board(self) -> TaggedBoard:
        """What its printer knows of it."""

    @property
    def not_found(self) -> str:
        return f"{self.description} was not found; show some of its tags whole and sharp, and the sheet flat"

    def find(self, grey: Picture, rectangle: Rectangle, found: FoundTags, /) -> View | None:
        corners = find_board(grey, self.board, found)
        if corners is None:
            return None
        return View(rectangle.name, self.points(rectangle)[corners.index], corners.pixels, sigma=corners.sigma)

    def follow(self, grey: Picture, rectangle: Rectangle, before: View, /) -> View | None:
        window, start = window_around(grey, before.pixels)
        # A board in motion is so blurred that only the slower passes find its tags; its window is small.
        found = search_tags(window, [rectangle])
        return self.find(grey, rectangle, {tag: [quad + start for quad in quads] for tag, quads in found.items()})

    def rough(self, rectangle: Rectangle, found: FoundTags, /) -> View | None:
        tags, pixels = seen_tags(self.board, found)
        if len(tags) < _LEAST_TAGS:
            return None
        points = np.pad(tags[:, EQ4_FROM_OPENCV].reshape(-1, 2), ((0, 0), (0, 1)))
        return View(rectangle.name, points, pixels[:, EQ4_FROM_OPENCV].reshape(-1, 2), sigma=ROUGH_SIGMA)
