"""The `rig` command: one module for each of its commands, imported only when that command is called."""

import inspect
import keyword
import os
import re
import signal
import sys
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from functools import wraps
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from quadrig.io.plain_words import one_line, plain_output, silence_libraries
from quadrig.io.verbosity import Verbosity, choose_verbosity
from quadrig.io.whole_file import NO_ROOM, only_read, refuse_no_place
from quadrig.single.errors import QuadrigError

COMMANDS = {
    "demo": "Render a room with four cameras, calibrate them, and compare with the truth.",
    "init": "Look which sheets a recording shows, and write the rig.toml that describes them.",
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

_WRITTEN = ("output", "save", "screenshot", "cache", "put_into")
"""The parameters of all commands that name a file to write; whatever else names a file is read."""

_EXAMPLE = """Calibrate a rig of cameras from rectangles of known size.

Example: rig demo; or, with cameras of your own: rig record --config rig.toml -o room.mcap, then
rig calibrate room.mcap --config rig.toml -o rig.mcap, then rig inspect rig.mcap"""

# What typer says of a type: "<path>", "<list[str]>", "<int range>", "<a|b>".
_TYPE = re.compile(r" <(?:list\[)?([^\]>]*?)(?: range)?\]?>(?:\.\.\.)?$")
_PLACEHOLDERS = {"path": "PATH", "Path": "PATH", "str": "TEXT", "int": "NUMBER", "float": "NUMBER"}

_INTERRUPTED = 130
# A machine that shuts down, a scheduler, a terminal that is closed: they end a command as Ctrl-C does.
_AS_CTRL_C = ("SIGTERM", "SIGHUP")


def main() -> None:
    """The entry point of `rig`: runs a command and exits with its code, never with a traceback."""
    if os.environ.get("RIG_TRACEBACK") != "1":
        silence_libraries()
    numbers = [getattr(signal, name) for name in _AS_CTRL_C if hasattr(signal, name)]
    # What is ignored (nohup) stays so.
    ours = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]
    for number in ours:
        signal.signal(number, signal.default_int_handler)
    code = run(sys.argv[1:])
    # All is written, and nothing is left that could be interrupted in order.
    for number in ours:
        signal.signal(number, signal.SIG_DFL)
    sys.exit(code)


def run(arguments: Sequence[str]) -> int:
    """Run `rig` with these arguments. 0: done; 1: failed; 2: wrong usage; 130: interrupted.

    What failed is one line on stderr; the environment's RIG_TRACEBACK=1 lets the traceback through instead.
    """
    wanted = _command_of(arguments, os.environ)
    _follow_colour_habits(os.environ)
    choose_verbosity(Verbosity.USUAL)
    with plain_output():
        return _run(arguments, wanted)


def _run(arguments: Sequence[str], wanted: str) -> int:
    try:
        _application(wanted)(list(arguments), prog_name="rig")
    except SystemExit as leaving:
        code = leaving.code if isinstance(leaving.code, int) else int(bool(leaving.code))
        return _interrupted() if code == _INTERRUPTED else code
    except KeyboardInterrupt:
        return _interrupted()
    except Exception as error:
        if _is_interrupt(error):
            return _interrupted()
        if os.environ.get("RIG_TRACEBACK") == "1":
            raise
        _say(_sentence(error, wanted))
        return 1
    return 0


def _interrupted() -> int:
    _say("interrupted; nothing half-written is left behind")
    return _INTERRUPTED


def _is_interrupt(error: BaseException | None) -> bool:
    """Whether it is what a library made of an interrupt: some that are being loaded call it an ImportError."""
    while error is not None and not isinstance(error, QuadrigError | KeyboardInterrupt):
        error = error.__cause__
    return isinstance(error, KeyboardInterrupt)


def _application(wanted: str) -> typer.Typer:
    app = typer.Typer(
        help=_EXAMPLE,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    )
    app.callback()(_options)
    for name, line in COMMANDS.items():
        function = _with_verbosity(command_function(name)) if name == wanted else _named
        described = inspect.getdoc(function) if name == wanted else line
        app.command(name, cls=_Command, help=described, short_help=line)(function)
    app.command("help", cls=_Command, help="Show how a command is used: rig help calibrate.")(_help)
    return app


