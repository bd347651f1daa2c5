"""The keys of rig.toml as tables of Markdown: names, kinds of value and defaults from the code that reads the file.

What a key means, and its unit, is said here; a test holds that every key has its words, and no words are left over.
"""

from collections.abc import Iterator

import msgspec
from msgspec import inspect

from quadrig.io.config.known_sizes import KNOWN_SIZES
from quadrig.io.config.marking_tables import Length, LineTime
from quadrig.io.config.rig_toml import file_type
from quadrig.single.markings.registry import marking_kinds

_QUANTITIES = {Length: "length", LineTime: "time"}

_TITLES = {
    "file": "The file",
    "rectangle": "[[rectangle]]",
    "world_from_rect": "world_from_rect = { … }",
    "body_from_rect": "body_from_rect = { … }",
    "body": "[[body]]",
    "camera": "[[camera]]",
}

_BOARD = {
    "columns": ("squares", "Squares along the width, not inner corners."),
    "rows": ("squares", "Squares along the height."),
    "square": ("m", "Side of a square. The rectangle's width and height follow from it."),
}
_DICTIONARY = ("", "Its family: `apriltag_36h11`, `aruco_4x4_50` and the others of OpenCV.")
_FIRST_ID = ("", "Id of the first tag; the others count on from it.")

_POSE = {
    "translation": ("m", "Its middle in that frame."),
    "angles_deg": ("degrees", "Its rotation as angles about x, y and z: R = Rx Ry Rz."),
    "quaternion_xyzw": ("", "The same as a quaternion, its real part last. Give one of the two."),
    "sigma": ("m", "How well the place is known, along each axis."),
    "sigma_deg": ("degrees", "How well the rotation is known, about each axis."),
}

WORDS: dict[str, dict[str, tuple[str, str]]] = {
    "file": {
        "reference": ("", "Whose frame is the rig frame: a camera, or a rectangle that stands still. Else a camera."),
        "rectangle": ("", "The rectangles, one table each."),
        "body": ("", "Bodies that move, one table each. A body that stands still needs none."),
        "camera": ("", "What is known of cameras. Where one names its topic, those without a table are left out."),
    },
    "rectangle": {
        "name": ("", "What it is called in results and messages; every name once."),
        "marking": ("", "How it is recognised: one of the tables below."),
        "size": ("", 'Width and height by the name of a size that everybody has, in their place: `"A4"`.'),
        "width": ("m", "Along x, as one reads it. Outer edge of the marking: of a tag, the outer edge of the black."),
        "height": ("m", "Along y."),
        "moving": ("", "It is carried about: a new pose at every instant."),
        "back": ("", "It is also seen from behind, mirrored: on glass, or printed through. Only markings with tags."),
        "scale_sigma": ("share", "How well its size is known: 0.001 is 0.1 %, what a printer is good for."),
        "world_from_rect": ("", "Where it stands, as it was surveyed."),
        "body": ("", "The body that it is fixed to, with the other rectangles that say so: a box of tags, a room."),
        "body_from_rect": ("", "Where it is on its body, as far as that is known; else it is found."),
    },
    "world_from_rect": _POSE,
    "body_from_rect": _POSE,
    "body": {
        "name": ("", "What rectangles say in `body`."),
        "moving": ("", "It is carried about: a new pose at every instant. Its rectangles then need not say so."),
    },
    "camera": {
        "name": (
            "",
            "Its topic without the trailing words `image_raw`, `image`, `compressed`; a file's or folder's name.",
        ),
        "topic": ("", "The topic of its images, where the name does not say it."),
        "source": ("", "For `rig setup` and `rig record`: a device number, a stream's address, a video or a folder."),
        "focal": (
            "px",
            "Focal length along x: a first guess, or with `fixed` the truth. Without it, nothing is known.",
        ),
        "principal_point": ("px", "Where its axis meets the picture; else the middle."),
        "distortion": ("", "OpenCV's k1, k2, p1, p2, k3, as many as are known; of a fisheye k1 to k4."),
        "aspect": ("", "Focal length along y over that along x."),
        "model": (
            "",
            "`fisheye` for lenses from 120 degrees on, Kannala and Brandt's. Where nothing is given, the Views say.",
        ),
        "fixed": ("", "The lens that is given is the truth and stays."),
        "lens": ("", "Which parameters are estimated. `auto`: all, under priors learned from real lenses."),
        "line_time": (
            "s",
            "From one row of its pictures to the next: 0 where all are taken at once, else a few to 50 µs. A "
            "picture's time is that of its middle row. Without it, it is found where something moves.",
        ),
    },
    "aprilgrid": {
        "columns": ("tags", "Tags along the width."),
        "rows": ("tags", "Tags along the height."),
        "tag": ("m", "Side of a tag."),
        "spacing": ("share", "The gap between two tags over a tag's side."),
        "dictionary": _DICTIONARY,
        "first_id": _FIRST_ID,
        "border": ("cells", "Width of the black edge; Kalibr prints 2."),
    },
    "charuco": _BOARD
    | {
        "marker": ("m", "Side of a tag in its square."),
        "dictionary": _DICTIONARY,
        "legacy": ("", "OpenCV's pattern before 4.6: a board of even rows starts with a tag."),
        "inverted": ("", "White on black."),
        "first_id": _FIRST_ID,
    },
    "chessboard": _BOARD,
    "circles": {
        "columns": ("circles", "Circles along the width; of an asymmetric grid those of one row."),
        "rows": ("circles", "Circles along the height."),
        "spacing": ("m", "From row to row; columns are as far apart, in an asymmetric grid twice that."),
        "diameter": ("m", "Of a circle, as it is printed; else half the distance of neighbours."),
        "asymmetric": ("", "Every other row is shifted by one spacing: OpenCV's and Kalibr's count."),
        "inverted": ("", "Light on dark."),
    },
    "plain": {},
    "points": {},
    "tag": {
        "dictionary": _DICTIONARY,
        "id": ("", "Which of them. The rectangle's width and height are the outer edge of its black."),
    },
}


