"""`target = "april_6x6.yaml"` in a [[rectangle]]: a target as Kalibr's own file describes it."""

import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import yaml

from quadrig.io.config.marking_tables import marking_keys
from quadrig.io.config.toml_lines import toml_line
from quadrig.io.safe_yaml import read_yaml
from quadrig.io.whole_file import read_whole
from quadrig.single.errors import QuadrigError
from quadrig.single.markings.april_grid import AprilGridMarking
from quadrig.single.markings.chessboard import ChessboardMarking
from quadrig.single.markings.circle_grid import CircleGridMarking
from quadrig.single.rectangle import Marking

_TARGET_LINE = re.compile(r"""^(\s*)(target\s*=\s*(?:"[^"]*"|'[^']*'))\s*(?:#.*)?$""", re.MULTILINE)


def with_targets_read(text: str, folder: Path, name: str) -> str:
    """The text of a rig.toml with the marking in the place of each line that names a Kalibr file.

    So the text stands alone wherever it is kept; its lines keep their numbers. Raises QuadrigError, with the line,
    where a file cannot be read as a target.
    """

    def marking_line(match: re.Match[str]) -> str:
        try:
            marking = read_target(folder / str(tomllib.loads(match[2])["target"]))
        except tomllib.TOMLDecodeError:
            # Whoever reads the whole file says where it is not TOML.
            return match[0]
        except QuadrigError as error:
            line = text.count("\n", 0, match.start(2)) + 1
            raise QuadrigError(f"{name}, line {line}: {error}") from error
        return f"{match[1]}{toml_line('marking', marking_keys(marking))}  # {match[2]}"

    return _TARGET_LINE.sub(marking_line, text)


def read_target(path: Path) -> Marking:
    """The marking that a Kalibr target file describes. Raises QuadrigError where it cannot be read as one."""
    try:
        values = {str(key): str(value) for key, value in read_yaml(read_whole(path)).items()}
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise QuadrigError(
            f"{path} cannot be read ({' '.join(str(error).split())}); give a target file of Kalibr's"
        ) from error
    kind = values.get("target_type", "")
    if kind not in _READERS:
        raise QuadrigError(f"{path}: target_type is {kind!r}; it may be {', '.join(_READERS)}")
    try:
        return _READERS[kind](values)
    except KeyError as error:
        raise QuadrigError(f"{path}: the {kind} target lacks {error.args[0]}; add it") from error
    except (ValueError, QuadrigError) as error:
        raise QuadrigError(f"{path}: {error}") from error


def _aprilgrid(values: dict[str, str]) -> Marking:
    return AprilGridMarking(
        int(values["tagCols"]), int(values["tagRows"]), float(values["tagSize"]), float(values["tagSpacing"])
    )


def _checkerboard(values: dict[str, str]) -> Marking:
    width, height = float(values["colSpacingMeters"]), float(values["rowSpacingMeters"])
    if width != height:
        raise QuadrigError(f"its squares are {width} m wide and {height} m high; quadrig knows square ones only")
    # Kalibr counts inner corners.
    return ChessboardMarking(int(values["targetCols"]) + 1, int(values["targetRows"]) + 1, width)


def _circlegrid(values: dict[str, str]) -> Marking:
    asymmetric = values.get("asymmetricGrid", "false").lower() in ("true", "1")
    return CircleGridMarking(
        int(values["targetCols"]), int(values["targetRows"]), float(values["spacingMeters"]), asymmetric=asymmetric
    )


_READERS: dict[str, Callable[[dict[str, str]], Marking]] = {
    "aprilgrid": _aprilgrid,
    "checkerboard": _checkerboard,
    "circlegrid": _circlegrid,
}
