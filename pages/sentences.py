"""Every sentence that quadrig can say of what went wrong or is weak, with "…" for what is filled in."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

_ROOMS = ("single", "rig", "io")
_ERRORS = {"QuadrigError", "SourceLostError"}


@dataclass(frozen=True)
class Sentence:
    """text: with "…" in the place of names and figures. module: the file that says it, from the root."""

    text: str
    module: str


def errors() -> list[Sentence]:
    """What ends a command: the texts of all QuadrigErrors. Those handed on from elsewhere are found there."""
    found = []
    for path in _files():
        for call in ast.walk(ast.parse(path.read_text())):
            if isinstance(call, ast.Call) and _called(call) in _ERRORS and call.args:
                texts = list(_texts(call.args[0]))
                found += [Sentence(text, path.relative_to(ROOT).as_posix()) for text in texts if _says(text)]
    return list(dict.fromkeys(found))


def remarks(*modules: str) -> list[Sentence]:
    """Every sentence of modules whose trade is to say something: what is weak, what to show next."""
    found = []
    for module in modules:
        tree = ast.parse((ROOT / module).read_text())
        unsaid = _unsaid(tree)
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant | ast.JoinedStr) and id(node) not in unsaid:
                found += [Sentence(text, module) for text in _texts(node) if _says(text)]
    return list(dict.fromkeys(found))


def _files() -> list[Path]:
    return sorted(path for room in _ROOMS for path in (ROOT / room).rglob("*.py"))


def _called(call: ast.Call) -> str:
    return getattr(call.func, "id", getattr(call.func, "attr", ""))


def _texts(node: ast.expr) -> Iterator[str]:
    """The sentences that an expression can be."""
    match node:
        case ast.Constant(value=str(text)):
            yield text
        case ast.JoinedStr():
            parts = [str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values]
            yield "".join(parts).replace("……", "…")
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            rights = list(_texts(right)) or ["…"]
            for text in _texts(left):
                yield from (text + more for more in rights)
        case ast.IfExp(body=body, orelse=orelse):
            yield from _texts(body)
            yield from _texts(orelse)


def _says(text: str) -> bool:
    """Whether it is a sentence and not a key, a name or a part of one."""
    return len([word for word in text.replace("…", " ").split() if word.isalpha()]) >= 3


def _unsaid(tree: ast.AST) -> set[int]:
    """Docstrings, and the parts of what is seen as a whole."""
    unsaid: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            unsaid.add(id(node.value))
        elif isinstance(node, ast.JoinedStr):
            unsaid |= {id(inner) for inner in ast.walk(node) if inner is not node}
        elif isinstance(node, ast.Call) and _called(node) in _ERRORS:
            unsaid |= {id(inner) for inner in ast.walk(node)}
    return unsaid