def page() -> str:
    """All tables of rig.toml, one section each."""
    lines: list[str] = []
    for name, table in tables().items():
        title = _TITLES.get(name, f'marking = {{ kind = "{name}" }}')
        lines += [f"## `{title}`" if name != "file" else f"## {title}", ""]
        if table.tag is not None:
            lines += [_first_sentence(name), ""]
        if table.fields:
            lines += [
                '<div class="keys" markdown>',
                "",
                "| key | value | unit | default | |",
                "|---|---|---|---|---|",
            ]
            lines += [_row(name, key) for key in table.fields]
            lines += ["", "</div>", ""]
    return "\n".join([*lines, *_sizes()])


def tables() -> dict[str, inspect.StructType]:
    """Every table by its name, markings by their kind, in the order of the file."""
    root = inspect.type_info(file_type())
    assert isinstance(root, inspect.StructType)
    return {"file": root, **dict(_below(root))}


def _below(table: inspect.StructType) -> Iterator[tuple[str, inspect.StructType]]:
    for key in table.fields:
        for inner in _structs(key.type):
            yield (str(inner.tag) if inner.tag is not None else key.name), inner
            yield from _below(inner)


def _structs(kind: inspect.Type) -> Iterator[inspect.StructType]:
    match kind:
        case inspect.StructType():
            yield kind
        case inspect.UnionType(types=types):
            for each in types:
                yield from _structs(each)
        case inspect.ListType(item_type=item) | inspect.CollectionType(item_type=item):
            yield from _structs(item)


def _row(table: str, key: inspect.Field) -> str:
    unit, words = WORDS[table][key.name]
    return f"| `{key.name}` | {_value(key.type)} | {unit} | {_default(key)} | {words} |"


def _default(key: inspect.Field) -> str:
    if key.required:
        return "**required**"
    if key.default in (None, msgspec.NODEFAULT):
        return "–"
    return f"`{msgspec.json.encode(key.default, enc_hook=float).decode()}`"


def _value(kind: inspect.Type) -> str:
    """A kind of value in words."""
    match kind:
        case inspect.UnionType(types=types):
            parts = [_value(each) for each in types if not isinstance(each, inspect.NoneType)]
            return " or ".join(dict.fromkeys(parts))
        case inspect.LiteralType(values=values):
            return ", ".join(f'`"{value}"`' for value in values)
        case inspect.FloatType(gt=limit) | inspect.IntType(gt=limit) if limit is not None:
            return f"{_plain(kind)} above {limit:g}"
        case inspect.TupleType(item_types=items):
            return f"{len(items)} {_plain(items[0])}s"
        case (
            inspect.ListType(item_type=inspect.StructType()) | inspect.CollectionType(item_type=inspect.StructType())
        ):
            return "tables"
        case inspect.ListType(item_type=item, max_length=most):
            return f"list of {_plain(item)}s" + (f", at most {most}" if most else "")
        case _:
            return _plain(kind)


def _plain(kind: inspect.Type) -> str:
    words = {
        inspect.FloatType: "number",
        inspect.IntType: "whole number",
        inspect.StrType: "text",
        inspect.BoolType: "`true` or `false`",
        inspect.StructType: "table",
    }
    if isinstance(kind, inspect.CustomType) and kind.cls in _QUANTITIES:
        return _QUANTITIES[kind.cls]
    return words[type(kind)]


def _first_sentence(kind: str) -> str:
    """What the marking says of itself."""
    return " ".join((marking_kinds()[kind].__doc__ or "").split("\n\n")[0].split())


def _sizes() -> list[str]:
    lines = [
        "## Sizes by name",
        "",
        "| `size` | width, m | height, m | its corners are | says |",
        "|---|--:|--:|---|---|",
    ]
    lines += [
        f'| `"{name}"` | {size.width:g} | {size.height:g} | {size.edge} | {size.source} |'
        for name, size in KNOWN_SIZES.items()
    ]
    return [*lines, "", 'A paper lies across; `"A4 upright"` stands on its short side.', ""]
