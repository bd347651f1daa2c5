"""Which tags of a dictionary the rectangles in question bear."""

from collections.abc import Sequence

from quadrig.single.detect.dictionaries import canonical_dictionary
from quadrig.single.marking import CharucoMarking, TagMarking
from quadrig.single.rectangle import Rectangle


def known_tags(rectangles: Sequence[Rectangle]) -> set[tuple[str, int]]:
    """Every (dictionary, id) that belongs to a rectangle."""
    known: set[tuple[str, int]] = set()
    for rectangle in rectangles:
        marking = rectangle.marking
        if isinstance(marking, TagMarking):
            known.add((canonical_dictionary(marking.dictionary), marking.id))
        elif isinstance(marking, CharucoMarking):
            last = marking.first_id + (marking.columns * marking.rows + 1) // 2
            known |= {(canonical_dictionary(marking.dictionary), k) for k in range(marking.first_id, last)}
    return known