class _Command(TyperCommand):
    """A command whose help has one kind of placeholder: capitals, as in its examples."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The command's arguments; what may be left out is in brackets."""
        return [piece.strip("{}").replace("}...", "...") for piece in super().collect_usage_pieces(ctx)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Arguments by their names alone, options with what follows them."""
        for title, kind in (("Arguments", "argument"), ("Options", "option")):
            every = [one.get_help_record(ctx) for one in self.get_params(ctx) if one.param_type_name == kind]
            records = [(_placed(names, kind == "option"), words) for names, words in filter(None, every)]
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


def _placed(names: str, is_option: bool) -> str:
    """Names of a parameter with its placeholder instead of the type that typer puts there."""
    return _TYPE.sub(lambda found: f" {_PLACEHOLDERS.get(found[1], found[1])}" if is_option else "", names)


def _command_of(arguments: Sequence[str], environment: Mapping[str, str]) -> str:
    """The command that is called, or that a shell wants completed; "" where none is named."""
    if "_RIG_COMPLETE" in environment:
        line = environment.get("COMP_WORDS") or environment.get("_TYPER_COMPLETE_ARGS", "")
        arguments = line.split()[1:]
    return next((word for word in arguments if not word.startswith("-")), "")


def _follow_colour_habits(environment: MutableMapping[str, str]) -> None:
    """What rich knows as NO_COLOR and FORCE_COLOR is CLICOLOR=0 and CLICOLOR_FORCE=1 to many other programs."""
    if environment.get("CLICOLOR") == "0":
        environment.setdefault("NO_COLOR", "1")
    if environment.get("CLICOLOR_FORCE", "0") not in ("", "0") and not environment.get("NO_COLOR"):
        environment.setdefault("FORCE_COLOR", "1")


_QUIET = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but results and errors.")]
_VERBOSE = Annotated[bool, typer.Option("--verbose", "-v", help="Say how the work is done, and how long it takes.")]


def _with_verbosity(function: Callable[..., None]) -> Callable[..., None]:
    """The command with -q and -v."""

    @wraps(function)
    def command(**values: Any) -> None:
        quiet, verbose = values.pop("quiet"), values.pop("verbose")
        if quiet and verbose:
            raise QuadrigError("-q and -v are opposites; give one of them")
        choose_verbosity(Verbosity.QUIET if quiet else Verbosity.VERBOSE if verbose else Verbosity.USUAL)
        with only_read(path for name, value in values.items() if name not in _WRITTEN for path in _given(value)):
            _refuse_written(values)
            function(**values)

    own = inspect.signature(function, eval_str=True)
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=annotation)
        for name, annotation in (("quiet", _QUIET), ("verbose", _VERBOSE))
    ]
    command.__signature__ = own.replace(parameters=[*own.parameters.values(), *added])  # pyright: ignore[reportAttributeAccessIssue]
    return command


def _refuse_written(values: Mapping[str, Any]) -> None:
    """Raises QuadrigError, before any work, where two results would be one file, and as refuse_no_place does."""
    written = [path for name in _WRITTEN if name in values for path in _given(values[name])]
    for number, path in enumerate(written):
        if path.is_file():
            refuse_no_place(path)
        if any(path.resolve() == other.resolve() for other in written[:number]):
            raise QuadrigError(f"{path} would be written twice, the second over the first; name another file")


def _given(value: object) -> list[Path]:
    """The files that an option or an argument names: by itself, as one of many, or as NAME=FILE."""
    if isinstance(value, str):
        value = Path(value if os.path.lexists(value) else value.partition("=")[2])
        return [value] if value.is_file() else []
    if isinstance(value, Path):
        return [value]
    return [path for one in value for path in _given(one)] if isinstance(value, list | tuple) else []


def command_function(name: str) -> Callable[..., None]:
    """The function behind a command of COMMANDS, imported only now."""
    module, folder = f"{name}_" if keyword.iskeyword(name) else name, ".exchange" if name in _EXCHANGE else ""
    return getattr(import_module(f"quadrig.io.commands{folder}.{module}"), module)


def _named() -> None:
    """Stands for a command that is only listed."""


def _help(
    command: Annotated[
        str, typer.Argument(autocompletion=lambda: list(COMMANDS), help="One of those of rig --help.")
    ] = "",
) -> None:
    raise typer.Exit(run([*([command] if command else []), "--help"]))


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
    if isinstance(error, OSError) and error.errno is not None and error.errno in NO_ROOM:
        # Whoever writes a file names it: what is left is what the command prints.
        return f"cannot write the output: {os.strerror(error.errno).lower()}; make room, or send it elsewhere"
    what = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return f"unexpected error ({what}); RIG_TRACEBACK=1 rig {command} ... shows where"


def _say(sentence: str) -> None:
    print(f"rig: {one_line(sentence)}", file=sys.stderr)
