"""The page of commands, from the very functions that `rig` runs."""

import inspect
import re
from collections.abc import Callable
from typing import get_args

import typer
from typer.main import get_command

from quadrig.io.commands.main import COMMANDS, command_function

_COMPLETION = {"--install-completion", "--show-completion"}


def page() -> str:
    """Every command with what it says of itself, its examples and its options."""
    return "\n".join(_command(name) for name in COMMANDS)


def examples(name: str) -> list[str]:
    """The command lines that `rig NAME --help` shows as examples."""
    return _parted(name)[1]


def _command(name: str) -> str:
    text, shown = _parted(name)
    lines = [f"## rig {name}", "", text, ""]
    if shown:
        lines += ["```console", *shown, "```", ""]
    app = typer.Typer()
    app.command(name)(command_function(name))
    parameters = [one for one in get_command(app).params if not _COMPLETION & set(one.opts)]
    lines += ['<div class="options" markdown>', "", "| option | | default |", "|---|---|---|"]
    for one in parameters:
        about = re.sub(r"([][|<*_])", r"\\\1", getattr(one, "help", None) or "")
        names = ", ".join(f"`{each}`" for each in [*one.opts, *one.secondary_opts])
        if one.param_type_name == "argument":
            names = f"`{one.metavar or (one.name or '').upper()}`"
        about += _choices(command_function(name), one.name or "", about)
        lines.append(f"| {names} | {about} | {_default(one.default)} |")
    return "\n".join([*lines, "", "</div>", ""])


def _choices(function: Callable[..., None], name: str, about: str) -> str:
    """What an option may be, where it is one of a few words and its help does not say them."""
    annotation = inspect.signature(function).parameters[name].annotation
    words = [word for kind in get_args(annotation)[:1] for word in get_args(kind) if isinstance(word, str)]
    return f" One of {', '.join(f'`{word}`' for word in words)}." if any(word not in about for word in words) else ""


def _default(value: object) -> str:
    if value is None or value is False or value in ([], ()) or callable(value):
        return ""
    return "on" if value is True else f"`{value}`"


def _parted(name: str) -> tuple[str, list[str]]:
    """What a command says of itself, and apart from it the command lines of its examples."""
    said, shown = [], []
    for paragraph in (inspect.getdoc(command_function(name)) or "").split("\n\n"):
        found = re.fullmatch(r"(?:(.*?): )?(rig \w+ .*)", " ".join(paragraph.split()))
        if found is None:
            said.append(paragraph)
            continue
        if found[1] not in (None, "Example", "Examples"):
            shown.append(f"# {found[1]}")
        shown += [_without_asides(one) for one in re.split(r"; (?:then )?(?=rig )", found[2])]
    return "\n\n".join(said), shown


def _without_asides(command: str) -> str:
    """A command line without what is said about it in brackets."""
    return re.sub(r" \([A-Z][^)]*\)$", "", command).rstrip(".")
