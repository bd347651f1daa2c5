"""The `rig` command: one module for each of its commands, imported only when that command is called."""

import inspect
import keyword
import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Annotated

import typer

from quadrig.single.errors import QuadrigError

COMMANDS = {
    "demo": "Render a room with four cameras, calibrate them, and compare with the truth.",
    "setup": "Calibrate live cameras, coached.",
    "record": "Record cameras, videos or folders of pictures into an MCAP recording.",
    "pick": "Point at corners of rectangles in pictures, in the browser.",
    "calibrate": "Calibrate the cameras of a recording: rig.toml and recording in, rig.mcap out.",
    "inspect": "Look at a calibrated rig in rerun.",
    "report": "Write a calibrated rig and its evidence as one HTML page.",
    "export": "Write a calibrated rig in the format of another program.",
    "import": "Make a rig.mcap of the files of another program.",
    "undistort": "Take the lens's distortion out of pictures and videos.",
    "check": "Find out from a new recording whether a camera has moved.",
    "compare": "Compare two calibrated rigs.",
    "info": "Show what a recording or a rig.mcap holds.",
    "single": "Focal and pose of one camera from one picture.",
    "target": "Draw a sheet with markings to print.",
}
"""Each command with its line in `rig --help`; command "x" is the function x of the module x, here or in exchange/,
with an underscore behind its name where Python keeps the word for itself."""

_EXCHANGE = ("export", "import", "undistort")

_EXAMPLE = """Calibrate a rig of cameras from rectangles of known size.

Example: rig demo; or, with cameras of your own: rig record --config rig.toml -o room.mcap, then
rig calibrate room.mcap --config rig.toml -o rig.mcap, then rig inspect rig.mcap"""

_INTERRUPTED = 130


def main() -> None:
    """The entry point of `rig`: runs a command and exits with its code, never with a traceback."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run `rig` with these arguments. 0: done; 1: failed; 2: wrong usage; 130: interrupted.

    What failed is one line on stderr; the environment's RIG_TRACEBACK=1 lets the traceback through instead.
    """
    wanted = next((word for word in arguments if not word.startswith("-")), "")
    try:
        _application(wanted)(list(arguments), prog_name="rig")
    except SystemExit as leaving:
        code = leaving.code if isinstance(leaving.code, int) else int(bool(leaving.code))
        if code == _INTERRUPTED:
            _say("interrupted; nothing half-written is left behind")
        return code
    except KeyboardInterrupt:
        _say("interrupted; nothing half-written is left behind")
        return _INTERRUPTED
    except Exception as error:
        if os.environ.get("RIG_TRACEBACK") == "1":
            raise
        _say(_sentence(error, wanted))
        return 1
    return 0


def _application(wanted: str) -> typer.Typer:
    app = typer.Typer(
        help=_EXAMPLE,
        add_completion=False,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    )
    app.callback()(_options)
    for name, line in COMMANDS.items():
        function = command_function(name) if name == wanted else _named
        described = inspect.getdoc(function) if name == wanted else line
        app.command(name, help=described, short_help=line)(function)
    return app


def command_function(name: str) -> Callable[..., None]:
    """The function behind a command of COMMANDS, imported only now."""
    module, folder = f"{name}_" if keyword.iskeyword(name) else name, ".exchange" if name in _EXCHANGE else ""
    return getattr(import_module(f"quadrig.io.commands{folder}.{module}"), module)


def _named() -> None:
    """Stands for a command that is only listed."""


def _version(asked: bool) -> None:
    if asked:
        from quadrig.io.version import __version__

        typer.echo(f"rig {__version__}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


def _sentence(error: Exception, command: str) -> str:
    if isinstance(error, QuadrigError):
        return str(error)
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror[:1].lower()}{error.strerror[1:]}"
    what = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return f"unexpected error ({what}); RIG_TRACEBACK=1 rig {command} ... shows where"


def _say(sentence: str) -> None:
    print("rig: " + " ".join(sentence.split()), file=sys.stderr)
